"""Finding a building by its name or its file, or drawing one: rooms of random use and width along a corridor."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from siamloc.errors import DataError, hint
from siamloc.simulate.layout import Building, seeded
from siamloc.simulate.parse import parse_building, read_building_file
from siamloc.simulate.plan import check_paths

_ATTEMPTS = 20
_STRIDE = 1_000_003


def building_folder() -> Path:
    """Return the folder of the built-in buildings: of the source tree, or of the installed package."""
    package = Path(__file__).resolve().parents[1]
    sources = package.parent / "conf" / "building"
    return sources if sources.is_dir() else package / "conf" / "building"


def building_names() -> list[str]:
    """Return the names that `load_building` knows.

    >>> building_names()
    ['annex', 'freiburg_like', 'mini', 'random']
    """
    return [*sorted(path.stem for path in building_folder().glob("*.yaml") if path.stem != "random"), "random"]


def load_building(name_or_path: str | Path, seed: int = 0) -> Building:
    """Load and check a building.

    Args:
        name_or_path: a built-in name, "random" for one drawn from the seed, or a YAML file.
        seed: draws its pictures, colours and small differences; and all of it for "random".

    >>> load_building("mini")
    Building('mini', seed=0: rooms CR-A, 1PO-A, 2PO1-A, KT-A; 37 items; paths path1, path2)

    Raises:
        DataError: no such building, or an impossible one; the message names the room and the line.
    """
    name = str(name_or_path)
    if name == "random":
        for attempt in range(_ATTEMPTS):
            # Now and then a chair blocks the path; then the next draw of the same seed is taken.
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


_CORRIDOR = 2.2
_USES = {
    "office": ("1PO-A", "2PO1-A", "2PO2-A", "2PO3-A", "2PO4-A"),
    "kitchen": ("KT-A",),
    "printer": ("PA-A",),
    "meeting": ("CNR-A",),
    "toilet": ("TL-A",),
}


def draw_building(seed: int) -> dict[str, Any]:
    """Return the content of a building file for a seed.

    A corridor runs along x with four to seven rooms on its two sides; `path1` visits every second one, `path2` all.
    """
    rng = seeded(seed, "random building")
    free = {use: list(codes) for use, codes in _USES.items()}
    rooms: dict[str, Any] = {}
    doors: list[dict[str, Any]] = []
    visits: list[tuple[float, int]] = []
    ends = []
    for side in (1, -1):
        x = 0.0
        for _ in range(int(rng.integers(2, 5))):
            open_uses = [use for use, codes in free.items() if codes]
            weights = np.array([3.0 if use == "office" else 1.0 for use in open_uses])
            use = str(rng.choice(open_uses, p=weights / weights.sum()))
            width, depth = float(rng.uniform(3.8, 5.4)), float(rng.uniform(4.2, 5.6))
            name = f"room_{len(rooms)}"
            gate = round(x + width * float(rng.uniform(0.42, 0.58)), 2)
            rooms[name] = _room(
                use, free[use].pop(0), round(x, 2), round(x + width, 2), round(depth, 2), side, gate, rng
            )
            doors.append({"between": ["corridor", name], "at": gate, "hinge": str(rng.choice(["low", "high"]))})
            visits.append((gate, side))
            x = round(x + width, 2)
        ends.append(x)
    length = max(ends)
    rooms["corridor"] = _corridor(length, rng)
    for number, (name, room) in enumerate(rooms.items()):
        if name != "corridor" and number % 2:
            room["paint"] = [round(float(v), 2) for v in rng.uniform(0.78, 1.0, 3)]
    visits.sort()
    return {
        "name": f"random_{seed}",
        "north": round(float(rng.uniform(0, 360)), 1),
        "height": round(float(rng.uniform(2.6, 3.0)), 2),
        "rooms": rooms,
        "doors": doors,
        "paths": {"path1": _path(visits[::2], length), "path2": _path(visits, length)},
    }


def _corridor(length: float, rng: np.random.Generator) -> dict[str, Any]:
    floor = str(rng.choice(["linoleum", "linoleum_green", "carpet_gray", "parquet"]))
    windows = [
        {"wall": wall, "at": 0.0, "width": 1.3, "sill": 0.7, "head": 2.3}
        for wall in ("west", "east")
        if rng.random() < 0.8
    ]
    return {
        "code": "CR-A",
        "x": [0.0, length],
        "y": [-_CORRIDOR / 2, _CORRIDOR / 2],
        "floor": floor,
        "lamps": [str(rng.choice(["tube", "panel"])), max(2, round(length / 2.6)), 1],
        "windows": windows,
        "items": [
            {"kind": str(kind), "against": str(wall), "at": round(float(at), 2)}
            for wall, at, kind in zip(
                rng.choice(["north", "south"], 8),
                np.linspace(0.8, length - 0.8, 8),
                rng.choice(["poster", "picture", "notice_board", "room_sign", "extinguisher", "clock"], 8),
                strict=True,
            )
        ],
    }


def _room(
    use: str, code: str, x0: float, x1: float, depth: float, side: int, gate: float, rng: np.random.Generator
) -> dict[str, Any]:
    near = side * _CORRIDOR / 2
    far = round(near + side * depth, 2)
    far_wall, near_wall = ("north", "south") if side > 0 else ("south", "north")

    def y(away: float) -> float:
        """Return the y coordinate at a distance from the corridor."""
        return round(near + side * away, 2)

    middle = y(depth * 0.55)
    items: list[dict[str, Any]] = []
    room: dict[str, Any] = {"code": code, "x": [x0, x1], "y": sorted([near, far]), "items": items}
    towards = 270 if side > 0 else 90
    if use == "office":
        room |= {"floor": str(rng.choice(["carpet", "carpet_red", "carpet_gray", "parquet"])), "lamps": ["panel", 2, 2]}
        wood = str(rng.choice(["beech", "wood", "walnut"]))
        for wall, x in (("west", x0 + 1.15), ("east", x1 - 1.15)):
            if wall == "west" or rng.random() < 0.6:
                items.append({"kind": "desk", "against": wall, "at": middle, "wood": wood,
                              "screens": int(rng.integers(1, 3))})  # fmt: skip
                items.append({"kind": "chair", "at": [round(x, 2), middle], "facing": 180 if wall == "west" else 0})
            else:
                items.append({"kind": "shelf", "against": wall, "at": middle, "wood": wood})
        items.append({"kind": "poster", "against": "east", "at": y(depth * 0.2)})
        items.append({"kind": "plant", "at": [round(x0 + 0.4, 2), y(depth - 0.45)]})
    elif use == "kitchen":
        room |= {"floor": "tiles_floor", "lamps": ["panel", 1, 2]}
        items.append({"kind": "kitchen_counter", "against": "west", "at": middle, "size": [2.2, 0.6, 0.9]})
        items.append({"kind": "table", "against": "east", "at": middle, "size": [1.2, 0.6, 0.74]})
        items.append({"kind": "fridge", "against": "west", "at": y(depth - 0.45)})
        items.append({"kind": "visitor_chair", "at": [round(x1 - 0.45, 2), y(depth * 0.55 - 1.0)], "facing": towards})
    elif use == "printer":
        room |= {"floor": "linoleum_green", "lamps": ["panel", 2, 1]}
        items.append({"kind": "copier", "against": "west", "at": middle})
        items.append({"kind": "pigeonholes", "against": "east", "at": middle})
        items.append({"kind": "shelf", "against": "west", "at": y(depth - 0.7), "content": "binders"})
    elif use == "meeting":
        room |= {"floor": "carpet_red", "lamps": ["panel", 2, 2]}
        items.append({"kind": "whiteboard", "against": "west", "at": middle})
        items.append({"kind": "sideboard", "against": "east", "at": middle})
        items.append({"kind": "table", "against": "east", "at": y(depth - 0.8), "size": [1.2, 0.8, 0.74]})
    else:
        room |= {"floor": "tiles_floor", "wainscot": ["tiles_wall", 2.0], "lamps": ["round", 2, 1]}
        items.append({"kind": "stall", "against": "east", "at": y(depth - 0.7), "size": [0.95, 1.15, 2.0]})
        items.append({"kind": "stall", "against": "east", "at": y(depth - 1.7), "size": [0.95, 1.15, 2.0]})
        items.append({"kind": "basins", "against": "west", "at": middle})
    width = float(rng.uniform(1.4, 2.2))
    window = round((x0 + x1) / 2 + float(rng.uniform(-0.4, 0.4)), 2)
    room["windows"] = [{"wall": far_wall, "at": window, "width": round(width, 2)}]
    items.append({"kind": "radiator", "against": far_wall, "at": window})
    if gate - x0 > 1.9:
        items.append({"kind": "coats", "against": near_wall, "at": round(x0 + 0.7, 2)})
    return room


def _path(visits: list[tuple[float, int]], length: float) -> list[list[float]]:
    """Return the waypoints of a drive through the corridor and into rooms, and back."""
    points = [[0.7, 0.0]]
    for gate, side in visits:
        near = side * _CORRIDOR / 2
        points.append([max(gate - 0.6, 0.7), 0.0])
        points += [[gate, side * 0.55], [gate, near], [gate, near + side * 1.9], [gate + 0.15, near + side * 2.6]]
        points += [[gate + 0.3, near + side * 2.4], [gate + 0.1, near + side * 1.6], [gate, near], [gate, side * 0.55]]
        points.append([min(gate + 0.6, length - 0.7), 0.0])
    points += [[length - 0.8, 0.0], [length - 1.0, 0.25], [0.7, 0.1]]
    return [[round(x, 3), round(y, 3)] for x, y in points]
