"""The ROS package on the path, and modules in place of ROS."""

import importlib
import sys
from pathlib import Path

import pytest

pytest.importorskip("rosbags", reason="the extra `recordings` is not installed")

from tests.ros2 import ros

PACKAGE = Path(__file__).parents[2] / "ros2" / "siamloc_ros"


def loaded(monkeypatch, name):
    """Import a module of the ROS package."""
    for module, made in ros.modules().items():
        monkeypatch.setitem(sys.modules, module, made)
    monkeypatch.syspath_prepend(PACKAGE)
    for known in [known for known in sys.modules if known.partition(".")[0] == "siamloc_ros"]:
        monkeypatch.delitem(sys.modules, known)
    return importlib.import_module(f"siamloc_ros.{name}")


@pytest.fixture
def messages(monkeypatch):
    return loaded(monkeypatch, "messages")


@pytest.fixture
def node(monkeypatch):
    return loaded(monkeypatch, "node")


@pytest.fixture
def odometry(monkeypatch):
    return loaded(monkeypatch, "odometry")
