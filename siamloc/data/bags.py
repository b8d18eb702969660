"""`Bag`: the images, poses and frames in a ROS 1 or ROS 2 bag, read without ROS (with the package rosbags)."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from foundation.extras import need
from siamloc.data.frames import METADATA
from siamloc.data.image_files import UnreadableImageError, bits_used, cut_short
from siamloc.data.trajectory import Trajectory, composed
from siamloc.errors import DataError, SiamlocError, hint, logger

Clock = Literal["stamp", "bag"]
Edge = tuple[str, str]
"""A frame and the frame that its poses are given in: parent, child."""

IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
ODOMETRY = ("nav_msgs/msg/Odometry",)
POSES = tuple(f"geometry_msgs/msg/{name}Stamped" for name in ("Pose", "PoseWithCovariance", "Transform"))
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
CALIBRATION = ("sensor_msgs/msg/CameraInfo",)
KINDS = {
    **dict.fromkeys(IMAGES, "images"),
    **dict.fromkeys(ODOMETRY, "odometry"),
    **dict.fromkeys(POSES, "poses"),
    **dict.fromkeys(TRANSFORMS, "frames"),
    **dict.fromkeys(CALIBRATION, "calibration"),
}
"""What a topic holds, by the type of its messages."""

# Channels and type of the numbers of a raw image, and how OpenCV turns them into RGB.
_ENCODINGS: dict[str, tuple[int, str, int | None]] = {
    "rgb8": (3, "u1", None),
    "rgba8": (4, "u1", cv2.COLOR_RGBA2RGB),
    **dict.fromkeys(("bgr8", "8UC3"), (3, "u1", cv2.COLOR_BGR2RGB)),
    **dict.fromkeys(("bgra8", "8UC4"), (4, "u1", cv2.COLOR_BGRA2RGB)),
    **dict.fromkeys(("mono8", "8UC1"), (1, "u1", cv2.COLOR_GRAY2RGB)),
    "bayer_rggb8": (1, "u1", cv2.COLOR_BayerRGGB2RGB),
    "bayer_bggr8": (1, "u1", cv2.COLOR_BayerBGGR2RGB),
    "bayer_gbrg8": (1, "u1", cv2.COLOR_BayerGBRG2RGB),
    "bayer_grbg8": (1, "u1", cv2.COLOR_BayerGRBG2RGB),
    **dict.fromkeys(("yuv422", "uyvy"), (2, "u1", cv2.COLOR_YUV2RGB_UYVY)),
    **dict.fromkeys(("yuv422_yuy2", "yuyv"), (2, "u1", cv2.COLOR_YUV2RGB_YUY2)),
}
_ENCODINGS |= {name.replace("8", "16"): (one, "u2", code) for name, (one, _, code) in _ENCODINGS.items() if "8" in name}
_MOSAIC = re.compile(r"(bayer_\w+); *\w+ compressed *")  # formats of converted pictures end with their encoding
_FILES = {b"\xff\xd8\xff": ".jpg", b"\x89PNG": ".png"}  # the first bytes of compressed images
_NOT_OF_THE_ROBOT = ("goal", "initialpose", "target")  # in topics of poses where someone wants the robot to be
_NOT_PICTURES = ("depth", "disparity")  # in topics of images that show no light
_FEW = 10  # messages: a topic with fewer is not the poses along a drive
_BASES = ("base_footprint", "base_link")  # frames of the robot; the first is on the floor
_FIXED = 0.01  # m by which the height of a camera that is fixed on the robot may vary
_LOOKED_AT = 2000  # messages of a topic of frames, to know which frames there are


class Bag:
    """A bag that is open inside a `with` block: a file .bag, .db3 or .mcap, or a folder with metadata.yaml.

    Attributes:
        path: the bag.
        topics: type and number of the messages of each topic.
        seconds: time between the first and the last message.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def __enter__(self) -> Bag:
        need("rosbags")
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore

        with self._whole():
            named = self.path.suffix == ".bag" and self.path.is_dir()  # rosbags takes it for a bag of ROS 1
            paths = [path for end in ("db3", "mcap") for path in self.path.glob(f"*.{end}")] if named else []
            self._reader = AnyReader(paths or [self.path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
            self._reader.open()
            self.topics = {name: (str(one.msgtype), one.msgcount) for name, one in self._reader.topics.items()}
            counted = any(count for _, count in self.topics.values())
            self.seconds = max(self._reader.duration, 0) / 1e9 if counted else 0.0
        return self

    def __exit__(self, *_: object) -> None:
        self._reader.close()

    def images(
        self, topic: str, clock: Clock = "stamp"
    ) -> Iterator[tuple[int, bytes | NDArray[np.uint8] | UnreadableImageError, str]]:
        """Yield the time in ns of each image of a topic, the image, and the ending of its file.

        A compressed image comes as the bytes of its file, in colour; others as pixels (rows, columns, 3), RGB. An
        image that cannot be used comes as the error that says why.

        Raises:
            DataError: no such topic, or one without images; an encoding that is not known; or a bag cut short.
        """
        shift = self._shift(topic)
        for time, message in self._messages(topic, IMAGES, clock):
            if hasattr(message, "encoding"):
                try:
                    yield time, self._pixels(topic, message, shift), ".jpg"
                except UnreadableImageError as error:
                    yield time, error, ""
                continue
            content, kind = bytes(message.data), message.format.lower()
            ending = next((end for begin, end in _FILES.items() if content.startswith(begin)), None)
            if ending is not None:
                yield time, demosaiced(content, message.format), ending
            elif "depth" not in kind and any(word in kind for word in ("jpeg", "jpg", "png")):
                reason = f"the image at {time / 1e9:.3f} s, of {len(content)} bytes, is neither JPEG nor PNG"
                yield time, UnreadableImageError(reason), ""
            else:
                raise DataError(
                    f"{self.path}: images of {topic} are compressed as {message.format!r}, expected JPEG or PNG"
                )

    def poses(self, source: str, clock: Clock = "stamp") -> Trajectory:
        """Return the poses of a topic, or of a frame in another one, such as "map:base_link".

        Raises:
            DataError: no such topic or frame, a topic of other messages, no poses, or a bag cut short.
        """
        if source not in self.topics and ":" in source:
            parent, child = (name.lstrip("/") for name in source.split(":", 1))
            return self._between(self._transforms(clock), parent, child)
        rows = [(time, *_pose(message)) for time, message in self._messages(source, (*ODOMETRY, *POSES), clock)]
        return _trajectory(rows, f"{self.path}, {source}")

    def height(self, topic: str) -> dict[str, float]:
        """Return the height in m at which the camera of a topic is fixed above the robot's base, by the base's name.

        Empty if the first messages of the topics of frames do not say it.
        """
        _, first = next(self._messages(topic, IMAGES, "bag"), (0, None))
        camera = first.header.frame_id.lstrip("/") if first else ""
        for base in _BASES:
            with suppress(DataError):
                above = self._between(self.first_transforms, base, camera).position[:, 2]
                if above.min() > 0 and np.ptp(above) < _FIXED:
                    return {base: float(above.mean())}
        return {}

    def calibrations(self) -> dict[str, dict[str, Any]]:
        """Return the first calibration of each camera as plain values, by topic."""
        names = ("width", "height", "distortion_model", "d", "k", "r", "p", "D", "K", "R", "P")  # large ones of ROS 1
        firsts = {topic: next(self._messages(topic, CALIBRATION, "stamp"), None) for topic in self._named(CALIBRATION)}
        return {
            topic: {name.lower(): getattr(first[1], name) for name in names if hasattr(first[1], name)}
            for topic, first in firsts.items()
            if first is not None
        }

    def _named(self, types: tuple[str, ...]) -> list[str]:
        return [name for name, (kind, _) in self.topics.items() if kind in types]

    def _messages(self, topic: str, types: tuple[str, ...], clock: Clock) -> Iterator[tuple[int, Any]]:
        """Yield the time in ns and the message of each message of a topic."""
        if topic not in self.topics:
            raise DataError(f"{self.path} has no topic {topic!r}; {hint(topic, self._named(types) or self.topics)}")
        if self.topics[topic][0] not in types:
            raise DataError(
                f"{self.path}: {topic} holds {self.topics[topic][0]}, expected {' or '.join(types)}; such topics are: "
                f"{', '.join(self._named(types)) or 'none'}"
            )
        with self._whole():
            connections, unstamped = [one for one in self._reader.connections if one.topic == topic], 0
            for connection, received, raw in self._reader.messages(connections):
                message = self._reader.deserialize(raw, connection.msgtype)
                stamped = clock == "stamp" and hasattr(message, "header")
                stamp = _stamp(message) if stamped else 0
                unstamped += stamped and not stamp
                yield stamp or received, message
        self._warn_of_unstamped(topic, unstamped, "messages")

    def _warn_of_unstamped(self, topic: str, count: int, what: str) -> None:
        if count:
            logger.warning(
                "%s: %d of the %s of %s have no time in their header and get that at which they were recorded, which "
                "may be another clock than that of other topics: clock=bag takes the recorder's for all",
                *(self.path, count, what, topic),
            )

    @cached_property
    def first_transforms(self) -> dict[Edge, list[Any]]:
        """Times and poses of each frame in its parent, from the first messages of the topics of frames."""
        return self._transforms("stamp", _LOOKED_AT)

    def _transforms(self, clock: Clock, most: int | None = None) -> dict[Edge, list[Any]]:
        """Return the times and poses of each frame in its parent, from all or the first messages of each topic."""
        rows: dict[Edge, list[Any]] = {}
        for topic in self._named(TRANSFORMS):
            static, unstamped = topic.endswith("tf_static"), 0
            for received, message in islice(self._messages(topic, TRANSFORMS, clock), most):
                for one in message.transforms:
                    stamp = _stamp(one) if clock == "stamp" else 0
                    unstamped += clock == "stamp" and not stamp
                    row = (stamp or received, *_pose(one))
                    if static:  # the last one holds for all times, however often it is repeated
                        rows[_edge(one)] = [row]
                    else:
                        rows.setdefault(_edge(one), []).append(row)
            if not static and most is None:
                self._warn_of_unstamped(topic, unstamped, "frames")
        return rows

    def _between(self, rows: Mapping[Edge, list[Any]], parent: str, child: str) -> Trajectory:
        """Return the poses of a frame in another one, up and down the tree of frames between the two."""
        if (parent, child) in rows:  # a frame may have several, if more than one program says where it is
            return _trajectory(rows[parent, child], f"{self.path}, {parent}:{child}")
        above = {lower: upper for upper, lower in rows if upper != lower}
        down = _ancestors(child, above)
        up = [parent] if parent in down else _ancestors(parent, above)
        shared = next((frame for frame in down if frame in up), None)
        if shared is None or parent == child:
            known = [f"{upper}:{lower}" for upper, lower in rows]
            raise DataError(
                f"{self.path} has no frames from {parent!r} to {child!r}; {hint(f'{parent}:{child}', known)}"
            )

        used = [*up[: up.index(shared)], *down[: down.index(shared) + 1]]
        looped = [frame for frame in used if above.get(_ancestors(frame, above)[-1]) == frame]
        if len(looped) > 1:
            raise DataError(
                f"{self.path}: the frames {', '.join(looped)} form a loop: two ways lead from {parent} to {child}; "
                f"name a pair that the recording has, such as {above[looped[0]]}:{looped[0]}, or a topic of poses"
            )

        def link(frame: str) -> Trajectory:
            edge = above[frame], frame
            return _trajectory(rows[edge], f"{self.path}, {':'.join(edge)}")

        links = [link(frame).inverse() for frame in up[: up.index(shared)]]
        links += [link(frame) for frame in down[: down.index(shared)][::-1]]
        return composed(links, f"{self.path}, {parent}:{child}")

    def _shift(self, topic: str) -> int:
        """Return how many of 16 bits to drop: sensors of 10 to 14 bits leave the upper ones empty in all images."""
        _, first = next(self._messages(topic, IMAGES, "bag"), (0, None))
        if _ENCODINGS.get(getattr(first, "encoding", ""), _ENCODINGS["rgb8"])[1] == "u1":
            return 0
        bits = 8
        for _, one in self._messages(topic, IMAGES, "bag"):
            with suppress(UnreadableImageError):
                bits = max(bits, bits_used(self._numbers(topic, one)))
        if bits < 16:
            logger.warning("%s: the images of %s use %d of 16 bits, and are brightened alike", self.path, topic, bits)
        return bits - 8

    def _numbers(self, topic: str, message: Any) -> NDArray[Any]:
        """Return the numbers of a raw image (rows, columns, channels)."""
        if message.encoding == "16UC1" and any(word in topic.lower() for word in _NOT_PICTURES):
            raise DataError(f"{self.path}: images of {topic} hold depths (16UC1), and no light")
        if message.encoding not in _ENCODINGS:
            raise DataError(
                f"{self.path}: images of {topic} have the encoding {message.encoding!r}; "
                f"{hint(message.encoding, _ENCODINGS)}"
            )
        channels, kind, _ = _ENCODINGS[message.encoding]
        order = ">" if message.is_bigendian else "<"
        row = message.width * channels * int(kind[1])
        raw = np.frombuffer(message.data, dtype=np.uint8)
        if not row * message.height or message.step < row or len(raw) < message.step * message.height:
            size = f"{message.width} x {message.height} px in {message.encoding}"
            raise UnreadableImageError(
                f"the image at {_stamp(message) / 1e9:.3f} s has {len(raw)} bytes, too few for {size}"
            )
        rows = raw[: message.step * message.height].reshape(message.height, message.step)[:, :row]
        return np.ascontiguousarray(rows).view(order + kind).reshape(message.height, message.width, channels)

    def _pixels(self, topic: str, message: Any, shift: int) -> NDArray[np.uint8]:
        """Return a raw image (rows, columns, 3), RGB; `shift` as of `_shift`."""
        pixels, code = self._numbers(topic, message), _ENCODINGS[message.encoding][2]
        pixels = pixels if pixels.itemsize == 1 else (pixels >> (shift or 8)).astype(np.uint8)
        return np.asarray(pixels if code is None else cv2.cvtColor(pixels, code), dtype=np.uint8)

    @contextmanager
    def _whole(self) -> Iterator[None]:
        """Turn the errors of a damaged bag, which come from many libraries, into one sentence."""
        try:
            yield
        except (SiamlocError, ModuleNotFoundError):
            raise
        except Exception as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            remedy = "it is damaged or cut short; `rosbag reindex` or `ros2 bag reindex` may repair it"
            if is_part(self.path):  # the folder says whether the messages are compressed
                remedy = f"name its folder, {self.path.parent}, and if that cannot be read, {remedy}"
            raise DataError(f"{self.path} cannot be read as a ROS bag ({reason.rstrip('.')}): {remedy}") from error


def is_part(path: Path) -> bool:
    """Return whether a file belongs to the ROS 2 bag in its folder."""
    said = path.parent / METADATA
    return path.is_file() and said.is_file() and path.name in said.read_text(encoding="utf-8", errors="replace")


def demosaiced(content: bytes, form: str) -> bytes:
    """Return the content of a compressed image in colour if it is the mosaic of a Bayer sensor, and else as it is.

    Args:
        content: a JPEG or PNG file.
        form: the format that the message names, such as "bayer_rggb8; jpeg compressed ".
    """
    mosaic = _MOSAIC.fullmatch(form)
    code = _ENCODINGS.get(mosaic[1], (1, "", None))[2] if mosaic else None
    if code is not None and not cut_short(content):
        with suppress(cv2.error):
            stored = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
            if stored is not None and stored.ndim == 2:
                ending = ".png" if content.startswith(b"\x89PNG") else ".jpg"
                return cv2.imencode(ending, cv2.cvtColor(stored, code)[:, :, ::-1])[1].tobytes()
    return content


def _stamp(message: Any) -> int:
    return int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)


def _edge(message: Any) -> Edge:
    return message.header.frame_id.lstrip("/"), message.child_frame_id.lstrip("/")


def _ancestors(frame: str, above: Mapping[str, str]) -> list[str]:
    """Return a frame, its parent, the parent of that, and so on; each frame once, if frames form a loop."""
    path = [frame]
    while path[-1] in above and above[path[-1]] not in path:
        path.append(above[path[-1]])
    return path


def _pose(message: Any) -> tuple[float, ...]:
    """Return x, y, z and the quaternion x, y, z, w of a message."""
    if hasattr(message, "transform"):
        point, turn = message.transform.translation, message.transform.rotation
    else:
        pose = message.pose.pose if hasattr(message.pose, "pose") else message.pose
        point, turn = pose.position, pose.orientation
    return point.x, point.y, point.z, turn.x, turn.y, turn.z, turn.w


def _trajectory(rows: list[Any], source: str) -> Trajectory:
    times = np.array([row[0] for row in rows], dtype=np.int64)
    values = np.array([row[1:] for row in rows], dtype=np.float64).reshape(-1, 7)
    return Trajectory.of(times / 1e9, values[:, :3], values[:, 3:], source)


def proposed(topics: Mapping[str, tuple[str, int]], frames: Iterable[Edge]) -> dict[str, str]:
    """Return the sources that a recording most likely means: "images", "poses" and "odometry", where there are any.

    Images of a camera for all directions come before others, and depth comes last. Poses are those of a topic that is
    named after a source of true poses, else the robot in the frame "map", else AMCL's, which are mostly the same ones
    less often, else the robot in the frame "world", else those of another topic with poses along a drive.
    """
    kinds = {name: KINDS.get(kind, "") for name, (kind, _) in topics.items()}
    counts = {name: count for name, (_, count) in topics.items() if count}

    def holds(name: str, words: tuple[str, ...]) -> bool:
        return any(word in name.lower() for word in words)

    def best(kind: str, words: tuple[str, ...]) -> list[str]:
        names = [name for name in counts if kinds[name] == kind]
        return sorted(names, key=lambda name: (not holds(name, words), -counts[name], name))

    def below(parent: str) -> list[str]:
        above = {lower: upper for upper, lower in frames}
        return [f"{parent}:{robot}" for robot in _BASES if parent in _ancestors(robot, above)[1:]]

    true = ("truth", "gt", "vicon", "mocap", "slam")
    poses = [name for name in best("poses", (*true, "pose")) if counts[name] >= _FEW]
    poses = [name for name in poses if not holds(name, _NOT_OF_THE_ROBOT)]
    named, amcl = ([name for name in poses if holds(name, words)] for words in (true, ("amcl",)))
    wheels = best("odometry", ("wheel", "odom"))
    images = best("images", ("omni", "360", "pano", "equirect", "fisheye", "theta"))
    candidates = {
        "images": sorted(images, key=lambda name: holds(name, _NOT_PICTURES)),
        "poses": [*named, *below("map"), *amcl, *below("world"), *poses, *(name for name in wheels if "truth" in name)],
        "odometry": [*(name for name in wheels if "truth" not in name), *below("odom")],
    }
    return {what: names[0] for what, names in candidates.items() if names}
