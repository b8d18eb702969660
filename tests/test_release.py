"""What a release says of itself: one version, one changelog, files that hosts and tools read."""

import re
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest
import yaml

import siamloc

ROOT = Path(__file__).parents[1]
TARGETS = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), flags=re.MULTILINE))
WORKFLOWS = sorted((ROOT / ".github/workflows").glob("*.yml"))


def read(name):
    return (ROOT / name).read_text(encoding="utf-8")


def test_the_version_stands_in_one_place_and_the_files_for_people_follow_it():
    assert 'dynamic = ["version"]' in read("pyproject.toml")
    newest = re.search(r"^## (\S+) - (\d{4}-\d\d-\d\d)$", read("CHANGELOG.md"), flags=re.MULTILINE)
    cited = yaml.safe_load(read("CITATION.cff"))
    assert newest.groups() == (siamloc.__version__, cited["date-released"])
    assert cited["version"] == siamloc.__version__
    assert re.search(r'^__version__ = "\d+\.\d+\.\d+"$', read("siamloc/__init__.py"), flags=re.MULTILINE)


def test_versions_of_the_changelog_fall():
    found = re.findall(r"^## (\d+)\.(\d+)\.(\d+) - (\S+)$", read("CHANGELOG.md"), flags=re.MULTILINE)
    assert len(found) == read("CHANGELOG.md").count("\n## ")
    order = [(*map(int, numbers), date) for *numbers, date in found]
    assert order == sorted(order, reverse=True)


def test_the_citation_has_what_its_format_requires():
    cited = yaml.safe_load(read("CITATION.cff"))
    assert {"cff-version", "message", "title", "authors"} <= set(cited)
    assert all({"type", "title", "authors"} <= set(one) for one in cited["references"])
    assert cited["license"] == "MIT"
    assert cited["authors"][0]["name"] in read("LICENSE")


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_workflows_run_targets_of_the_makefile(path):
    workflow = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert {"push", "pull_request"} <= set(workflow[True])  # YAML 1.1 reads the key `on` as a truth value
    runs = [step["run"] for job in workflow["jobs"].values() for step in job["steps"] if "run" in step]
    assert runs
    assert all(re.fullmatch(r"make [a-z-]+", run) for run in runs)
    assert {run.removeprefix("make ") for run in runs} <= TARGETS
    assert {"make test-all", "make dist"} <= set(runs)
    declared = set(re.findall(r"Python :: (3\.\d+)", read("pyproject.toml")))
    assert set(workflow["jobs"]["tests"]["strategy"]["matrix"]["python"]) == declared


def test_pre_commit_runs_the_lint_of_the_makefile():
    hooks = [hook for repo in yaml.safe_load(read(".pre-commit-config.yaml"))["repos"] for hook in repo["hooks"]]
    assert [hook["entry"] for hook in hooks] == ["make lint"]
    assert "lint" in TARGETS


def test_the_model_card_begins_with_what_model_hubs_read():
    _, front, text = read("siamloc/models/shipped/README.md").split("---\n", 2)
    card = yaml.safe_load(front)
    assert card["license"] == "mit"
    assert card["library_name"] == "siamloc"
    assert text.startswith("# Model card")


@pytest.mark.parametrize("path", sorted((ROOT / "containers").glob("*.Dockerfile")), ids=lambda path: path.stem)
def test_containers_install_extras_that_exist_for_an_ordinary_user_and_check_themselves(path):
    lines = path.read_text(encoding="utf-8").splitlines()
    (extras,) = re.findall(r"'/source\[([\w,-]+)\]'", path.read_text(encoding="utf-8"))
    declared = re.findall(
        r"^([\w-]+) = \[", read("pyproject.toml").partition("optional-dependencies]")[2], re.MULTILINE
    )
    assert set(extras.split(",")) <= set(declared)
    last = lines[max(i for i, line in enumerate(lines) if line.startswith("FROM ")) :]
    assert last.index("USER siamloc") < last.index("RUN siamloc doctor")
    assert not [line for line in last if re.search("gcc|build-essential|pip install", line)]


def test_the_sources_of_a_container_are_what_the_wheel_is_built_from():
    sent = {line[1:] for line in read(".dockerignore").splitlines() if line.startswith("!")}
    assert all((ROOT / name).exists() for name in sent)
    packages = re.search(r"wheel\]\npackages = \[(.*)\]", read("pyproject.toml"))[1]
    assert {*re.findall(r'"(\w+)"', packages), "conf", "README.md", "LICENSE", "pyproject.toml"} <= sent


@pytest.mark.slow
def test_torch_hub_loads_the_shipped_network_from_a_folder(tmp_path):
    code = f"""
import sys, torch
network = torch.hub.load({str(ROOT)!r}, "pretrained", source="local", relative=False)
print(sys.modules["siamloc"].__file__, tuple(network(torch.zeros(1, 3, 64, 256)).shape))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("(1, 2048)\n")


@pytest.mark.slow
def test_the_files_of_a_release_hold_the_packages_and_nothing_of_the_tests(tmp_path):
    build = pytest.importorskip("build", reason="`make dist` installs it")
    command = [sys.executable, "-m", build.__name__, "--no-isolation", "--outdir", str(tmp_path), str(ROOT)]
    pytest.importorskip("hatchling", reason="the build backend is not installed")
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (wheel,), (source,) = tmp_path.glob("*.whl"), tmp_path.glob("*.tar.gz")
    assert f"-{siamloc.__version__}-" in wheel.name
    inside = set(zipfile.ZipFile(wheel).namelist())
    assert {"siamloc/models/shipped/panoramas.safetensors", "siamloc/conf/building/mini.yaml"} <= inside
    with tarfile.open(source) as archive:
        names = {name.split("/", 1)[-1] for name in archive.getnames()}
    assert {"conf/building/mini.yaml", "CHANGELOG.md", "CITATION.cff", "LICENSE"} <= names
    assert not [name for name in names | inside if name.startswith(("tests", "docs", "benchmarks"))]
