"""ROS 2 without ROS: modules with the real names, whose messages have the fields and the checks of the real ones.

The definitions of the messages are those that the package rosbags ships. As in rclpy, a message begins with zeros,
takes its fields by name, and refuses a value of another type.
"""

from __future__ import annotations

from array import array
from collections import defaultdict
from types import ModuleType, SimpleNamespace
from typing import Any, ClassVar

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
PACKAGES = (
    *("builtin_interfaces", "diagnostic_msgs", "geometry_msgs", "nav_msgs", "rcl_interfaces", "sensor_msgs"),
    *("std_msgs", "tf2_msgs"),
)
_DEFAULTS = {("geometry_msgs/msg/Quaternion", "w"): 1.0}  # the other fields of these messages begin with zeros
_ZEROS = {"string": "", "bool": False, "byte": b"\0", "float32": 0.0, "float64": 0.0}


class Message:
    """A message of a kind, with its fields and their types."""

    KIND: ClassVar[str]
    FIELDS: ClassVar[dict[str, Any]]

    def __init__(self, **given: Any) -> None:
        assert given.keys() <= self.FIELDS.keys(), f"{self.KIND} has no {given.keys() - self.FIELDS.keys()}"
        for name, kind in self.FIELDS.items():
            setattr(self, name, given[name] if name in given else _DEFAULTS.get((self.KIND, name), _zero(kind)))

    def __setattr__(self, name: str, value: Any) -> None:
        assert name in self.FIELDS, f"{self.KIND} has no field {name}"
        assert _fits(self.FIELDS[name], value), f"{self.KIND}.{name} cannot be {value!r}"
        object.__setattr__(self, name, value)

    def serialized(self) -> bytes:
        """Return the message as it would be sent; fails if it does not fit the definition."""
        return bytes(STORE.serialize_cdr(_plain(self), self.KIND))


def _zero(kind: tuple[Nodetype, Any]) -> Any:
    node, detail = kind
    if node == Nodetype.NAME:
        return CLASSES[detail]()
    if node == Nodetype.BASE:
        return _ZEROS.get(detail[0], 0)
    return np.zeros(detail[1]) if node == Nodetype.ARRAY else array("B") if detail[0][1] == ("uint8", 0) else []


def _fits(kind: tuple[Nodetype, Any], value: Any) -> bool:
    node, detail = kind
    if node == Nodetype.NAME:
        return isinstance(value, CLASSES[detail])
    if node == Nodetype.BASE:
        name = detail[0]
        if "int" in name:
            bits, sign = int(name.partition("int")[2]), not name.startswith("u")
            return isinstance(value, int) and -(2 ** (bits - 1)) * sign <= value < 2 ** (bits - sign)
        return isinstance(value, type(_ZEROS[name])) and (name != "byte" or len(value) == 1)
    if node == Nodetype.ARRAY:
        return isinstance(value, np.ndarray) and value.dtype == np.float64 and value.shape == (detail[1],)
    if detail[0][1] == ("uint8", 0):
        return isinstance(value, (bytes, bytearray)) or (isinstance(value, array) and value.typecode == "B")
    return isinstance(value, list) and all(_fits(detail[0], one) for one in value)


def _plain(value: Any) -> Any:
    """Return a value of a message as rosbags takes it."""
    if isinstance(value, Message):
        fields = {name: _plain(getattr(value, name)) for name in value.FIELDS}
        return STORE.types[value.KIND](**fields)
    if isinstance(value, bytes) and len(value) == 1:
        return value[0]
    if isinstance(value, (bytes, bytearray, array)):
        return np.frombuffer(value, dtype=np.uint8)
    return [_plain(one) for one in value] if isinstance(value, list) else value


def _class(kind: str) -> type[Message]:
    constants, fields = STORE.fielddefs[kind]
    values = {name: bytes([value]) if base == "byte" else value for name, base, value in constants}
    return type(kind.rpartition("/")[2], (Message,), {**values, "KIND": kind, "FIELDS": dict(fields)})


CLASSES = {kind: _class(kind) for kind in STORE.fielddefs if kind.partition("/")[0] in PACKAGES}


class Trigger:
    """std_srvs/srv/Trigger."""

    Request = SimpleNamespace

    class Response:
        """Its answer."""

        def __init__(self) -> None:
            self.success, self.message = False, ""


class Node:
    """A node whose publishers keep what is published, by topic, and whose parameters are given before."""

    given: ClassVar[dict[str, Any]] = {}
    now: ClassVar[tuple[int, int]] = (0, 0)

    def __init__(self, name: str) -> None:
        self.name, self.declared, self.said = name, dict[str, Any](), list[str]()
        self.published: dict[str, list[Any]] = defaultdict(list)
        self.subscribed: dict[str, Any] = {}
        self.services: dict[str, Any] = {}
        self.qualities: dict[str, Any] = {}
        self.groups: dict[str, Any] = {}
        self.timers: list[Any] = []

    def declare_parameter(self, name: str, value: Any, descriptor: Any) -> SimpleNamespace:
        chosen = self.declared[name] = self.given.get(name, value)
        assert descriptor.dynamic_typing or type(chosen) is type(value), "InvalidParameterTypeException"
        return SimpleNamespace(value=chosen)

    def create_publisher(self, kind: type, topic: str, qos: Any) -> SimpleNamespace:
        def publish(message: Any) -> None:
            assert isinstance(message, kind)
            self.published[topic].append(STORE.deserialize_cdr(message.serialized(), message.KIND))

        return SimpleNamespace(publish=publish)

    def create_subscription(self, kind: type, topic: str, callback: Any, qos: Any, callback_group: Any = None) -> None:
        self.subscribed[topic], self.qualities[topic], self.groups[topic] = callback, qos, callback_group

    def create_timer(self, period: float, callback: Any, callback_group: Any = None) -> None:
        assert period > 0
        self.groups["timer"] = callback_group
        self.timers.append(callback)

    def get_clock(self) -> SimpleNamespace:
        sec, nanosec = self.now
        time = CLASSES["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
        return SimpleNamespace(now=lambda: SimpleNamespace(to_msg=lambda: time))

    def create_service(self, kind: type, name: str, callback: Any) -> None:
        self.services[name] = callback

    def get_logger(self) -> SimpleNamespace:
        def say(text: str, throttle_duration_sec: float = 0.0) -> None:
            self.said.append(text)

        return SimpleNamespace(error=say, warning=say)


class MultiThreadedExecutor:
    """Runs a node, here not at all."""

    def __init__(self, num_threads: int) -> None:
        assert num_threads > 1, "one thread serves no second callback group"

    def add_node(self, node: Node) -> None:
        """Take a node."""

    def spin(self) -> None:
        """Return at once."""


def modules() -> dict[str, ModuleType]:
    """Return the modules that the node imports, by name."""
    names = ("rclpy", "rclpy.callback_groups", "rclpy.executors", "rclpy.node", "rclpy.qos", "std_srvs.srv")
    found = {name: ModuleType(name) for name in names}
    found |= {name: ModuleType(name) for package in PACKAGES for name in (package, f"{package}.msg")}
    for kind, made in CLASSES.items():
        setattr(found[f"{kind.partition('/')[0]}.msg"], made.__name__, made)
    found["std_srvs"] = ModuleType("std_srvs")
    found["std_srvs.srv"].__dict__.update(Trigger=Trigger)
    found["rclpy"].__dict__.update(init=lambda: None, try_shutdown=lambda: None)
    found["rclpy.callback_groups"].__dict__.update(
        MutuallyExclusiveCallbackGroup=type("MutuallyExclusiveCallbackGroup", (), {})
    )
    found["rclpy.node"].__dict__.update(Node=Node)
    found["rclpy.executors"].__dict__.update(
        ExternalShutdownException=type("ExternalShutdownException", (Exception,), {}),
        MultiThreadedExecutor=MultiThreadedExecutor,
    )
    found["rclpy.qos"].__dict__.update(QoSProfile=SimpleNamespace, ReliabilityPolicy=SimpleNamespace(BEST_EFFORT=2))
    return found
