"""Building files: what is read, and the message for each mistake."""

from __future__ import annotations

import dataclasses
import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from foundation.settings import default_of, fields_of
from siamloc.cli import main
from siamloc.errors import DataError
from siamloc.simulate import parse
from siamloc.simulate.buildings import building_names, load_building
from siamloc.simulate.items import KINDS
from siamloc.simulate.parse import FARTHEST, HIGHEST, LOWEST
from siamloc.simulate.plan import clearance, obstacles, room_codes
from siamloc.simulate.textures import SURFACES

PLAN = """name: two
rooms:
  hall:
    code: CR-A
    x: [0, 6]
    y: [0, 2]
    floor: linoleum
    windows:
      - {wall: south, at: 3.0, width: 1.5}
  office:
    x: [0, 4]
    y: [2, 6]
    items:
      - {kind: desk, against: west, at: 4.5}
doors:
  - {between: [hall, office], at: 2.5}
paths:
  path1:
    - [1.0, 1.0]
    - [2.5, 1.0]
    - [2.5, 4.0]
"""


def load(tmp_path: Path, text: str) -> Any:
    path = tmp_path / "two.yaml"
    path.write_text(text, encoding="utf-8")
    return load_building(path)


def test_a_file_is_read(tmp_path: Path) -> None:
    building = load(tmp_path, PLAN)
    assert (list(building.rooms), building.codes) == (["hall", "office"], ["CR-A", "office"])
    assert [opening.kind for opening in building.openings] == ["leaf", "window"]
    desk = building.items[0]
    assert desk.kind == "desk"
    assert desk.x == pytest.approx(0.06 + KINDS["desk"].size[1] / 2)
    assert desk.facing == 0.0
    np.testing.assert_allclose(desk.footprint().min(axis=0), [0.06, 3.7])
    np.testing.assert_array_equal(building.paths["path1"], [[1, 1], [2.5, 1], [2.5, 4]])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("    - [2.5, 4.0]", "    - [3.8, 3.0]", r"two\.yaml: path 'path1' runs through a wall of room 'hall'"),
        ("    - [1.0, 1.0]\n    - [2.5, 1.0]\n    - [2.5, 4.0]", "    - [0.3, 4.4]\n    - [0.3, 4.5]",
         r"two\.yaml: path 'path1' leaves the free floor at \(0.30, 4.40\)"),
        ("    - [2.5, 4.0]", "    - [2.5, 4.5]\n    - [0.2, 4.5]",
         r"two\.yaml: path 'path1' runs through the desk of room 'office'"),
        ("at: 3.0, width: 1.5", "at: 5.8, width: 1.5", r"two\.yaml: a window .* south wall lies outside its wall"),
        ("wall: south", "wall: north", r"two\.yaml: a window of room 'hall' in its north wall .* into 'office'"),
        ("y: [2, 6]", "y: [1.5, 6]", r"two\.yaml: rooms 'hall' and 'office' overlap by 4.00 x 0.50 m"),
        ("linoleum", "linolium", r"two\.yaml: room 'hall': floor must be paint or .* or marble, got 'linolium'"),
        ("kind: desk", "kind: dask", r"two\.yaml: room 'office': item 'dask' is unknown; did you mean 'desk'"),
        ("at: 4.5", "at: 5.8", r"two\.yaml: room 'office': desk at .* sticks out of the room"),
        ("at: 4.5", "at: 4.5, size: [1, 1, 4]", r"room 'office': desk at .* up to 4.00 m, sticks out of the room"),
        ("at: 2.5}", "at: 4.2}", r"two\.yaml: the door .* lies outside its wall: x = 3.70 to 4.70"),
        ("[hall, office]", "[hall, attic]", r"two\.yaml: room 'attic' is unknown"),
        ("at: 2.5}", "at: 2.5}\n  - {between: [hall, office], at: 2.9}", r"two\.yaml: two openings .* overlap"),
        ("x: [0, 4]", "x: [0]", r"two\.yaml: room 'office': x must be a list of 2: a number, a number, got \[0\]"),
        ("x: [0, 4]", "x: [4, 0]", r"two\.yaml: room 'office' must be at least 0.8 m wide"),
        ("x: [0, 4]", "x: [0, 4000]", r"room 'office': x must lie within 1000 m of 0, .* 4000: lengths are in metres"),
        ("y: [2, 6]", "y: [2, 6]\n    height: 0.5", r"room 'office' must be 1.25 .* camera is 0.95 m .* height 0.5"),
        ("name: two", "name: two\nheight: 2800", r"room 'hall' must be .* to 200 m high, .* height 2800: lengths"),
        ("at: 2.5}", "at: 2.5, height: 1.0}", r"the door between 'hall' and 'office' must begin .* got 0 to 1;"),
        ("at: 2.5}", "at: 2.5, bottom: 0.5}", r"the door between 'hall' and 'office' must begin .* got 0.5 to 2.1;"),
        ("at: 2.5}", "at: 2.5, bottom: 0.11}", r"at the floor, or at most 0.1 m above it, .* got 0.11 to 2.1;"),
        ("code: CR-A", "kode: CR-A", r"two\.yaml: room 'hall': unknown key kode: did you mean 'code'"),
        ("y: [2, 6]", "y: [2.5, 6]", r"two\.yaml: rooms 'hall' and 'office' share no wall"),
        ("rooms:", "rooms: [", r"is not YAML"),
        ("name: two", "name: two floors", r"two\.yaml: a building: name must be a word of letters, digits"),
        ("name: two", "name: 2023-99-01\nnorth: 2023-99-01", r"is not YAML"),
        ("code: CR-A", "code: CR A", r"two\.yaml: room 'hall': code must be a word .*, got 'CR A'"),
        ("  office:", "  big office:", r"two\.yaml: room 'big office': without a 'code' of its own, its name must be"),
        ("floor: linoleum", "[a]: 1\n    [a]: 2", r"two\.yaml, line 7, is not YAML: found unhashable key$"),
        ("floor: linoleum", "windows: []", r"two\.yaml, line 8, is not YAML: the key 'windows' appears twice$"),
        ("{wall: south, at: 3.0, width: 1.5}", "south", r"a window of room 'hall' must be a mapping .*, got 'south'"),
        ("- {kind: desk, against: west, at: 4.5}", "kind: desk", r"two\.yaml: room 'office': items must be a list"),
        ("at: 4.5", "at: 4.5, content: books", r"desk has no option 'content'; valid: screens, wood"),
        ("kind: desk", "kind: poster, picture: a cat", r"poster: picture must be a whole number .*, got 'a cat'"),
        ("against: west, at: 4.5", "at: 4.5", r"two\.yaml: room 'office': desk: at must be a list of 2: .*, got 4.5"),
        ("between: [hall, office], ", "", r"two\.yaml: a door needs 'between'"),
        ("    - [2.5, 4.0]", "    - [2.5, north]", r"two\.yaml: path 'path1': a point must be a list of 2: a number"),
    ],
)  # fmt: skip
def test_mistakes_name_the_room(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in PLAN
    with pytest.raises(DataError, match=message):
        load(tmp_path, PLAN.replace(old, new, 1))


def test_a_door_may_have_a_threshold(tmp_path: Path) -> None:
    assert load(tmp_path, PLAN.replace("at: 2.5}", "at: 2.5, bottom: 0.02}")).openings[0].bottom == 0.02


def test_unknown_buildings_and_files(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"no building 'freiburg'; did you mean 'freiburg_like'"):
        load_building("freiburg")
    with pytest.raises(DataError, match=r"none.yaml cannot be read: No such file or directory$"):
        load_building(tmp_path / "none.yaml")
    assert building_names() == ["annex", "freiburg_like", "mini", "random"]


@pytest.mark.parametrize("name", ["annex", "freiburg_like", "mini"])
def test_built_in_buildings_are_possible(name: str) -> None:
    building = load_building(name)
    segments, _ = obstacles(building)
    for points in building.paths.values():
        assert clearance(points, segments).min() > 0.2
        assert "" not in room_codes(building, points)
    assert set(room_codes(building, building.paths["path2"])) == set(building.codes)
    nine = {"1PO-A", "2PO1-A", "2PO2-A", "CR-A", "KT-A", "LO-A", "PA-A", "ST-A", "TL-A"}
    assert name != "freiburg_like" or set(building.codes) == nine


PAGE = (Path(__file__).parents[3] / "docs/howto/building.md").read_text(encoding="utf-8")
SECTIONS = {part.partition("\n")[0].split()[-1]: part for part in PAGE.split("\n## ")}


def test_the_file_on_the_page_is_simulated_as_it_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    file, command = re.findall(r"^```\w*\n(.*?)^```", PAGE, flags=re.DOTALL | re.MULTILINE)
    Path("floor.yaml").write_text(file, encoding="utf-8")
    assert main([*shlex.split(command)[1:], "frames=1", "workers=1"]) == 0
    assert len(list(Path("data/floor/part_a").rglob("*.jpeg"))) == 2


@pytest.mark.parametrize("entry", [parse._Building, parse._Room, parse._Door, parse._Window, parse._Item])
def test_the_page_lists_every_key_with_its_default(entry: type[Any]) -> None:
    rows = re.findall(r"^\| (`.*?`) \| (.*?) \|", SECTIONS[entry.__name__[1:].lower()], flags=re.MULTILINE)
    written = {key: without for keys, without in rows for key in re.findall(r"\w+", keys)}
    assert set(written) == set(fields_of(entry))
    for key, default in ((one.name, default_of(one)) for one in dataclasses.fields(entry)):
        if default is dataclasses.MISSING:
            assert written[key] == "required"
        elif default is not None and key != "picture":  # which is drawn if the file has none
            assert f"`{_flow(default)}`" in written[key], key


def _flow(value: Any) -> str:
    """Write a value as YAML does within a line."""
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(_flow, value))}]"
    return str(value).lower() if isinstance(value, bool) else f"{value:g}" if isinstance(value, float) else str(value)


def test_the_page_lists_every_surface_and_kind_of_item() -> None:
    text = " ".join(PAGE.split())
    assert f"Surfaces: {', '.join(f'`{name}`' for name in SURFACES)}." in text
    assert f"farther than {FARTHEST:,g} m from 0, or are not {LOWEST:g} to {HIGHEST:g} m high" in text
    found = {}
    for part, blocks in zip(SECTIONS["item"].split("These hang"), (True, False), strict=True):
        for line in part.split("\n- ")[1:]:
            options = tuple(re.findall(r"`(\w+)`", line.partition(":")[0]))
            for kind, size, z in re.findall(r"`(\w+) (\S+ x \S+ x [\d.]+)(?: at (\S+))?`", line):
                found[kind] = tuple(map(float, size.split(" x "))), float(z or 0), blocks, options
    assert found == {name: (kind.size, kind.z, kind.blocks, kind.options) for name, kind in KINDS.items()}
