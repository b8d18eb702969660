"""Starts the localizer: `ros2 launch siamloc_ros localizer.launch.py bundle:=/path image:=/camera/image_raw`."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

PARAMETERS = str(Path(get_package_share_directory("siamloc_ros")) / "config" / "localizer.yaml")


def generate_launch_description() -> LaunchDescription:
    """Return the node; its bundle, parameters and topics are arguments."""
    arguments = [
        DeclareLaunchArgument("bundle", description="folder of the bundle"),
        DeclareLaunchArgument("image", default_value="image", description="images; if compressed, without /compressed"),
        DeclareLaunchArgument("odom", default_value="odom", description="odometry"),
        DeclareLaunchArgument("params_file", default_value=PARAMETERS, description="parameters of the node"),
    ]
    chosen = {one.name: LaunchConfiguration(one.name) for one in arguments}
    node = Node(
        package="siamloc_ros",
        executable="localizer",
        name="siamloc",
        output="screen",
        parameters=[chosen["params_file"], {"bundle": chosen["bundle"]}],
        remappings=[
            ("image", chosen["image"]),
            ("image/compressed", [chosen["image"], "/compressed"]),
            ("odom", chosen["odom"]),
        ],
    )
    return LaunchDescription([*arguments, node])
