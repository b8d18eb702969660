"""From ROS messages to arrays, and from locations to ROS messages: functions without a node."""

from __future__ import annotations

import array
import math

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseWithCovarianceStamped, Quaternion, TransformStamped
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Header

from siamloc.data.bags import demosaiced
from siamloc.data.image_files import UnreadableImageError, decode_image
from siamloc.data.moves import composed, euler, inverse
from siamloc.errors import DataError
from siamloc.runtime import Location

CHANNELS = {"rgb8": [0, 1, 2], "bgr8": [2, 1, 0], "rgba8": [0, 1, 2], "bgra8": [2, 1, 0], "mono8": [0, 0, 0]}
"""Where red, green and blue are in a pixel, by the encoding of a raw image."""

UNKNOWN = 1e6  # variance of what an image does not tell: z, roll, pitch, and coordinates that the bundle lacks
ANY_HEADING = math.pi**2 / 3  # variance in rad^2 of a heading that may be any: uniform over a full turn
_NANO = 1_000_000_000
_UNIT = 0.01  # how far the length of a quaternion may be from 1


def pixels(message: Image | CompressedImage, bits: int | None = None) -> NDArray[np.uint8]:
    """Return the image of a message (rows, columns, 3), RGB, without any padding of its rows.

    Args:
        message: the image.
        bits: how many bits compressed images of 16 use; this image says it if None.

    Raises:
        DataError: an encoding that is not in `CHANNELS`, fewer bytes than the size says, or a damaged file.
    """
    data = np.frombuffer(message.data, dtype=np.uint8)
    if isinstance(message, CompressedImage):
        try:
            image = decode_image(demosaiced(data.tobytes(), message.format), bits=bits)
        except UnreadableImageError as error:
            raise DataError(
                f"a compressed image of {len(data)} bytes in the format {message.format!r} is damaged: {error}"
            ) from error
        return np.ascontiguousarray(image[:, :, ::-1])
    if message.encoding not in CHANNELS:
        raise DataError(f"images are encoded as {', '.join(CHANNELS)}, got {message.encoding!r}: convert them first")
    depth = {"mono8": 1, "rgba8": 4, "bgra8": 4}.get(message.encoding, 3)
    if len(data) != message.height * message.step or message.step < message.width * depth:
        raise DataError(
            f"an image of {message.height} x {message.width} in {message.encoding} with {message.step} bytes a row "
            f"cannot have {len(data)} bytes"
        )
    rows = data.reshape(message.height, message.step)[:, : message.width * depth]
    image = rows.reshape(message.height, message.width, depth)
    return np.ascontiguousarray(image[:, :, CHANNELS[message.encoding]])


def seconds(stamp: Time) -> float:
    """Return a time in s."""
    return stamp.sec + stamp.nanosec / _NANO


def later(stamp: Time, by: float) -> Time:
    """Return the time `by` seconds after another one."""
    sec, nanosec = divmod(stamp.sec * _NANO + stamp.nanosec + round(by * _NANO), _NANO)
    return Time(sec=sec, nanosec=nanosec)


def known(location: Location) -> bool:
    """Whether a location says where the robot is: it is not lost, and its map frame has a position."""
    return not location.lost and not math.isnan(location.x)


def pose_message(location: Location, header: Header, heading_deviation: float) -> PoseWithCovarianceStamped:
    """Return a location as a pose in the frame of the header.

    The covariance is 6 x 6, row by row, of x, y, z and the turns about x, y, z, all in the header's frame. Where the
    bundle gives only an expected error, half its square is the variance of x and that of y. If x and y are not known to
    be right, neither is the heading: it has the variance of a heading that may be any.

    Args:
        location: where the image was taken.
        header: time of the image, and the map's frame.
        heading_deviation: standard deviation of the heading, in rad.
    """
    message, spread = PoseWithCovarianceStamped(header=header), np.diag(np.full(6, UNKNOWN))
    pose = message.pose.pose
    pose.position.x, pose.position.y = location.x, location.y
    if location.covariance is not None:
        spread[:2, :2] = location.covariance
    elif not math.isnan(location.error_m):
        spread[[0, 1], [0, 1]] = location.error_m**2 / 2
    spread[5, 5] = ANY_HEADING
    if not math.isnan(location.theta):
        pose.orientation = turned(location.theta)
        if spread[0, 0] < UNKNOWN:
            spread[5, 5] = min(heading_deviation**2, ANY_HEADING)
    message.pose.covariance = spread.ravel()
    return message


def turned(heading: float) -> Quaternion:
    """Return the quaternion of a heading in rad."""
    return Quaternion(x=0.0, y=0.0, z=math.sin(heading / 2), w=math.cos(heading / 2))


def odometry_motion(message: Odometry, body: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return where a robot is by its odometry, and how it moves.

    Args:
        message: the odometry.
        body: frame of the robot that the map's poses are of.

    Returns:
        x and y in m and heading in rad (3,) in the frame of the odometry; and the velocity ahead and to the left in
        m/s and to the left in rad/s (3,), seen from the robot.

    Raises:
        DataError: no frame or one that tf2 refuses, another body, or a pose that is none.
    """
    if fault := frame_fault(message.header.frame_id):
        raise DataError(f"odometry is dropped: its frame_id {fault}")
    if message.child_frame_id != body:
        raise DataError(
            f"odometry is dropped: it is of {message.child_frame_id!r}, not of {body!r}, whose poses the map has: "
            "the parameter base_frame names another frame"
        )
    position, turn = message.pose.pose.position, message.pose.pose.orientation
    quaternion = np.array([turn.w, turn.x, turn.y, turn.z])
    if not abs(np.linalg.norm(quaternion) - 1) <= _UNIT or not math.isfinite(position.x + position.y):
        raise DataError("odometry is dropped: its pose is not finite, or its orientation is no unit quaternion")
    linear, angular = message.twist.twist.linear, message.twist.twist.angular
    velocity = np.nan_to_num([linear.x, linear.y, angular.z], posinf=0, neginf=0)
    return np.array([position.x, position.y, euler(quaternion)[2]]), velocity


def frame_fault(frame: str) -> str:
    """Return what is wrong with the name of a frame, or "" if tf2 takes it."""
    if not frame:
        return "is empty"
    return f"{frame!r} begins with a slash, which tf2 refuses" if frame.startswith("/") else ""


def map_to_odom(location: Location, odometry: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the pose (3,) of the odometry's frame in the map: the robot, one step back along its odometry.

    Args:
        location: where the robot is in the map.
        odometry: where it is by its odometry at the same time (3,): x, y, and heading in rad.

    Returns:
        x, y, and heading in rad; NaN where the location or the odometry is unknown.
    """
    robot = np.array([[location.x, location.y, location.theta]])
    return composed(robot, inverse(odometry[None]))[0]


def transform_message(pose: NDArray[np.float64], header: Header, child: str) -> TransformStamped:
    """Return the pose (3,) of a frame, the child, in the frame of the header as a transform."""
    message = TransformStamped(header=header, child_frame_id=child)
    shift = message.transform.translation
    shift.x, shift.y = float(pose[0]), float(pose[1])
    message.transform.rotation = turned(float(pose[2]))
    return message


def match_message(jpeg: bytes, header: Header) -> CompressedImage:
    """Return the picture of a map frame, a JPEG file, as a message."""
    return CompressedImage(header=header, format="jpeg", data=array.array("B", jpeg))


def diagnostic_message(
    stamp: Time, bundle: str, location: Location | None, fault: str = "", odometry_age: float = math.nan
) -> DiagnosticArray:
    """Return how an image was located.

    OK if the robot is known, WARN if it is lost or something else is at fault, ERROR for an unusable image.

    Args:
        stamp: time of the image.
        bundle: name of the bundle.
        location: where the image was taken; None if it cannot be used.
        fault: why it cannot be used, or what is missing beside the location; "" for nothing.
        odometry_age: how much older than the image the newest odometry is, in s; NaN without odometry.
    """
    status = DiagnosticStatus(name="siamloc: localization", hardware_id=bundle)
    if location is None:
        status.level, status.message = DiagnosticStatus.ERROR, fault
    else:
        state = "located" if known(location) else "lost" if location.lost else "no position in the map"
        status.level = DiagnosticStatus.OK if known(location) and not fault else DiagnosticStatus.WARN
        status.message = f"{state}; {fault}" if fault else state
        told = {
            "lost": {None: "unknown"}.get(location.lost, str(location.lost).lower()),
            "expected error [m]": f"{location.error_m:.3f}",
            "agreement": f"{location.agreement:.2f}",
            "room": location.room,
            "nearest map frame": location.candidates[0].image,
            "time [ms]": f"{location.ms:.1f}",
            "odometry age [s]": f"{odometry_age:.3f}",
        }
        status.values = [KeyValue(key=key, value=value) for key, value in told.items()]
    return DiagnosticArray(header=Header(stamp=stamp), status=[status])
