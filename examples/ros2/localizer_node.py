"""A ROS 2 node that locates the images of a camera: sensor_msgs/Image in, geometry_msgs/PoseWithCovarianceStamped out.

It needs ROS 2 with rclpy, and siamloc as installed by `pip install ".[robot]"` in its folder, without torch.

    python localizer_node.py --ros-args -p bundle:=robot -r image:=/camera/image_raw -r pose:=/siamloc/pose
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from siamloc.runtime import Localizer, Location

CHANNELS = {"rgb8": [0, 1, 2], "bgr8": [2, 1, 0], "rgba8": [0, 1, 2], "bgra8": [2, 1, 0], "mono8": [0, 0, 0]}
UNKNOWN = 1e6  # variance of unknown coordinates
HEADING_VARIANCE = math.radians(5) ** 2  # adapt it to your robot: a bundle does not contain it


def pixels(message: Any) -> NDArray[np.uint8]:
    """Return the image of a sensor_msgs/Image as (rows, columns, 3), RGB, without any padding of its rows."""
    if message.encoding not in CHANNELS:
        raise ValueError(f"images are encoded as {', '.join(CHANNELS)}, got {message.encoding}")
    depth = {"mono8": 1, "rgba8": 4, "bgra8": 4}.get(message.encoding, 3)
    rows = np.frombuffer(message.data, dtype=np.uint8).reshape(message.height, message.step)
    image = rows[:, : message.width * depth].reshape(message.height, message.width, depth)
    return np.ascontiguousarray(image[:, :, CHANNELS[message.encoding]])


def fill(message: Any, location: Location) -> Any:
    """Write a location into a geometry_msgs/PoseWithCovarianceStamped; unknown values get a large variance."""
    pose, spread = message.pose.pose, np.diag(np.full(6, UNKNOWN))
    pose.position.x, pose.position.y, pose.position.z = location.x, location.y, 0.0
    heading = 0.0 if math.isnan(location.theta) else location.theta
    pose.orientation.z, pose.orientation.w = math.sin(heading / 2), math.cos(heading / 2)
    if location.covariance is not None:
        spread[:2, :2] = location.covariance
    elif not math.isnan(location.error_m):
        spread[[0, 1], [0, 1]] = location.error_m**2 / 2  # of x and of y each, if the error is the RMS distance
    if not math.isnan(location.theta):
        spread[5, 5] = HEADING_VARIANCE
    message.pose.covariance = spread.ravel().tolist()
    return message


def main() -> None:
    """Locate images until the node is stopped."""
    import rclpy
    from geometry_msgs.msg import PoseWithCovarianceStamped
    from rclpy.node import Node
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import Image

    class LocalizerNode(Node):
        def __init__(self) -> None:
            super().__init__("siamloc")
            self.localizer = Localizer(self.declare_parameter("bundle", "bundle").value, threads=2)
            self.frame = self.declare_parameter("frame", "map").value
            self.publisher = self.create_publisher(PoseWithCovarianceStamped, "pose", 10)
            self.create_subscription(Image, "image", self.located, qos_profile_sensor_data)

        def located(self, image: Image) -> None:
            try:
                location = self.localizer.locate(pixels(image))
            except ValueError as error:  # an unsupported image: the next one may be fine
                self.get_logger().error(str(error), throttle_duration_sec=5.0)
                return
            if location.lost or math.isnan(location.x):
                self.get_logger().warning("lost", throttle_duration_sec=5.0)
                return
            message = fill(PoseWithCovarianceStamped(), location)
            message.header.stamp, message.header.frame_id = image.header.stamp, self.frame
            self.publisher.publish(message)

    rclpy.init()
    try:
        rclpy.spin(LocalizerNode())
    except KeyboardInterrupt:
        pass
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
