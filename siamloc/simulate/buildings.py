"""Find a building by its name or its file, or draw one from a seed.

What is drawn: plan, doors, windows, materials, furniture, and the robot's paths through it.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from pathlib import Path as FilePath
from typing import Any, Literal

import numpy as np

from foundation.calls import typed
from foundation.files import expanded
from siamloc.errors import DataError, hint
from siamloc.simulate.floor_plans import Cell, Kind, Plan, draw_plan
from siamloc.simulate.furnishing import USES, Room, furnish
from siamloc.simulate.layout import SIDES, Building, Rng, seeded
from siamloc.simulate.parse import parse_building, read_building_file
from siamloc.simulate.plan import blocked_points, check_paths
from siamloc.simulate.route import FreeSpace, visits
from siamloc.simulate.trajectory import rounded

Entry = dict[str, Any]
Worlds = Literal["offices", "any"]
"""Which random buildings are drawn: office floors and the like, or also homes, workshops and halls that gleam."""
_ATTEMPTS = 30
_SHARES: dict[Kind, float] = {"office": 0.3, "home": 0.4, "workshop": 0.15, "hall": 0.15}
_DENSITIES: dict[Kind, list[float]] = {
    "office": [0.5, 0.9, 1.3, 1.8],
    "home": [1.6, 2.4, 3.2],
    "workshop": [0.8, 1.2, 1.7],
    "hall": [0.3, 0.8, 1.4],
}


def building_folder() -> FilePath:
    """Return the folder of the built-in buildings, in the source tree or in the installed package."""
    package = FilePath(__file__).resolve().parents[1]
    sources = package.parent / "conf" / "building"
    return sources if sources.is_dir() else package / "conf" / "building"


def building_names() -> list[str]:
    """Return the names that `load_building` knows.

    >>> building_names()
    ['annex', 'freiburg_like', 'mini', 'random']
    """
    return [*sorted(path.stem for path in building_folder().glob("*.yaml") if path.stem != "random"), "random"]


@typed
def load_building(name_or_path: str | FilePath, seed: int = 0) -> Building:
    """Load and check a building.

    Args:
        name_or_path: a built-in name, "random" for a building drawn from the seed, or a YAML file.
        seed: seed of the building's pictures, colours and small differences; for "random", of the whole building.

    >>> load_building("mini")
    Building('mini', seed=0: rooms CR-A, 1PO-A, 2PO1-A, KT-A; 37 items; paths path1, path2)

    Raises:
        DataError: no such building, or an impossible one; the message names the room.
    """
    name = str(name_or_path)
    if name == "random":
        return random_building(seed)
    path = expanded(name_or_path)
    if path.suffix not in (".yaml", ".yml"):
        if name not in building_names():
            raise DataError(f"there is no building {name!r}; {hint(name, building_names())}, or a YAML file")
        path = building_folder() / f"{name}.yaml"
    building = read_building_file(path, seed)
    check_paths(building)
    return building


def random_building(seed: int, worlds: Worlds = "offices") -> Building:
    """Draw a building from a seed.

    Args:
        seed: equal seeds give equal buildings.
        worlds: "offices" draws office floors, flats and halls with matt surfaces; "any" also draws cluttered homes,
            workshops and high halls, and gives most buildings natural textures and surfaces that reflect.
    """
    kind: Kind = "office"
    materials = "drawn"
    if worlds == "any":
        rng = seeded(seed, "world")
        kind = list(_SHARES)[int(rng.choice(len(_SHARES), p=list(_SHARES.values())))]
        materials = "natural" if rng.random() < 0.85 else "drawn"
    content = draw_building(seed, kind)
    return parse_building({**content, "materials": materials}, seed, f"random building of seed {seed}")


def draw_building(seed: int, kind: Kind = "office") -> Entry:
    """Draw the content of a building file from a seed.

    `path1` visits every second room, `path2` all of them.

    Args:
        seed: equal seeds give equal buildings.
        kind: "office" draws offices along a corridor or around a core, a flat, or a hall; "home" small, cluttered
            rooms; "workshop" and "hall" a large, high room.

    >>> sorted(draw_building(3))
    ['doors', 'height', 'materials', 'name', 'north', 'paths', 'rooms']
    """
    key = "random building" if kind == "office" else kind
    for attempt in range(_ATTEMPTS):
        # Sometimes the furniture blocks the way, or a window meets a wall; then another building is drawn.
        with suppress(DataError):
            return _drawn(seed, seeded(seed, attempt, key), kind, attempt)
    return _drawn(seed, seeded(seed, _ATTEMPTS, key), kind, _ATTEMPTS)


def _drawn(seed: int, rng: Rng, kind: Kind, attempt: int) -> Entry:
    plan = draw_plan(rng, kind)
    doors = plan.place_doors(rng)
    materials = _materials(rng)
    windows = _window_style(rng, plan.height)
    if kind in ("workshop", "hall"):  # the windows of a high room reach up
        windows["head"] = round(max(windows["head"], plan.height * rng.uniform(0.5, 0.9)), 2)
    density = float(rng.choice(_DENSITIES[kind]))
    if kind != "office":  # crowded rooms often leave no way
        density *= 0.9**attempt
    numbers: dict[str, int] = {}
    rooms: Entry = {}
    for cell in plan.cells:
        use = USES[cell.use]
        numbers[cell.use] = numbers.get(cell.use, 0) + 1
        code = use.code.format("" if cell.use == "corridor" else numbers[cell.use])
        entry: Entry = {"code": code, "x": list(cell.x), "y": list(cell.y), **materials(cell.use)}
        entry["lamps"] = _lamps(cell, rng)
        high = plan.ceiling(cell)
        if high < plan.height:
            entry["height"] = round(high, 2)
        lowered = {**windows, "head": min(windows["head"], round(high - 0.1, 2))}
        entry["windows"] = _windows(cell, plan, lowered, rng)
        room = Room(cell, plan, doors, entry["windows"])
        style = seeded(seed, cell.use, "furniture")
        entry["items"] = furnish(room, style, rng, density)
        rooms[cell.name] = entry
    content: Entry = {
        "name": f"random_{seed}",
        "materials": "drawn",
        "north": round(rng.uniform(0, 360), 1),
        "height": round(plan.height, 2),
        "rooms": rooms,
        "doors": doors,
    }
    content["paths"] = _paths(content, plan, seed, rng)
    return content


def _materials(rng: Rng) -> Any:
    """Draw the materials of a building, and return a function that gives the entries of a room by its use."""
    walls = str(rng.choice(["paint", "paint", "paint", "paint", "concrete", "brick", "stripes", "panelling"]))
    ceiling = str(rng.choice(["ceiling_panels", "paint", "paint", "concrete", "panelling"]))
    white = rng.random() < 0.65
    common = _paint(rng) if not white else [round(float(v), 2) for v in rng.uniform(0.88, 1.0, 3)]
    panels = str(rng.choice(["panelling", "tiles_wall", "wood", "stripes"]))
    wainscot = [panels, round(rng.uniform(0.8, 1.5), 2)]
    everywhere = rng.random() < 0.18
    floors: dict[str, str] = {}
    own = rng.random() < 0.25  # every room has its own colour

    def of_room(use: str) -> Entry:
        suitable = USES[use].floors.split()
        if use not in floors:  # most rooms share their floor with others
            shared = [floor for floor in floors.values() if floor in suitable]
            floors[use] = str(rng.choice(shared if shared and rng.random() < 0.6 else suitable))
        entry: Entry = {"floor": floors[use] if rng.random() < 0.85 else str(rng.choice(suitable))}
        entry["walls"] = walls if rng.random() < 0.75 else "paint"
        entry["ceiling"] = ceiling if rng.random() < 0.85 else "paint"
        entry["paint"] = _paint(rng) if own or rng.random() < 0.1 else common
        if use.removeprefix("home_") in ("toilet", "bath", "kitchen") and rng.random() < 0.7:
            tiles = str(rng.choice(["tiles_wall", "tiles_blue", "checker"]))
            entry["wainscot"] = [tiles, round(rng.uniform(1.2, 2.2), 2)]
        elif everywhere or rng.random() < 0.06:
            entry["wainscot"] = wainscot
        return entry

    return of_room


def _paint(rng: Rng) -> list[float]:
    """Draw the linear colour of a wall: mostly light, sometimes strong."""
    strong = rng.random() < 0.2
    colour = rng.uniform(0.25, 1.0, 3) if strong else rng.uniform(0.7, 1.0, 3)
    return [round(float(value), 2) for value in colour]


def _lamps(cell: Cell, rng: Rng) -> list[Any]:
    kind = str(rng.choice(["panel", "tube", "round"]))
    pitch = rng.uniform(1.8, 3.4)
    counts = [max(1, round((high - low) / pitch)) for low, high in (cell.x, cell.y)]
    return [kind, *(min(count, 6) for count in counts)]


def _window_style(rng: Rng, height: float) -> Entry:
    sill = float(rng.choice([rng.uniform(0.0, 0.3), rng.uniform(0.6, 1.0), rng.uniform(0.7, 1.3)]))
    head = float(min(rng.uniform(1.9, 2.6), height - 0.12))
    return {
        "sill": round(sill, 2),
        "head": round(max(head, sill + 0.6), 2) if sill + 0.6 < height - 0.05 else round(height - 0.1, 2),
        "width": rng.uniform(0.7, 2.4),
        "pier": rng.uniform(0.3, 2.5),
        "walls": rng.uniform(0.45, 1.0),
    }


def _windows(cell: Cell, plan: Plan, style: Entry, rng: Rng) -> list[Entry]:
    """Put windows into the outer walls."""
    found: list[Entry] = []
    chance = style["walls"] * (0.15 if cell.use.removeprefix("home_") in ("storage", "toilet", "bath") else 1.0)
    for side in SIDES:
        for low, high in cell.outside(side, plan.cells):
            free = high - low - 0.5
            if free < 0.6 or rng.random() > chance:
                continue
            width = min(style["width"], free)
            count = max(1, int((free + style["pier"]) / (width + style["pier"])))
            for number in range(count):
                at = low + 0.25 + free * (number + 0.5) / count
                entry = {"wall": side, "at": round(at, 2), "width": round(width - 0.01, 2)}
                found.append({**entry, "sill": style["sill"], "head": style["head"]})
    return found


def _paths(content: Entry, plan: Plan, seed: int, rng: Rng) -> Entry:
    """Find the robot's paths.

    Raises:
        DataError: there is no way through the building.
    """
    building = parse_building(content, seed, content["name"])
    space = FreeSpace(building)
    start_cells = space.inside(plan.cells[0].x, plan.cells[0].y)
    if not len(start_cells):
        raise DataError("the robot has nowhere to start from")
    start = int(start_cells[np.argmin(space.points[start_cells].sum(axis=1))])
    seen = space.reachable(start)
    places = {cell.name: visits(space, cell.x, cell.y, seen, rng) for cell in plan.cells}
    if shut := [name for name, found in places.items() if not found]:
        raise DataError(f"a robot cannot reach {', '.join(shut)}")
    order = _order(plan)
    ways: Entry = {}
    for name, cells in (("path1", order[::2]), ("path2", order)):
        stops = [start]
        for cell in cells:
            left = list(places[cell])
            while left:  # the nearest one is next
                here = space.points[stops[-1]]
                following = min(left, key=lambda one: float(np.linalg.norm(space.points[one] - here)))
                left.remove(following)
                stops.append(following)
        way = space.way([*stops, start])
        if blocked_points(building, rounded(way)).any():
            raise DataError("the robot's way is too narrow")
        ways[name] = [[round(float(x), 3), round(float(y), 3)] for x, y in way]
    check_paths(replace(building, paths={name: np.array(way) for name, way in ways.items()}))
    return ways


def _order(plan: Plan) -> list[str]:
    """Return the cells in the order in which their doors lead to them, finishing each wing before the next."""
    beyond: dict[str, list[str]] = {cell.name: [] for cell in plan.cells}
    for one, other, _ in plan.doors:
        beyond[one].append(other)
        beyond[other].append(one)
    middle = {cell.name: (cell.x[0] + cell.x[1], cell.y[0] + cell.y[1]) for cell in plan.cells}
    order, waiting = [], [plan.cells[0].name]
    while waiting:
        here = waiting.pop()
        if here not in order:
            order.append(here)
            nearer = sorted(beyond[here], key=lambda name: -middle[name][0])
            waiting += [name for name in nearer if name not in order]
    return order
