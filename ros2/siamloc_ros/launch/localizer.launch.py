"""Starts the localizer: `ros2 launch siamloc_ros localizer.launch.py bundle:=/path image:=/camera/image_raw`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

PARAMETERS = str(Path(get_package_share_directory("siamloc_ros")) / "config" / "localizer.yaml")
FLAGS = {
    "publish_tf": "publish the transform from map to odom",
    "track": "follow the robot from image to image",
    "compressed": "subscribe to compressed images",
}


def generate_launch_description() -> LaunchDescription:
    """Return the node; its parameters and topics are arguments."""
    kept = "if left out, as params_file says"
    arguments = [
        DeclareLaunchArgument("bundle", default_value="", description=f"folder of the bundle; {kept}"),
        DeclareLaunchArgument("image", default_value="image", description="images; if compressed, without /compressed"),
        DeclareLaunchArgument("odom", default_value="odom", description="odometry"),
        DeclareLaunchArgument("namespace", default_value="", description="namespace of the node and its topics"),
        DeclareLaunchArgument("params_file", default_value=PARAMETERS, description="parameters of the node"),
    ]
    arguments += [
        DeclareLaunchArgument(name, default_value="", choices=["", "true", "false"], description=f"{what}; {kept}")
        for name, what in FLAGS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=localizer)])


def localizer(context: Any) -> list[Node]:
    """Return the node, with the parameters that are given as arguments above those of the file."""
    names = ("bundle", "image", "odom", "namespace", "params_file", *FLAGS)
    given = {name: LaunchConfiguration(name).perform(context) for name in names}
    chosen: dict[str, Any] = {name: given[name] == "true" for name in FLAGS if given[name]}
    if given["bundle"]:
        chosen["bundle"] = given["bundle"]
    node = Node(
        package="siamloc_ros",
        executable="localizer",
        name="siamloc",
        namespace=given["namespace"],
        output="screen",
        parameters=[given["params_file"], *([chosen] if chosen else [])],
        remappings=[
            ("image", given["image"]),
            ("image/compressed", f"{given['image']}/compressed"),
            ("odom", given["odom"]),
        ],
    )
    return [node]
