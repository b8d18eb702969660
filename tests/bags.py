"""Bags of ROS that tests write."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("rosbags", reason="the extra `recordings` is not installed")
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore


class Written:
    """A bag that is being written: messages by their types' fields, as ROS names them."""

    def __init__(self, path: Path, form: str) -> None:
        self.one = form == "ros1"
        self.types = get_typestore(Stores.ROS1_NOETIC if self.one else Stores.ROS2_HUMBLE)
        if self.one:
            frames = "geometry_msgs/TransformStamped[] transforms"
            self.types.register(get_types_from_msg(frames, "tf2_msgs/msg/TFMessage"))
        self.path = path.with_suffix(".bag") if self.one else path
        plugin = {} if self.one else {"version": 9, "storage_plugin": rosbag2.StoragePlugin[form.upper()]}
        self.writer = (rosbag1 if self.one else rosbag2).Writer(self.path, **plugin)
        self.connections = {}

    def make(self, name, **fields):
        kind = self.types.types[name]
        if name == "std_msgs/msg/Header" and self.one:
            fields = {"seq": 0, **fields}
        if name == "sensor_msgs/msg/CameraInfo" and self.one:
            fields = {key.upper() if len(key) == 1 else key: value for key, value in fields.items()}
        return kind(**fields)

    def header(self, time, frame=""):
        sec, nanosec = divmod(time, 1_000_000_000)
        return self.make("std_msgs/msg/Header", stamp=self.make_time(sec, nanosec), frame_id=frame)

    def make_time(self, sec, nanosec):
        return self.types.types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)

    def pose(self, x, y, theta, kind="Pose", z=0.0):
        point, vector = ("position", "Point") if kind == "Pose" else ("translation", "Vector3")
        turn = "orientation" if kind == "Pose" else "rotation"
        at = self.make(f"geometry_msgs/msg/{vector}", x=float(x), y=float(y), z=z)
        look = self.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=np.sin(theta / 2), w=np.cos(theta / 2))
        return self.make(f"geometry_msgs/msg/{kind}", **{point: at, turn: look})

    def covariant(self, pose):
        return self.make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36))

    def write(self, topic, name, time, **fields):
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, name, typestore=self.types)
        serialize = self.types.serialize_ros1 if self.one else self.types.serialize_cdr
        self.writer.write(self.connections[topic], time, serialize(self.make(name, **fields), name))

    def image(self, topic, time, picture, encoding="bgr8", received=None, **fields):
        rows, columns = picture.shape[:2]
        values = {"height": rows, "width": columns, "encoding": encoding, "is_bigendian": 0, "step": picture.strides[0]}
        data = np.frombuffer(picture.tobytes(), dtype=np.uint8)
        values = {"header": self.header(time), **values, "data": data, **fields}
        self.write(topic, "sensor_msgs/msg/Image", received or time, **values)

    def odometry(self, topic, time, x, y, theta):
        zero = self.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
        twist = self.make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
        twist = self.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36))
        fields = {"child_frame_id": "base_link", "pose": self.covariant(self.pose(x, y, theta)), "twist": twist}
        self.write(topic, "nav_msgs/msg/Odometry", time, header=self.header(time, "odom"), **fields)

    def transform(self, topic, time, parent, child, x, y, theta, received=None, z=0.0):
        one = self.make(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(time, parent),
            child_frame_id=child,
            transform=self.pose(x, y, theta, "Transform", z),
        )
        self.write(topic, "tf2_msgs/msg/TFMessage", received or time, transforms=[one])


def jpeg(picture):
    return cv2.imencode(".jpg", picture)[1].tobytes()
