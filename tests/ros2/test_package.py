"""The files around the node: package.xml by the rules of REP 149, and what is installed, started and explained."""

import ast
import re
import runpy
import sys
from configparser import ConfigParser
from pathlib import Path
from types import ModuleType, SimpleNamespace
from xml.etree import ElementTree

import pytest
import yaml

import siamloc
from tests.ros2.conftest import PACKAGE

NAME = "siamloc_ros"
DEPENDENCIES = {
    *("depend", "build_depend", "build_export_depend", "buildtool_depend", "buildtool_export_depend"),
    *("exec_depend", "doc_depend", "test_depend", "conflict", "replace", "group_depend", "member_of_group"),
}
ONCE, SEVERAL = {"name", "version", "description", "export"}, {"maintainer", "license", "author", "url"}
ORDER = (
    *("name", "version", "description", "maintainer", "license", "url", "author"),
    *("dependencies", "group_depend", "member_of_group", "export"),
)
"""The schema of format 3 is a sequence."""


@pytest.fixture(scope="module")
def manifest():
    return ElementTree.parse(PACKAGE / "package.xml").getroot()


def test_the_manifest_keeps_the_rules_of_format_3(manifest):
    assert (manifest.tag, manifest.attrib) == ("package", {"format": "3"})
    tags = [one.tag for one in manifest]
    assert set(tags) <= ONCE | SEVERAL | DEPENDENCIES
    assert all(tags.count(tag) == 1 for tag in ONCE)
    assert {"maintainer", "license"} <= set(tags)
    places = [ORDER.index(tag if tag in ORDER else "dependencies") for tag in tags]
    assert places == sorted(places)
    assert re.fullmatch(r"[a-z](?:_?[a-z0-9])+", manifest.findtext("name"))
    assert re.fullmatch(r"\d+\.\d+\.\d+", manifest.findtext("version"))
    assert all(re.fullmatch(r"[^@\s]+@[^@\s]+", one.attrib["email"]) for one in manifest.iter("maintainer"))
    assert all(one.text and one.text.strip() == one.text for one in manifest if one.tag not in ("export",))
    pairs = [(one.tag, one.text) for one in manifest if one.tag in DEPENDENCIES]
    assert len(pairs) == len(set(pairs))
    assert [one.text for one in manifest.find("export").iter("build_type")] == ["ament_python"]


def imported(path):
    nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    names = [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    return {name.split(".")[0] for name in [*names, *(one.module for one in nodes if isinstance(one, ast.ImportFrom))]}


def test_the_manifest_declares_what_is_imported(manifest):
    files = [*(PACKAGE / NAME).glob("*.py"), *(PACKAGE / "launch").glob("*.py")]
    used = {name for path in files for name in imported(path)} - {*sys.stdlib_module_names, "siamloc", NAME}
    other = {"numpy": "python3-numpy", "cv2": "python3-opencv"}
    assert {other.get(name, name) for name in used} == {one.text for one in manifest.iter("exec_depend")}


def test_what_is_installed_exists_and_agrees_with_the_manifest(manifest, monkeypatch):
    given = {}
    setuptools = ModuleType("setuptools")
    setuptools.setup = given.update
    monkeypatch.setitem(sys.modules, "setuptools", setuptools)
    runpy.run_path(str(PACKAGE / "setup.py"))
    assert (given["name"], given["license"]) == (manifest.findtext("name"), manifest.findtext("license"))
    assert given["version"] == manifest.findtext("version") == siamloc.__version__
    assert given["description"] == manifest.findtext("description")
    files = dict(given["data_files"])
    assert files["share/ament_index/resource_index/packages"] == [f"resource/{NAME}"]  # so ROS finds the package
    assert files[f"share/{NAME}"] == ["package.xml"]
    assert all((PACKAGE / path).is_file() for paths in files.values() for path in paths)
    (script,) = given["entry_points"]["console_scripts"]
    assert script == f"localizer = {NAME}.node:main"
    settings = ConfigParser()
    settings.read(PACKAGE / "setup.cfg", encoding="utf-8")
    assert settings["install"]["install_scripts"] == f"$base/lib/{NAME}"  # where `ros2 run` looks
    assert settings["build_scripts"]["executable"] == "/usr/bin/env python3"  # of a virtual environment


def test_the_parameters_are_explained_with_their_defaults(node):
    text = (PACKAGE / "config" / "localizer.yaml").read_text(encoding="utf-8")
    assert yaml.safe_load(text) == {"/**": {"ros__parameters": node.DEFAULTS}}
    lines = text.partition("ros__parameters:\n")[2].splitlines()
    assert all(re.fullmatch(r" +\w+: \S+  # .+", line) for line in lines)


@pytest.fixture
def launched(monkeypatch):
    """The arguments of the launch file, and a function that starts the node with some of them given."""
    made = {
        "ament_index_python.packages": {"get_package_share_directory": lambda name: f"/share/{name}"},
        "launch": {"LaunchDescription": list},
        "launch.actions": {
            "DeclareLaunchArgument": lambda name, **given: SimpleNamespace(name=name, **given),
            "OpaqueFunction": SimpleNamespace,
        },
        "launch.substitutions": {
            "LaunchConfiguration": lambda name: SimpleNamespace(perform=lambda given: given[name])
        },
        "launch_ros.actions": {"Node": SimpleNamespace},
        "launch_ros": {},
        "ament_index_python": {},
    }
    for name, content in made.items():
        module = ModuleType(name)
        module.__dict__.update(content)
        monkeypatch.setitem(sys.modules, name, module)
    described = runpy.run_path(str(PACKAGE / "launch" / "localizer.launch.py"))["generate_launch_description"]()
    *arguments, starting = described
    usual = {one.name: one.default_value for one in arguments}

    def start(**given):
        (started,) = starting.function({**usual, **given})
        return started

    return arguments, start


def test_the_launch_file_starts_the_node_with_its_topics(node, launched):
    arguments, start = launched
    file = Path("/share") / NAME / "config" / "localizer.yaml"
    started = start()
    assert (started.package, started.executable, started.namespace) == (NAME, "localizer", "")
    assert [Path(one) for one in started.parameters] == [file]  # which names the bundle, if no argument does
    source = (PACKAGE / NAME / "node.py").read_text(encoding="utf-8")
    assert all(f'"{topic}"' in source for topic, _ in started.remappings)
    started = start(bundle="/b", publish_tf="true", track="false", namespace="robot1", image="/camera", params_file="p")
    assert started.parameters == ["p", {"bundle": "/b", "publish_tf": True, "track": False}]
    assert started.namespace == "robot1"
    assert dict(started.remappings) == {"image": "/camera", "image/compressed": "/camera/compressed", "odom": "odom"}
    flags = {one.name for one in arguments if hasattr(one, "choices")}
    assert flags == {"publish_tf", "track", "compressed"} <= set(node.DEFAULTS)
