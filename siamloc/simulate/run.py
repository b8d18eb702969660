"""The state that differs from drive to drive: the hour, lamps, doors, chairs and people."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path as FilePath
from typing import Annotated, Any, Literal

import numpy as np

from foundation.settings import Count, Natural, Positive, Rule, Settings
from siamloc.data.names import LIGHTINGS
from siamloc.errors import ConfigError, hint
from siamloc.simulate.items import KINDS
from siamloc.simulate.layout import SIDES, Array, Building, Colour, Item, Opening, Rng, Room
from siamloc.simulate.months import Change, aged
from siamloc.simulate.odometry import odometry
from siamloc.simulate.plan import clearance, crossings, inside_item, obstacles
from siamloc.simulate.shell import Fixtures, leaf_segment
from siamloc.simulate.sky import overcast, sun_direction
from siamloc.simulate.trajectory import GRIDS, Track, drive, grid, listed

Hour = Annotated[float, Rule("an hour from 0 to 24", lambda value: 0 <= value <= 24)]

#: Hours between which the sun is up on every day that a run may have.
DAY = (7, 17)
_START = {"cloudy": 11.0, "night": 22.0, "sunny": 10.0}
_EPOCH = 1152860400.0  # midnight of the first day, by a clock seven hours behind UTC
_DAYS = 30  # of a month
_KEEP_OFF = 0.42
_HALF_ROBOT, _CAMERA = 0.2, 0.12  # metres
_WIDER = (105.0, 120.0, 135.0, 150.0, 165.0, 175.0)  # degrees of a door that would be in the robot's way
_APART = 0.6  # metres between people
_LAMP = {"panel": 30.0, "tube": 42.0, "round": 48.0}


@dataclass(frozen=True)
class Run(Settings):
    """One drive of the robot, chosen by lighting, number and path.

    Attributes:
        lighting: "cloudy", "night" or "sunny".
        number: 1, 2, ... within the lighting; each number is a different hour and a different day.
        path: name of one of the building's paths; or "grid" or "halfway", a grid of positions or the middles of its
            squares.
        spacing: metres after which the robot takes the next frame, or one earlier after 20 degrees of turning; or
            metres between the positions of the grid.
        trajectory: a `places.lst` whose poses are used instead of the path.
        hour: solar time, which also dims a cloudy sky, 7 to 17 unless it is a night; drawn around a usual hour if None.
        headings: frames at each position of a grid, at headings 360 degrees / `headings` apart.
        positions: number of positions of a grid; all that are free if None.
        month: number of months that have passed in the building: `months.aged` changes it, and doors, lamps, chairs and
            people are drawn again.

    Raises:
        ConfigError: headings or positions without a grid, a grid with a list of poses, an hour by day at which the sun
            may be down, or an invalid value.
    """

    lighting: Literal["cloudy", "night", "sunny"] = "cloudy"
    number: Count = 1
    path: str = "path2"
    spacing: Positive = 0.15
    trajectory: FilePath | None = None
    hour: Hour | None = None
    headings: Count = 1
    positions: Count | None = None
    month: Natural = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.path not in GRIDS and (self.headings, self.positions) != (1, None):
            raise ConfigError(f"headings and positions go with path={' or path='.join(GRIDS)}, got path={self.path}")
        if self.path in GRIDS and self.trajectory is not None:
            raise ConfigError(f"a trajectory gives the poses itself: leave out path={self.path}, or the trajectory")
        if self.month and self.trajectory is not None:
            raise ConfigError("furniture moved in a month may stand in the way of a trajectory: choose a path instead")
        if self.lighting != "night" and self.hour is not None and not DAY[0] <= self.hour <= DAY[1]:
            raise ConfigError(
                f"at hour {self.hour:g}, the sun may be down: choose one from {DAY[0]} to {DAY[1]} for a "
                f"{self.lighting} run, or a night run"
            )

    @property
    def name(self) -> str:
        """Name of the drive's folder, as in COLD: seq<path>_<lighting><number>, and _month<month> from 1 on."""
        digits = "".join(letter for letter in self.path if letter.isdigit()) or "1"
        return f"seq{digits}_{self.lighting}{self.number}" + (f"_month{self.month}" if self.month else "")

    @property
    def key(self) -> tuple[str | int, ...]:
        """What the random draws of the drive depend on."""
        return (self.lighting, self.number, self.path, *(("month", self.month) if self.month else ()))

    @classmethod
    def parse(cls, name: str, path: str = "path2", spacing: float = 0.15, **options: Any) -> Run:
        """Return the run with a name such as "cloudy1".

        Args:
            name: a lighting, "cloudy", "night" or "sunny", followed by a number.
            path: name of one of the building's paths, "grid" or "halfway", as in `Run`.
            spacing: metres between frames at most, or between the positions of the grid, as in `Run`.
            options: the other attributes of `Run`, such as `hour`.

        >>> Run.parse("night2").name
        'seq2_night2'

        Raises:
            ConfigError: not a lighting followed by a number.
        """
        parts = re.fullmatch(rf"({'|'.join(LIGHTINGS)})([0-9]+)", name)
        if parts is None:
            first = [f"{lighting}1" for lighting in LIGHTINGS]
            raise ConfigError(f"a run is a lighting and a number such as cloudy1, got {name!r}; {hint(name, first)}")
        return cls(parts[1], int(parts[2]), path, spacing, **options)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Walker:
    """A person who walks along a line.

    Attributes:
        line: positions of the two ends of the line in metres (2, 2).
        times: times of the start at the first end and of the arrival at the second, in seconds.
        look: index of the clothes and height, modulo `scene.LOOKS`.
    """

    line: Array
    times: tuple[float, float]
    look: int

    def place(self, time: float) -> tuple[float, float, float] | None:
        """Return the person's x, y in metres and direction in degrees at a time in seconds; None off the walk."""
        begin, end = self.times
        if not begin <= time <= end:
            return None
        step = self.line[1] - self.line[0]
        x, y = self.line[0] + (time - begin) / (end - begin) * step
        return float(x), float(y), float(np.degrees(np.arctan2(step[1], step[0])))


@dataclass(frozen=True)
class Light:
    """The lamps and the sun and sky of one drive.

    Attributes:
        lighting: "cloudy", "night" or "sunny".
        hour: solar time in hours.
        declination: declination of the sun in degrees.
        lamps_on: radiosity of the lit lamps by room name; rooms whose lamps are off are absent.
        number: seeds the clouds and their brightness.
        overcast: brightness of a cloudy sky relative to noon.
    """

    lighting: str
    hour: float
    declination: float
    lamps_on: dict[str, Colour]
    number: int
    overcast: float = 1.0


@dataclass(frozen=True)
class RunState:
    """Everything in which one run differs from others.

    Attributes:
        building: the building as the month of the run finds it.
        changes: what the months have changed in the building.
        track: poses of the drive.
        items: all items in their places, with standing people.
        fixtures: state of doors and blinds.
        walkers: people who walk during the drive.
        light: the state of lamps, sun and sky.
    """

    building: Building
    changes: tuple[Change, ...]
    track: Track
    items: tuple[Item, ...]
    fixtures: Fixtures
    walkers: tuple[Walker, ...]
    light: Light


def draw_run(building: Building, run: Run) -> RunState:
    """Draw everything in which a run of a building differs from others: drive, doors, blinds, lamps, chairs, people."""
    building, changes = aged(building, run.month)
    rng = building.rng("run", *run.key)
    hour = _START[run.lighting] + 2.6 * ((run.number - 1) % 3) + rng.uniform(-0.4, 0.4)
    declination = rng.uniform(-10, 0)
    hour, level = (hour, 1.0) if run.hour is None else (run.hour, overcast(run.hour, declination))
    if run.trajectory is not None:
        track = listed(building, run.trajectory)
    else:
        day = 86400.0 * (3 * (run.number - 1) + LIGHTINGS.index(run.lighting) + _DAYS * run.month)
        way = building, run.path, run.spacing, rng, round(_EPOCH + day + 3600 * hour, 6)
        track = grid(*way, run.headings, run.positions) if run.path in GRIDS else drive(*way)
    angles, number = _door_angles(building, track, rng), run.number + 1000 * run.month
    fixtures = Fixtures(angles, _blinds(building, run.lighting, rng))
    light = Light(run.lighting, hour, declination, _lamps_on(building, run.lighting, rng), number, level)
    items = [*_moved_items(building, track, angles, rng), *_standing_people(building, track, rng)]
    return RunState(building, changes, track, tuple(items), fixtures, _walkers(building, track, rng), light)


def draw_odometry(building: Building, run: Run, track: Track) -> Array | None:
    """Draw what the robot's wheels report along the drive of a run (n, 3), as `odometry`; None on a grid.

    It has a generator of its own, so that nothing else of the run depends on it.
    """
    if run.path in GRIDS:  # where nobody drives
        return None
    order, wheels = np.argsort(track.time, kind="stable"), np.empty_like(track.poses)
    wheels[order] = odometry(track.poses[order], building.rng("odometry", *run.key))
    return wheels


def draw_light(building: Building, lighting: str, rng: Rng) -> Light:
    """Draw the light of any hour of any day, and which lamps are lit: it varies more than in the runs of a data set.

    Args:
        building: its rooms, windows and direction of north.
        lighting: "cloudy", "night" or "sunny"; in sunny light, the sun is above the horizon.
        rng: draws hour, season and lamps.
    """
    hour, declination = rng.uniform(8.0, 18.0), rng.uniform(-23.0, 23.0)
    while lighting == "sunny" and sun_direction(hour, building.north, declination)[2] < 0.08:
        hour = rng.uniform(8.0, 18.0)
    share = {"night": rng.uniform(0.8, 1.0), "cloudy": rng.uniform(0.3, 1.0), "sunny": rng.uniform(0.0, 0.5)}[lighting]
    level, warmth = rng.uniform(0.6, 1.3), rng.uniform(0.0, 1.4)
    lamps: dict[str, Colour] = {}
    for room in building.rooms.values():
        brighter = level * rng.uniform(0.8, 1.2)
        if rng.random() < share or (not _has_window(building, room) and rng.random() < 0.9):
            lamps[room.name] = _lamp_light(room, brighter, warmth)
    return Light(lighting, hour, declination, lamps, int(rng.integers(1, 1_000_000)))


def _has_window(building: Building, room: Room) -> bool:
    return any(opening.kind == "window" and room.name in opening.rooms for opening in building.openings)


def _lamp_light(room: Room, level: float, warmth: float) -> Colour:
    """Return the radiosity of a room's lamps in red, green and blue; the last two fade with the warmth."""
    red = _LAMP[room.lamps[0]] * level
    return red, red * (0.86 - 0.05 * warmth), red * (0.66 - 0.12 * warmth)


def _door_angles(building: Building, track: Track, rng: Rng) -> dict[int, float]:
    """Return by how many degrees each door is open: where the robot passes, so wide that the leaf is out of its way."""
    angles = {}
    points, things = track.poses[:, :2], obstacles(building)[0]

    def room(opening: Opening, angle: float) -> float:
        return float(clearance(points, leaf_segment(building, opening, angle)[None]).min())

    def out_of_the_way(opening: Opening, angle: float) -> tuple[bool, bool, float]:
        hinge, tip = leaf_segment(building, opening, angle)
        leaf = np.array([[hinge + 0.05 * (tip - hinge), tip]])  # without its end at the wall
        free = room(opening, angle)
        return free > _CAMERA, not crossings(leaf, things).any(), min(free, _HALF_ROBOT)

    for index, opening in enumerate(building.openings):
        if opening.kind not in ("leaf", "glass"):
            continue
        middle = np.array(opening.point(opening.centre, 0.0))
        used = bool((np.linalg.norm(points - middle, axis=1) < opening.width / 2 + 0.25).any())
        wide, ajar, shut = rng.uniform(86, 98), rng.uniform(15, 80), rng.random() < 0.6
        if used:
            angles[index] = float(max((wide, *_WIDER), key=partial(out_of_the_way, opening)))
        else:
            angles[index] = 0.0 if shut or room(opening, ajar) < _KEEP_OFF else float(ajar)
    return angles


def _blinds(building: Building, lighting: str, rng: Rng) -> dict[int, float]:
    usual = building.rng("blinds")
    blinds = {}
    for index, opening in enumerate(building.openings):
        if opening.kind != "window":
            continue
        share, drawn = float(usual.choice([0.0, 0.0, 0.12, 0.25])), rng.uniform(0.1, 0.6)
        changed = rng.random() < {"cloudy": 0.05, "night": 0.2, "sunny": 0.7}[lighting]
        blinds[index] = drawn if changed else share
    return blinds


def _lamps_on(building: Building, lighting: str, rng: Rng) -> dict[str, Colour]:
    usual = building.rng("lamps")
    lamps = {}
    for room in building.rooms.values():
        windows = _has_window(building, room)
        by_day = usual.random() < (0.97 if windows else 1.0)
        change, warmth, level = rng.random(), usual.uniform(0.0, 1.0), usual.uniform(0.85, 1.15)
        if {"night": True, "cloudy": by_day, "sunny": change < 0.06 or not windows}[lighting]:
            lamps[room.name] = _lamp_light(room, level, warmth)
    return lamps


def _moved_items(building: Building, track: Track, angles: dict[int, float], rng: Rng) -> list[Item]:
    leaves = [leaf_segment(building, building.openings[index], angle) for index, angle in angles.items()]
    placed: list[Item] = []
    for number, item in enumerate(building.items):
        kind = KINDS[item.kind]
        others = [*placed, *building.items[number + 1 :]]
        placed.append(item)
        for _ in range(8 if kind.moves > 0 or (kind.turns > 0 and kind.blocks) else 0):
            shift = rng.uniform(-kind.moves, kind.moves, 2)
            turn = rng.uniform(-kind.turns, kind.turns)
            trial = replace(item, x=item.x + shift[0], y=item.y + shift[1], facing=item.facing + turn)
            if _fits(building, trial, others, track, leaves):
                placed[-1] = trial
                break
    return placed


def _fits(building: Building, item: Item, others: list[Item], track: Track, leaves: list[Array]) -> bool:
    corners, inner = item.footprint(), np.array(building.rooms[item.room].inner())
    if (corners < inner[:, 0]).any() or (corners > inner[:, 1]).any():
        return False
    edges = item.edges()
    if clearance(track.poses[:, :2], edges).min() < _KEEP_OFF or inside_item(item, track.poses[:, :2]).any():
        return False
    probe = np.concatenate([corners, edges.mean(axis=1), [[item.x, item.y]]])
    for other in others:
        if other.room == item.room and KINDS[other.kind].blocks:
            around = np.concatenate([other.footprint(), [[other.x, other.y]]])
            if inside_item(other, probe).any() or inside_item(item, around).any():
                return False
    return all(clearance(probe, leaf[None]).min() > 0.1 for leaf in leaves)


def _standing_people(building: Building, track: Track, rng: Rng) -> list[Item]:
    segments, _ = obstacles(building)
    people: list[Item] = []
    wanted = int(rng.integers(1, 5))
    rooms = list(building.rooms.values())
    for _ in range(60):
        if len(people) == wanted:
            break
        room = rooms[rng.integers(len(rooms))]
        x = rng.uniform(room.x[0] + 0.4, room.x[1] - 0.4)
        y = rng.uniform(room.y[0] + 0.4, room.y[1] - 0.4)
        facing, height = rng.uniform(0, 360), rng.uniform(1.6, 1.9)
        item = Item("person", x, y, facing, (0.5, 0.4, height), 0.0, room.name, {"look": int(rng.integers(1000))})
        place, near = np.array([[x, y]]), [other for other in building.items if other.room == room.name]
        blocked = any(KINDS[other.kind].blocks and inside_item(other, place, 0.3).any() for other in near)
        free = clearance(place, segments)[0] > 0.35
        if building.materials == "natural":  # in buildings of data sets, people follow from their seeds as they are
            free &= all(np.hypot(x - other.x, y - other.y) > _APART for other in people)
        if free and not blocked and clearance(track.poses[:, :2], item.edges()).min() > _KEEP_OFF:
            people.append(item)
    return people


def _walkers(building: Building, track: Track, rng: Rng) -> tuple[Walker, ...]:
    """Let people walk along the walls of the longest room while the robot drives, whatever stands there."""
    room = max(building.rooms.values(), key=lambda r: max(r.x[1] - r.x[0], r.y[1] - r.y[0]))
    inner = room.inner(0.45)
    wall = SIDES["north" if inner.x[1] - inner.x[0] > inner.y[1] - inner.y[0] else "east"]
    ends, lanes = wall.plan(*inner)
    duration = float(track.time[-1] - track.time[0])
    walkers = []
    for _ in range(max(1, round(duration / 60))):
        begin = float(track.time[0]) + rng.uniform(0, max(duration - 10, 1))
        speed, lane, back = rng.uniform(0.9, 1.4), lanes[rng.integers(2)], rng.random() < 0.5
        look = int(rng.integers(6))
        start, end = (ends[1], ends[0]) if back else ends
        line = np.array([wall.plan(start, lane), wall.plan(end, lane)])
        walkers.append(Walker(line, (begin, begin + abs(end - start) / speed), look))
    return tuple(walkers)
