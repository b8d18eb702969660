"""Finding a building by its name, by its file, or by drawing one."""

from __future__ import annotations

from pathlib import Path

from siamloc.errors import DataError, hint
from siamloc.simulate.layout import Building
from siamloc.simulate.parse import parse_building, read_building_file
from siamloc.simulate.plan import check_paths

_ATTEMPTS = 20
_STRIDE = 1_000_003


def building_folder() -> Path:
    """Return the folder of the built-in buildings: of the source tree, or of the installed package."""
    package = Path(__file__).resolve().parents[1]
    beside = package.parent / "conf" / "building"
    return beside if beside.is_dir() else package / "conf" / "building"


def building_names() -> list[str]:
    """Return the names that `load_building` knows."""
    return [*sorted(path.stem for path in building_folder().glob("*.yaml") if path.stem != "random"), "random"]


def load_building(name_or_path: str | Path, seed: int = 0) -> Building:
    """Load and check a building.

    Args:
        name_or_path: a built-in name, "random" for one drawn from the seed, or a YAML file.
        seed: draws its pictures, colours and small differences; and all of it for "random".

    Raises:
        DataError: no such building, or one that cannot stand; the message names the room and the line.
    """
    name = str(name_or_path)
    if name == "random":
        from siamloc.simulate.draw import draw_building

        for attempt in range(_ATTEMPTS):
            # Rarely a chair comes to stand in the path; then the next draw of the same seed is taken.
            drawn = draw_building(seed + attempt * _STRIDE)
            building = parse_building(drawn, seed, f"random building of seed {seed}")
            try:
                check_paths(building)
            except DataError:
                if attempt == _ATTEMPTS - 1:
                    raise
            else:
                break
    else:
        path = Path(name_or_path).expanduser()
        if path.suffix not in (".yaml", ".yml"):
            if name not in building_names():
                raise DataError(f"there is no building {name!r}; {hint(name, building_names())}, or a YAML file")
            path = building_folder() / f"{name}.yaml"
        building = read_building_file(path, seed)
    check_paths(building)
    return building
