"""The node: images in; pose, diagnostics, matched picture and transform out; and the question where the robot is."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
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
from siamloc_ros.odometry import OdometryHistory

DEFAULTS = {
    "bundle": "bundle",
    "threads": 2,
    "compressed": False,
    "map_frame": "map",
    "base_frame": "base_link",
    "track": False,
    "publish_tf": False,
    "transform_tolerance": 0.5,
    "odometry_gap": 0.2,
    "heading_deviation": 0.09,
    "set_initial_pose": False,
}
"""The parameters, which config/localizer.yaml explains."""

UNKNOWN = np.full(3, np.nan)
_PERIOD = 0.05  # s from one transform to the next
_QUIET = 5.0  # s between two log lines that say the same
_ODOMETRY = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)  # which accepts reliable odometry too
_NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)  # an image that had to wait is outdated


class LocalizerNode(Node):
    """Locates each image, and publishes what follows from it.

    Odometry and the transform have a callback group of their own: they go on while an image is being located.

    Raises:
        ConfigError: a parameter cannot be used, the bundle's map is not in metres, or it cannot follow a robot although
            `track` asks for that.
        FormatError: not a bundle.
    """

    def __init__(self) -> None:
        super().__init__("siamloc")
        kind = ParameterDescriptor(dynamic_typing=True, read_only=True)  # 1 for 1.0 is fine: `checked` looks at kinds
        self.given = {
            name: checked(name, self.declare_parameter(name, value, kind).value) for name, value in DEFAULTS.items()
        }
        self.localizer = Localizer(self.given["bundle"], threads=self.given["threads"])
        self.bits = self.localizer.bundle.preprocessing.bits
        if self.localizer.unit != "m":
            raise ConfigError(f"{self.given['bundle']} has a map in {self.localizer.unit}, but ROS takes metres")
        self.tracker = self.localizer.tracker() if self.given["track"] else None
        self.image: Image | CompressedImage | None = None
        self.odometry = OdometryHistory(self.given["odometry_gap"])
        self.odometry_frame = ""
        self.told = set[str]()  # faults of odometry that the log has already
        self.last = UNKNOWN  # the pose by odometry at the last image that was located
        self.correction = UNKNOWN  # the pose of the odometry's frame in the map: replaced, never altered
        self.pose = self.create_publisher(PoseWithCovarianceStamped, "~/pose", 10)
        self.match = self.create_publisher(CompressedImage, "~/match/compressed", 10)
        self.initial_pose = self.create_publisher(PoseWithCovarianceStamped, "initialpose", 10)
        self.diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.transform = self.create_publisher(TFMessage, "/tf", 100)
        kind, topic = (CompressedImage, "image/compressed") if self.given["compressed"] else (Image, "image")
        self.create_subscription(kind, topic, self.on_image, _NEWEST)
        meanwhile = MutuallyExclusiveCallbackGroup()
        self.create_subscription(Odometry, "odom", self.on_odometry, _ODOMETRY, callback_group=meanwhile)
        if self.given["publish_tf"]:
            self.create_timer(_PERIOD, self.publish_transform, callback_group=meanwhile)
        self.create_service(Trigger, "~/where_am_i", self.on_question)

    def on_odometry(self, message: Odometry) -> None:
        """Keep where the robot is by its odometry."""
        try:
            motion = messages.odometry_motion(message, self.given["base_frame"])
            self.odometry.add(messages.seconds(message.header.stamp), *motion)
        except DataError as error:
            if str(error) not in self.told:
                self.told.add(str(error))
                self.get_logger().warning(str(error))
            return
        self.odometry_frame = message.header.frame_id

    def on_image(self, image: Image | CompressedImage) -> None:
        """Locate an image, publish pose, diagnostics and matched picture, and renew the transform."""
        self.image, stamp, bundle = image, image.header.stamp, self.localizer.bundle
        time = messages.seconds(stamp)
        motion = moves([self.last, self.odometry.at(time)])[1] if self.tracker is not None and self.odometry else None
        try:
            location = self.localizer.locate(messages.pixels(image, self.bits), self.tracker, motion=motion)
        except DataError as error:  # the next image may be fine
            self.get_logger().error(str(error), throttle_duration_sec=_QUIET)
            self.diagnostics.publish(messages.diagnostic_message(stamp, bundle.path.name, None, str(error)))
            return
        fault, age = self.fault(location, time), self.odometry.age(time)
        self.last = here = self.odometry.at(time)  # once more: odometry arrived in the meantime
        self.diagnostics.publish(messages.diagnostic_message(stamp, bundle.path.name, location, fault, age))
        if (jpeg := bundle.thumbnail(location.candidates[0].row)) is not None:
            self.match.publish(messages.match_message(jpeg, image.header))
        if messages.known(location):
            self.pose.publish(self.answer(location, stamp))
            correction = messages.map_to_odom(location, here)
            self.correction = correction if np.isfinite(correction).all() else self.correction

    def fault(self, location: Location, time: float) -> str:
        """Return why an image cannot renew the transform or move the tracker, which the log says too; "" if it can."""
        wanted = self.given["publish_tf"] or (self.tracker is not None and self.odometry)
        fault = self.odometry.fault(time) if wanted else ""
        if not fault and self.given["publish_tf"] and messages.known(location) and math.isnan(location.theta):
            fault = "the location has no heading, which the transform needs"
        if fault:
            self.get_logger().warning(fault, throttle_duration_sec=_QUIET)
        return fault

    def publish_transform(self) -> None:
        """Publish the transform from the map to the odometry, once one is known: that of the last known pose."""
        if np.isnan(self.correction).any():
            return
        now = self.get_clock().now().to_msg()
        header = self.header(messages.later(now, self.given["transform_tolerance"]))
        self.transform.publish(
            TFMessage(transforms=[messages.transform_message(self.correction, header, self.odometry_frame)])
        )

    def on_question(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Answer where the robot is by its newest image alone."""
        if self.image is None:
            response.success, response.message = False, "no image has arrived yet"
            return response
        try:
            location = self.localizer.locate(messages.pixels(self.image, self.bits))
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
        """Return the header of a message in the map's frame."""
        return Header(stamp=stamp, frame_id=self.given["map_frame"])


def checked(name: str, value: Any) -> Any:
    """Return the value of a parameter, as a number with a decimal point where its default is one.

    Raises:
        ConfigError: it is of another kind than its default, not positive, or a frame that tf2 refuses.
    """
    kind = type(DEFAULTS[name])
    if kind is float and type(value) is int:
        value = float(value)
    if type(value) is not kind:
        words = {bool: "true or false", str: "text", int: "a whole number", float: "a number"}
        raise ConfigError(f"the parameter {name} must be {words[kind]}, got {value!r}")
    if kind in (int, float) and not 0 < value < math.inf:
        raise ConfigError(f"the parameter {name} must be above 0, got {value!r}")
    if name.endswith("_frame") and (fault := messages.frame_fault(value)):
        raise ConfigError(f"the parameter {name} {fault}")
    return value


def main() -> None:
    """Locate images until the node is stopped."""
    rclpy.init()
    try:
        executor = MultiThreadedExecutor(num_threads=2)  # one for images and questions, one for odometry and transform
        executor.add_node(LocalizerNode())
        executor.spin()
    except SiamlocError as error:
        raise SystemExit(f"siamloc: {error}") from error
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
