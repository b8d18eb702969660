"""Find a building by its name or its file, or draw one."""

from __future__ import annotations

from pathlib import Path

from foundation.calls import typed
from siamloc.errors import DataError, hint
from siamloc.simulate.draw import draw_building
from siamloc.simulate.layout import Building
from siamloc.simulate.parse import parse_building, read_building_file
from siamloc.simulate.plan import check_paths


def building_folder() -> Path:
    """Return the folder of the built-in buildings, in the source tree or in the installed package."""
    package = Path(__file__).resolve().parents[1]
    sources = package.parent / "conf" / "building"
    return sources if sources.is_dir() else package / "conf" / "building"


def building_names() -> list[str]:
    """Return the names that `load_building` knows.

    >>> building_names()
    ['annex', 'freiburg_like', 'mini', 'random']
    """
    return [*sorted(path.stem for path in building_folder().glob("*.yaml") if path.stem != "random"), "random"]


@typed
def load_building(name_or_path: str | Path, seed: int = 0) -> Building:
    """Load and check a building.

    Args:
        name_or_path: a built-in name, "random" for a building drawn from the seed, or a YAML file.
        seed: seed of its pictures, colours and small differences; for "random", of the whole building.

    >>> load_building("mini")
    Building('mini', seed=0: rooms CR-A, 1PO-A, 2PO1-A, KT-A; 37 items; paths path1, path2)

    Raises:
        DataError: no such building, or an impossible one; the message names the room and the line.
    """
    name = str(name_or_path)
    if name == "random":
        return parse_building(draw_building(seed), seed, f"random building of seed {seed}")
    path = Path(name_or_path).expanduser()
    if path.suffix not in (".yaml", ".yml"):
        if name not in building_names():
            raise DataError(f"there is no building {name!r}; {hint(name, building_names())}, or a YAML file")
        path = building_folder() / f"{name}.yaml"
    building = read_building_file(path, seed)
    check_paths(building)
    return building
