"""Shared by the tests of the commands: drawn drives, and one trained, mapped, evaluated and exported run."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.drawn import altered, write_manifest
from tests.siamloc.cli.commands import SMALL, done

DRIVES = {"first": "cloudy", "second": "cloudy", "third": "cloudy", "dark": "night"}
HOUSES = {"kitchen": "north", "office": "north", "corridor": "south"}


@pytest.fixture(scope="session")
def flat(tmp_path_factory) -> Path:
    """A manifest of four drives of 24 frames through three rooms."""
    return write_manifest(tmp_path_factory.mktemp("flat"), DRIVES, frames_per_room=8)


@pytest.fixture(scope="session")
def town(flat) -> Path:
    """A manifest of the same drives, in which the rooms belong to two buildings."""
    return altered(flat, "town.csv", lambda row: {"building": HOUSES[row["room"]]})


@pytest.fixture(scope="session")
def data(flat) -> list[str]:
    """Name the drives."""
    return [f"data.manifest={flat}", "data.image_size=[32,128]", f"data.cache={flat.parent / 'cache'}"]


@pytest.fixture(scope="session")
def words(data) -> list[str]:
    """Name the drives and their roles: 24 map frames, 48 queries and 24 validation frames."""
    queries, validation = "protocol.query.sequences=[second,dark]", "protocol.validation.sequences=[third]"
    return [*data, "protocol.map.sequences=[first]", queries, validation]


@pytest.fixture(scope="session")
def trained(data, tmp_path_factory) -> Path:
    """A run whose network learned the rooms, with its map."""
    run = tmp_path_factory.mktemp("trained") / "run"
    roles = ["protocol.train.sequences=[first]", "protocol.validation.sequences=[dark]"]
    done("train", "data=manifest", *data, *roles, *SMALL, "pairs=room", "epochs=8", f"run={run}")
    done("map", f"run={run}")
    return run


@pytest.fixture(scope="session")
def finished(flat, trained, tmp_path_factory) -> Path:
    """The trained run with headings in its map, evaluated with an error model, exported, and its queries located."""
    run = Path(shutil.copytree(trained, tmp_path_factory.mktemp("finished") / "run"))
    done("map", f"run={run}", "heading=hog", "heading.step=4")
    learned = ["task.error_model=true", "task.lost_above=1.5"]
    done("evaluate", f"run={run}", "protocol.query.sequences=[second]", *learned)
    done("export", f"run={run}")
    done("localize", f"run={run}", f"images=[{flat.parent / 'second'}]")
    return run


@pytest.fixture
def run(finished, tmp_path) -> Path:
    """A copy of the finished run, to be changed."""
    return Path(shutil.copytree(finished, tmp_path / "run"))
