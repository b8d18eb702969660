"""Robustness: the error of absolute localization when queries are disturbed more and more ([T] 3.4.2)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from analytic import Descriptor
from siamloc.calls import takes
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.data.protocol import Protocol
from siamloc.errors import ConfigError, DataError
from siamloc.evaluation.columns import room_names
from siamloc.evaluation.metrics import error_floor, heading_error, localization_error, recall_from_ranks, summarize
from siamloc.evaluation.result import Result
from siamloc.evaluation.session import Baselines, Session, cost
from siamloc.maps import Retrieval, VisualMap, headings, match
from siamloc.progress import track
from siamloc.results import Columns
from siamloc.settings import Count, NotNegative, Rule, Seed, Settings
from siamloc.stopwatch import Stopwatch

Images = NDArray[np.uint8]
Locate = Callable[[Images], "Answer"]
_NAMES = {"noise": "variance", "occlusion": "share of the columns", "turn": "degrees"}
_KINDS = ("noise", "occlusion", "turn", "effect")


_STRENGTHS = (0, 0.25, 0.5, 0.75, 1)


@dataclass(frozen=True)
class Robustness(Settings):
    """What happens to the queries' images; the map stays clean.

    Attributes:
        every: take every k-th query.
        radius: share of the queries located this near, in the unit of the positions.
        noise: variances on images in [0, 1]; those of the thesis if None, none if ().
        occlusion: shares of the columns behind bars; those of the thesis if None, none if ().
        turn: degrees that the robot has turned left.
        effects: effects of `augment`, such as "bulb", "darken" or "blur".
        strengths: of each effect: 0 does nothing, 1 is the far end of its ranges.
    """

    WHERE = "task.robustness"

    every: Count = 5
    radius: NotNegative = 0.5
    noise: tuple[float, ...] | None = None
    occlusion: tuple[float, ...] | None = None
    turn: tuple[float, ...] = (0, 1, 5, 15, 45, 90, 180)
    effects: tuple[str, ...] = ()
    strengths: tuple[Annotated[float, Rule("a number from -1 to 1", lambda value: -1 <= value <= 1)], ...] = _STRENGTHS

    def disturbances(self, circular: bool) -> list[Disturbance]:
        """Return what the settings ask for.

        Raises:
            ConfigError: nothing is asked for, something twice, or levels out of range.
        """
        from analytic.disturb import NOISE_LEVELS, OCCLUSION_LEVELS

        wanted = [
            ("noise", "noise", NOISE_LEVELS if self.noise is None else self.noise),
            ("occlusion", "occlusion", OCCLUSION_LEVELS if self.occlusion is None else self.occlusion),
            ("turn", "turn", self.turn if circular or self.turn != type(self).turn else ()),
            *((name, "effect", self.strengths) for name in self.effects),
        ]
        names = [name for name, _, _ in wanted]
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise ConfigError(f"task.robustness.effects names {twice!r} twice, or a disturbance that is there already")
        made = [
            Disturbance(name, tuple(map(float, levels)), kind, circular)
            for name, kind, levels in wanted
            if levels or kind == "effect"
        ]
        if not made:
            raise ConfigError("task.robustness has no levels at all: give noise, occlusion, turn or effects")
        return made


@takes(Robustness)
def robustness(
    known: VisualMap,
    images: PanoramaLibrary,
    queries: FrameTable,
    *,
    protocol: Protocol | Mapping[str, Any] | str = "cross_run",
    baselines: Baselines = (),
    name: str | None = None,
    seed: Seed = 0,
    settings: Robustness,
) -> Result:
    """Measure how errors grow when the queries' images are disturbed.

    Where the map or the queries have no position at all, answers are judged by their room: the error is 1 in a wrong
    room and 0 in the right one.

    Args:
        known: the map; frames without a position are left out, of the queries too.
        images: panoramas of the queries (and of the map's frames for baselines).
        queries: frames to be located.
        protocol: who may be compared with whom; see `localization`.
        baselines: descriptors measured on the same frames; see `localization`.
        name: what the results are called.
        seed: of the noise, the bars and the effects' places.
        settings: instead of its fields as keywords.

    Returns:
        The tables "robustness", a row per method, disturbance and level, and "answers", a row per query as well.

    Example:
        >>> import siamloc
        >>> images = siamloc.data.example()
        >>> monday, tuesday = (images.frames.select(sequence=day) for day in ("monday", "tuesday"))
        >>> known = siamloc.maps.build("hog", images, monday, progress=False)
        >>> result = robustness(known, images, tuesday, every=1, noise=(0, 0.05), occlusion=(), turn=(90,))
        >>> list(result.measures["methods"]["hog"]), len(result.tables["answers"]["error"])
        (['noise', 'turn'], 36)
    """
    session = Session(known, images, queries, protocol=protocol, baselines=baselines, name=name, seed=seed)
    disturbances = settings.disturbances(images.circular)
    in_map, in_queries, by_room = session.comparable()
    scored = session.queries.take(in_queries)
    rows = np.arange(0, len(scored), settings.every)
    asked = scored.take(rows)
    parts, tables, costs = [], [], {}
    for label, other in {session.name: known.descriptor, **session.baselines}.items():
        own = session.map_by(other).take(in_map)
        excluded = session.excluded(asked, own.frames)
        clock = Stopwatch()
        found = _located(session, own, asked, rows, excluded, disturbances, label, clock)
        costs[label] = cost(own, clock)
        parts.append(answers(label, own.frames, asked, found, by_room, excluded))
        tables.append(curves(parts[-1], settings.radius, len(own)))
    table = concatenated(tables)
    measured = measures(table, disturbances, "wrong rooms" if by_room else known.unit, settings.every)
    return Result(
        name=session.name,
        parts={"robustness": measured},
        tables={"robustness": table, "answers": concatenated(parts)},
        denominators={
            "queries": len(rows),
            "queries_of_the_role": len(scored),
            "map_frames": measured["map_frames"],
        },
        skipped=session.skipped,
        about=session.about(),
        settings=session.settings(settings),
        cost=costs.pop(session.name),
        baselines={label: Result(label, {}, {}, cost=taken) for label, taken in costs.items()},
    )


@dataclass(frozen=True)
class Answer:
    """What a descriptor says of images.

    Attributes:
        nearest: rows of the most similar map frames (B,).
        heading: by them (B,), rad; NaN where it gives none.
        heading_nearest: by the geometrically nearest map frames (B,), rad ([T] 3.5.3-3.5.4).

    Headings that are left out are NaN.
    """

    nearest: NDArray[np.int64]
    heading: NDArray[np.float64] = None  # type: ignore[assignment]
    heading_nearest: NDArray[np.float64] = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        for name in ("heading", "heading_nearest"):
            if getattr(self, name) is None:
                object.__setattr__(self, name, np.full(len(self.nearest), np.nan))

    @staticmethod
    def concatenate(parts: Sequence[Answer]) -> Answer:
        """Return the answers for one batch of queries after the other."""
        return Answer(*(np.concatenate([getattr(part, one.name) for part in parts]) for one in fields(Answer)))


@dataclass(frozen=True)
class Disturbance:
    """Something that happens to query images, at several levels.

    Attributes:
        name: "noise", "occlusion", "turn", or an effect of `augment`.
        levels: variances on images in [0, 1]; shares of the columns; degrees turned left; strengths in [-1, 1].
        kind: "effect" for what comes from `augment`, also where that has an effect called noise; else the name.
        circular: whether columns wrap around.

    Raises:
        ConfigError: an unknown kind, no levels, levels that repeat or are out of range, or a turn of images whose
            columns do not wrap around.
        AugmentError: an unknown effect.
    """

    name: str
    levels: tuple[float, ...]
    kind: str
    circular: bool = True

    def __post_init__(self) -> None:
        if self.kind not in _KINDS or (self.kind != "effect" and self.kind != self.name):
            raise ConfigError(f"a disturbance is of kind {', '.join(_KINDS)}, got {self.kind!r} named {self.name!r}")
        low, high = {"noise": (0, np.inf), "occlusion": (0, 1), "turn": (-360, 360), "effect": (-1, 1)}[self.kind]
        fits = all(np.isfinite(level) and low <= level <= high for level in self.levels)
        if not self.levels or not fits or len(set(self.levels)) < len(self.levels):
            raise ConfigError(
                f"the levels of {self.name} must be numbers from {low:g} to {high:g} that differ, got "
                f"{list(self.levels)}"
            )
        if self.kind == "turn" and not self.circular:
            raise ConfigError(
                "images whose columns do not wrap around cannot be turned: leave turn out "
                "(task.robustness.turn=[]), or say that they do (circular=true)"
            )
        if self.kind == "effect":
            self._effect()

    @property
    def unit(self) -> str:
        """What the levels count."""
        return _NAMES.get(self.kind, "strength")

    def apply(self, images: Images, level: float, rows: NDArray[np.int64], seed: int = 0) -> Images:
        """Return disturbed images, each with draws of its own that are the same at every level.

        Args:
            images: (B, 3, H, W) uint8, RGB.
            level: one of the levels.
            rows: numbers of the queries (B,), that the draws follow from together with the seed.
            seed: of all draws.
        """
        from analytic import disturb

        if self.kind == "turn":
            return np.roll(images, round(level / 360 * images.shape[-1]), axis=-1)
        if self.kind == "effect":
            return self._with_effect(images, level, rows, seed)
        made = []
        for image, row in zip(images, rows.tolist(), strict=True):
            rng = np.random.default_rng((seed, row))
            if self.kind == "noise":
                made.append(disturb.noise(image, level, rng))
            else:
                made.append(disturb.occlude(image, level, rng, circular=self.circular))
        return np.stack(made)

    def _with_effect(self, images: Images, strength: float, rows: NDArray[np.int64], seed: int) -> Images:
        """Apply an effect with strengths given and everything else (places, forms) drawn."""
        import torch

        effect, batch = self._effect(), torch.from_numpy(np.ascontiguousarray(images))
        height, width = batch.shape[2:]
        strong = effect.at(strength, batch)
        draws = []
        for row in rows.tolist():
            state = int(np.random.SeedSequence((seed, row)).generate_state(1)[0])
            draws.append(effect.draw(torch.Generator().manual_seed(state), batch[:1]))
        params = {
            key: strong[key] if span.neutral is not None else torch.cat([draw[key] for draw in draws])
            for key, span in effect.spans(height, width).items()
        }
        changed: Images = effect.apply(batch, effect.complete(params, len(batch), height, width)).numpy()
        return changed

    def _effect(self) -> Any:
        import augment

        return augment.effect(self.name, circular=self.circular)


def locate_disturbed(
    locate: Locate,
    images: Images,
    rows: NDArray[np.int64],
    disturbances: Sequence[Disturbance],
    seed: int = 0,
) -> dict[tuple[str, float], Answer]:
    """Return what is answered for each query by disturbance and level.

    Levels that leave the images as they are share one search.

    Args:
        locate: describes images and finds their nearest map frames.
        images: (B, 3, H, W) uint8, RGB.
        rows: numbers of the queries (B,).
        disturbances: what happens to them.
        seed: of all draws.
    """
    clean: Answer | None = None
    found: dict[tuple[str, float], Answer] = {}
    for disturbance in disturbances:
        for level in disturbance.levels:
            changed = disturbance.apply(images, level, rows, seed)
            if not np.array_equal(changed, images):
                found[disturbance.name, level] = _unturned(locate(changed), disturbance, level)
                continue
            if clean is None:
                clean = locate(images)
            found[disturbance.name, level] = _unturned(clean, disturbance, level)
    return found


def _unturned(answer: Answer, disturbance: Disturbance, level: float) -> Answer:
    """Return headings of the robot before it turned on the spot, which are what the true ones are."""
    if disturbance.kind != "turn":
        return answer
    turned = np.radians(level)
    before = (np.pi - np.remainder(np.pi - one + turned, 2 * np.pi) for one in (answer.heading, answer.heading_nearest))
    return Answer(answer.nearest, *before)


def answers(
    method: str,
    known: FrameTable,
    queries: FrameTable,
    found: Mapping[tuple[str, float], Answer],
    by_room: bool = False,
    excluded: NDArray[np.bool_] | None = None,
) -> Columns:
    """Return one row for each query, disturbance and level: what `answers.csv` holds.

    Args:
        method: name of the descriptor.
        known: m map frames with positions.
        queries: n frames with positions.
        found: by disturbance and level what was answered for each query (n,).
        by_room: judge by rooms instead of positions: the error is 1 in a wrong room.
        excluded: (n, m) map frames that a query was not compared with; its floor leaves them out too.

    Raises:
        DataError: no queries, nothing found, or frames without positions.
    """
    if not len(queries) or not found:
        raise DataError("robustness needs at least one query and one disturbance")
    known_rooms, rooms = room_names(known, queries)
    if by_room:
        findable = known_rooms[None, :] == rooms[:, None]
        floor = (~(findable if excluded is None else findable & ~excluded).any(axis=1)).astype(float)
    else:
        floor = error_floor(known.xy, queries.xy, excluded)
    parts = []
    for (name, level), answer in found.items():
        row = answer.nearest
        error = (known_rooms[row] != rooms).astype(float) if by_room else localization_error(known.xy[row], queries.xy)
        parts.append(
            {
                "method": np.full(len(queries), method),
                "disturbance": np.full(len(queries), name),
                "level": np.full(len(queries), float(level)),
                "path": queries.path,
                "lighting": queries.lighting,
                "room": queries.room,
                "match_path": known.path[row],
                "error": error,
                "floor": np.minimum(floor, error),
                "heading_error": np.degrees(_turned_wrongly(answer.heading, queries.theta)),
                "heading_error_nearest": np.degrees(_turned_wrongly(answer.heading_nearest, queries.theta)),
            }
        )
    return concatenated(parts)


def _turned_wrongly(estimated: NDArray[np.float64], theta: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the errors of headings (n,) in rad, NaN where the estimated or the true one is not known."""
    error, known = np.full(len(theta), np.nan), np.isfinite(estimated) & np.isfinite(theta)
    error[known] = heading_error(estimated[known], theta[known])
    return error


def concatenated(parts: Sequence[Mapping[str, NDArray]]) -> Columns:
    """Return tables of the same columns one below the other."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def curves(columns: Mapping[str, NDArray], radius: float, map_frames: int) -> Columns:
    """Return one row for each method, disturbance and level, from the rows of `answers`: `robustness.csv`.

    Args:
        columns: method, disturbance, level, error, floor.
        radius: not negative; an error exactly as large counts as within.
        map_frames: in the map.

    Returns:
        method, disturbance, level, queries, map_frames; mean, median, p95 of the errors, floor (mean), excess (mean);
        hit_rate, the share of queries whose answer is the geometrically nearest map frame; heading and heading_nearest,
        mean errors in degrees by the frame found and by the nearest one, NaN where no heading is known;
        radius, within (queries), share (of all queries), answerable (queries with a map frame that near).

    Raises:
        ConfigError: a negative radius.
    """
    if not radius >= 0:
        raise ConfigError(f"the radius must not be negative, got {radius}")
    keys = list(zip(*(columns[name].tolist() for name in ("method", "disturbance", "level")), strict=True))
    number = {key: i for i, key in enumerate(dict.fromkeys(keys))}
    group = np.array([number[key] for key in keys])
    rows: list[dict[str, Any]] = []
    for (method, name, level), i in number.items():
        error, floor = columns["error"][group == i], columns["floor"][group == i]
        errors = summarize(error)
        near = recall_from_ranks((error <= radius).astype(np.int64), floor, radius, 1)
        rows.append(
            {
                "method": method,
                "disturbance": name,
                "level": level,
                "queries": len(error),
                "map_frames": int(map_frames),
                **{key: errors[key] for key in ("mean", "median", "p95")},
                "floor": float(floor.mean()),
                "excess": float((error - floor).mean()),
                "hit_rate": float((error - floor <= 1e-9).mean()),
                "heading": _mean(columns["heading_error"][group == i]),
                "heading_nearest": _mean(columns["heading_error_nearest"][group == i]),
                "radius": float(radius),
                "within": near.hits,
                "share": near.recall,
                "answerable": near.answerable,
            }
        )
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def _mean(values: NDArray[np.float64]) -> float:
    """Return the mean of the values that are known; NaN where none is."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else np.nan


def measures(
    table: Mapping[str, NDArray], disturbances: Sequence[Disturbance], unit: str, every: int
) -> dict[str, Any]:
    """Return what `results.json` holds, from the rows of `curves`.

    Returns:
        unit, every, radius, queries, map_frames, `disturbances` (name, kind, unit, levels), and `methods`: by method
        and disturbance a list with one entry for each level.
    """
    shared = ("queries", "map_frames", "radius")
    own = [name for name in table if name not in ("method", "disturbance", *shared)]
    methods: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for i, (method, name) in enumerate(zip(table["method"].tolist(), table["disturbance"].tolist(), strict=True)):
        entry = {key: table[key][i].item() for key in own}
        methods.setdefault(method, {}).setdefault(name, []).append(entry)
    return {
        "unit": unit,
        "every": every,
        **{key: table[key][0].item() for key in shared},
        "disturbances": [
            {"name": one.name, "kind": one.kind, "unit": one.unit, "levels": list(one.levels)} for one in disturbances
        ],
        "methods": methods,
    }


def _located(
    session: Session,
    known: VisualMap,
    queries: FrameTable,
    rows: NDArray[np.int64],
    excluded: NDArray[np.bool_] | None,
    disturbances: list[Disturbance],
    name: str,
    clock: Stopwatch,
) -> dict[tuple[str, float], Answer]:
    """Locate queries, batch by batch, at every level of every disturbance."""
    describer: Descriptor = known.describer
    barred: NDArray[np.bool_] | None = None
    nearest = _geometrically_nearest(known.frames, queries, excluded)
    asked = slice(0)

    def locate(images: Images) -> Answer:
        with clock.of("describe", len(images)):
            described = describer.describe(images)
        with clock.of("search", len(images)):
            answer = match(known, described, 1, excluded=barred)
        with clock.of("heading", len(images)):
            turned = headings(known, described, answer)[:, 0]
        if nearest is None:
            return Answer(answer.indices[:, 0], turned)
        row = nearest[asked, None]
        by_nearest = headings(known, described, Retrieval(row, np.zeros(row.shape)))[:, 0]
        return Answer(answer.indices[:, 0], turned, by_nearest)

    batches = track(session.images.batches(queries), len(queries), f"disturbed queries, {name}", size=len)
    found, start = [], 0
    for images in batches:
        part = rows[start : start + len(images)]
        asked = slice(start, start + len(images))
        barred = None if excluded is None else excluded[asked]
        found.append(locate_disturbed(locate, images, part, disturbances, session.seed))
        start += len(images)
    return {key: Answer.concatenate([part[key] for part in found]) for key in found[0]}


def _geometrically_nearest(
    known: FrameTable, queries: FrameTable, excluded: NDArray[np.bool_] | None
) -> NDArray[np.int64] | None:
    """Return the map frame (n,) that lies nearest to each query; None where positions are not known."""
    if not known.has_position.all() or not queries.has_position.all():
        return None
    rows = np.empty(len(queries), dtype=np.int64)
    for i, xy in enumerate(queries.xy):
        apart = np.hypot(*(known.xy - xy).T)
        rows[i] = np.argmin(apart if excluded is None else np.where(excluded[i], np.inf, apart))
    return rows
