"""The node: images in; pose, diagnostics, matched picture and transform out; and the question where the robot is."""

from __future__ import annotations

from collections import deque

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Header
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

from siamloc.data.moves import moves
from siamloc.errors import ConfigError, DataError, SiamlocError
from siamloc.runtime import Localizer, Location
from siamloc_ros import messages

DEFAULTS = {
    "bundle": "bundle",
    "threads": 2,
    "compressed": False,
    "map_frame": "map",
    "track": False,
    "publish_tf": False,
    "transform_tolerance": 0.5,
    "odometry_gap": 0.2,
    "heading_deviation": 0.09,
    "set_initial_pose": False,
}
"""The parameters, which config/localizer.yaml explains."""

UNKNOWN = np.full(3, np.nan)
_KEPT = 500  # messages of odometry, at 100 Hz those of 5 s
_QUIET = 5.0  # s between two log lines that say the same
_NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)  # an image that had to wait is outdated


class LocalizerNode(Node):
    """Locates each image, and publishes what follows from it.

    Raises:
        ConfigError: the bundle's map is not in metres, or it cannot follow a robot although `track` asks for that.
        FormatError: not a bundle.
    """

    def __init__(self) -> None:
        super().__init__("siamloc")
        self.given = {name: self.declare_parameter(name, value).value for name, value in DEFAULTS.items()}
        self.localizer = Localizer(self.given["bundle"], threads=self.given["threads"])
        if self.localizer.unit != "m":
            raise ConfigError(f"{self.given['bundle']} has a map in {self.localizer.unit}, but ROS takes metres")
        self.tracker = self.localizer.tracker() if self.given["track"] else None
        self.image: Image | CompressedImage | None = None
        self.odometry: deque[tuple[float, NDArray[np.float64]]] = deque(maxlen=_KEPT)
        self.odometry_frame = ""
        self.last = UNKNOWN  # the pose by odometry at the last image that was located
        self.correction = UNKNOWN  # the pose of the odometry's frame in the map
        self.pose = self.create_publisher(PoseWithCovarianceStamped, "~/pose", 10)
        self.match = self.create_publisher(CompressedImage, "~/match/compressed", 10)
        self.initial_pose = self.create_publisher(PoseWithCovarianceStamped, "initialpose", 10)
        self.diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.transform = self.create_publisher(TFMessage, "/tf", 100)
        kind, topic = (CompressedImage, "image/compressed") if self.given["compressed"] else (Image, "image")
        self.create_subscription(kind, topic, self.on_image, _NEWEST)
        self.create_subscription(Odometry, "odom", self.on_odometry, 50)
        self.create_service(Trigger, "~/where_am_i", self.on_question)

    def on_odometry(self, message: Odometry) -> None:
        """Keep where the robot is by its odometry."""
        time = messages.seconds(message.header.stamp)
        if self.odometry and time <= self.odometry[-1][0]:  # the clock of a simulation or a recording began again
            self.odometry.clear()
        self.odometry.append((time, messages.odometry_pose(message)))
        self.odometry_frame = message.header.frame_id

    def on_image(self, image: Image | CompressedImage) -> None:
        """Locate an image, and publish pose, diagnostics, matched picture and transform."""
        self.image, stamp, bundle = image, image.header.stamp, self.localizer.bundle
        here = messages.pose_at(messages.seconds(stamp), self.odometry, self.given["odometry_gap"])
        motion = moves([self.last, here])[1] if self.tracker is not None and self.odometry else None
        try:
            location = self.localizer.locate(messages.pixels(image), self.tracker, motion=motion)
        except DataError as error:  # the next image may be fine
            self.get_logger().error(str(error), throttle_duration_sec=_QUIET)
            self.diagnostics.publish(messages.diagnostic_message(stamp, bundle.path.name, None, str(error)))
            return
        self.last = here
        self.diagnostics.publish(messages.diagnostic_message(stamp, bundle.path.name, location))
        if (jpeg := bundle.thumbnail(location.candidates[0].row)) is not None:
            self.match.publish(messages.match_message(jpeg, image.header))
        if messages.known(location):
            self.pose.publish(self.answer(location, stamp))
            correction = messages.map_to_odom(location, here)
            self.correction = correction if np.isfinite(correction).all() else self.correction
        if self.given["publish_tf"]:
            self.publish_transform(stamp)

    def publish_transform(self, stamp: Time) -> None:
        """Publish the transform from the map to the odometry: while the robot is lost, that of the last known pose."""
        if np.isnan(self.correction).any():
            wanted = "no transform yet: it takes odometry, and a located image with a heading"
            self.get_logger().warning(wanted, throttle_duration_sec=_QUIET)
            return
        header = self.header(messages.later(stamp, self.given["transform_tolerance"]))
        self.transform.publish(
            TFMessage(transforms=[messages.transform_message(self.correction, header, self.odometry_frame)])
        )

    def on_question(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Answer where the robot is by its newest image alone."""
        if self.image is None:
            response.success, response.message = False, "no image has arrived yet"
            return response
        try:
            location = self.localizer.locate(messages.pixels(self.image))
        except DataError as error:
            response.success, response.message = False, str(error)
            return response
        response.success, response.message = messages.known(location), location.describe()
        if response.success and self.given["set_initial_pose"]:
            self.initial_pose.publish(self.answer(location, self.image.header.stamp))
        return response

    def answer(self, location: Location, stamp: Time) -> PoseWithCovarianceStamped:
        """Return a location as a message."""
        return messages.pose_message(location, self.header(stamp), self.given["heading_deviation"])

    def header(self, stamp: Time) -> Header:
        """Return the header of what is told in the map's frame."""
        return Header(stamp=stamp, frame_id=self.given["map_frame"])


def main() -> None:
    """Locate images until the node is stopped."""
    rclpy.init()
    try:
        rclpy.spin(LocalizerNode())
    except SiamlocError as error:
        raise SystemExit(f"siamloc: {error}") from error
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
