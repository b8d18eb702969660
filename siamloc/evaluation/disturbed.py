"""Robustness: the error of absolute localization for increasingly disturbed queries ([T] 3.4.2)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from analytic.disturb import BarColour
from foundation.calls import OF_FIELDS, takes
from foundation.settings import Count, NotNegative, Rule, Seed, Settings, Share
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.data.protocol import Protocol
from siamloc.errors import ConfigError
from siamloc.evaluation.disturbed_tables import Answer, answers, concatenated, curves, measures
from siamloc.evaluation.result import Result
from siamloc.evaluation.session import Baselines, Session, cost
from siamloc.maps import Retrieval, VectorIndex, VisualMap, headings, match
from siamloc.progress import track
from siamloc.stopwatch import Stopwatch

Images = NDArray[np.uint8]
Locate = Callable[[Images], Answer]

_UNITS = {"noise": "variance", "occlusion": "share of the columns", "turn": "degrees", "effect": "strength"}


def _levels(low: float, high: float) -> Rule:
    def fits(values: Sequence[float]) -> bool:
        return len(set(values)) == len(values) and all(low <= value <= high for value in values)

    return Rule(f"a list of numbers from {low:g} to {high:g} that differ", fits)


@dataclass(frozen=True)
class Robustness(Settings):
    """How the queries' images are disturbed; the map stays clean.

    Attributes:
        every: use every k-th query.
        radius: the share of queries located within this radius is measured, in the unit of the positions.
        noise: noise variances for images in [0, 1]; the levels of the thesis if None, no noise if ().
        occlusion: shares of the columns behind bars; the levels of the thesis if None, no bars if ().
        bars: number of upright bars that together hide that share of the columns.
        bar_colour: "black", "grey", or "mean", the mean colour of each image.
        bar_place: where bars stand, from 0, left, to 1, right, each in its own part of the image; drawn if None. See
            `analytic.disturb.occlude`.
        turn: degrees by which the robot has turned left.
        effects: effects of `augment`, such as "bulb", "darken" or "blur".
        strengths: strengths of each effect: 0 has no effect, 1 is the far end of its ranges.
    """

    WHERE = "task.robustness"

    every: Count = 5
    radius: NotNegative = 0.5
    noise: Annotated[tuple[float, ...], _levels(0, np.inf)] | None = None
    occlusion: Annotated[tuple[float, ...], _levels(0, 1)] | None = None
    bars: Count = 1
    bar_colour: BarColour = "black"
    bar_place: Share | None = None
    turn: Annotated[tuple[float, ...], _levels(-360, 360)] = (0, 1, 5, 15, 45, 90, 180)
    effects: tuple[str, ...] = ()
    strengths: Annotated[tuple[float, ...], _levels(-1, 1)] = (0, 0.25, 0.5, 0.75, 1)

    def disturbances(self, circular: bool) -> list[Disturbance]:
        """Return the disturbances that the settings request.

        Args:
            circular: whether the columns of the images wrap around.

        Raises:
            ConfigError: no disturbance, or the same one twice.
        """
        from analytic.disturb import NOISE_LEVELS, OCCLUSION_LEVELS

        wanted = [
            ("noise", "noise", NOISE_LEVELS if self.noise is None else self.noise),
            ("occlusion", "occlusion", OCCLUSION_LEVELS if self.occlusion is None else self.occlusion),
            ("turn", "turn", self.turn if circular or self.turn != type(self).turn else ()),
            *((name, "effect", self.strengths) for name in self.effects),
        ]
        names = [name for name, _, _ in wanted]
        if twice := [name for name in names if names.count(name) > 1]:
            raise ConfigError(
                f"task.robustness.effects names {twice[0]!r} twice, or a disturbance that is there already"
            )
        bars = {"bars": self.bars, "colour": self.bar_colour, "place": self.bar_place}
        made = [
            Disturbance(name, tuple(map(float, levels)), kind, circular, bars)
            for name, kind, levels in wanted
            if levels or kind == "effect"
        ]
        if not made or not made[-1].levels:
            raise ConfigError(
                "task.robustness has no levels at all: give noise, occlusion, turn, or effects and strengths"
            )
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
    settings: Robustness = OF_FIELDS,
    **fields: Any,
) -> Result:
    """Measure how errors grow when the queries' images are disturbed.

    If the map or the queries have no positions at all, answers are judged by their room: the error is 1 in a wrong
    room and 0 in the right one.

    Args:
        known: the map; frames without a position are left out, and so are queries without one.
        images: panoramas of the queries (and of the map's frames for baselines).
        queries: frames to locate.
        protocol: which map frames a query may be compared with; see `localization`.
        baselines: descriptors measured on the same frames; see `localization`.
        name: names the result folder and the rows in comparisons; the name of the descriptor if None.
        seed: seed of the noise, the bars and the places of effects.
        settings: all settings in one object, instead of one keyword each.

    Returns:
        A result with the tables "robustness", a row per method, disturbance and level, and "answers", a row per query
        as well.

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
    parts, costs = [], {}
    for label, other in {session.name: known.descriptor, **session.baselines}.items():
        own = session.map_by(other).take(in_map)
        excluded = session.protocol.excluded(asked, own.frames)
        clock = Stopwatch()
        found = _located(session, own, asked, rows, excluded, disturbances, label, clock)
        costs[label] = cost(own, clock)
        parts.append(answers(label, own.frames, asked, found, by_room, excluded))
    every = concatenated(parts)
    table = curves(every, settings.radius, int(in_map.sum()))
    unit = "wrong rooms" if by_room else known.unit
    measured = measures(table, [one.plain() for one in disturbances], unit, settings.every)
    result = Result(
        name=session.name,
        parts={"robustness": measured},
        tables={"robustness": table, "answers": every},
        denominators={"queries": len(rows), "queries_of_the_role": len(scored), "map_frames": measured["map_frames"]},
        cost=costs.pop(session.name),
        baselines={label: Result(label, {}, {}, cost=taken) for label, taken in costs.items()},
    )
    return session.finished(result, settings)


@dataclass(frozen=True)
class Disturbance:
    """A disturbance of query images, at several levels.

    Attributes:
        name: "noise", "occlusion", "turn", or an effect of `augment`.
        levels: noise variances for images in [0, 1]; shares of the columns; degrees turned left; strengths in [-1, 1].
        kind: "effect" for an effect of `augment`, even one called noise; otherwise the name.
        circular: whether columns wrap around.
        bars: number, colour and place of the bars, as arguments of `analytic.disturb.occlude`.

    Raises:
        ConfigError: a turn of images whose columns do not wrap around.
        AugmentError: an unknown effect.
    """

    name: str
    levels: tuple[float, ...]
    kind: str
    circular: bool = True
    bars: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.kind == "turn" and not self.circular:
            raise ConfigError(
                "images whose columns do not wrap around cannot be turned: leave turn out "
                "(task.robustness.turn=[]), or say that they do (circular=true)"
            )
        if self.kind == "effect":
            self._effect()

    def plain(self) -> dict[str, Any]:
        """Return the name, the kind, and the levels with their unit."""
        return {"name": self.name, "kind": self.kind, "unit": _UNITS[self.kind], "levels": list(self.levels)}

    def apply(self, images: Images, level: float, rows: NDArray[np.int64], seed: int = 0) -> Images:
        """Return disturbed images; random draws differ between images, but not between levels.

        Args:
            images: (B, 3, H, W) uint8, RGB.
            level: strength of the disturbance, one of its levels.
            rows: indices of the queries (B,), which determine the draws together with the seed.
            seed: seed of the noise, the bars and the places of effects.
        """
        from analytic import disturb

        if self.kind == "turn":
            return np.roll(images, round(level / 360 * images.shape[-1]), axis=-1)
        if self.kind == "effect":
            return self._with_effect(images, level, rows, seed)
        draws = zip(images, (np.random.default_rng((seed, row)) for row in rows.tolist()), strict=True)
        if self.kind == "noise":
            return np.stack([disturb.noise(image, level, rng) for image, rng in draws])
        options = {"circular": self.circular, **self.bars}
        return np.stack([disturb.occlude(image, level, rng, **options) for image, rng in draws])

    def _with_effect(self, images: Images, strength: float, rows: NDArray[np.int64], seed: int) -> Images:
        """Apply an effect with given strengths; everything else (places, forms) is drawn."""
        import torch

        effect, batch = self._effect(), torch.from_numpy(np.ascontiguousarray(images))
        height, width = batch.shape[2:]
        strong = effect.at(strength, batch)
        seeds = [int(np.random.SeedSequence((seed, row)).generate_state(1)[0]) for row in rows.tolist()]
        draws = [effect.draw(torch.Generator().manual_seed(one), batch[:1]) for one in seeds]
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
    locate: Locate, images: Images, rows: NDArray[np.int64], disturbances: Sequence[Disturbance], seed: int = 0
) -> dict[tuple[str, float], Answer]:
    """Return the answers for each query by disturbance and level.

    Levels that leave the images unchanged share one search.

    Args:
        locate: describes images and finds their nearest map frames.
        images: (B, 3, H, W) uint8, RGB.
        rows: indices of the queries (B,).
        disturbances: the disturbances, each of which is applied at all of its levels.
        seed: seed of the noise, the bars and the places of effects.
    """
    clean: Answer | None = None
    found: dict[tuple[str, float], Answer] = {}
    for disturbance in disturbances:
        for level in disturbance.levels:
            changed = disturbance.apply(images, level, rows, seed)
            if np.array_equal(changed, images):
                answer = clean = locate(images) if clean is None else clean
            else:
                answer = locate(changed)
            found[disturbance.name, level] = _unturned(answer, disturbance, level)
    return found


def _unturned(answer: Answer, disturbance: Disturbance, level: float) -> Answer:
    """Return an answer with headings before the robot's turn on the spot, since the true headings are of that time."""
    if disturbance.kind != "turn":
        return answer
    turned = np.radians(level)
    before = (np.pi - np.remainder(np.pi - one + turned, 2 * np.pi) for one in (answer.heading, answer.heading_nearest))
    return Answer(answer.nearest, *before)


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
    nearest = _geometrically_nearest(known.frames, queries, excluded)
    batch = slice(0)  # the rows of the queries that are being located

    def locate(images: Images) -> Answer:
        with clock.of("describe", len(images)):
            described = known.describe(images)
        with clock.of("search", len(images)):
            answer = match(known, described, 1, excluded=None if excluded is None else excluded[batch])
        with clock.of("heading", len(images)):
            turned = headings(known, described, answer)[:, 0]
        by_nearest = np.full(len(images), np.nan)
        if nearest is not None:
            by_nearest = headings(known, described, Retrieval(nearest[batch, None], np.zeros((len(images), 1))))[:, 0]
        return Answer(answer.indices[:, 0], turned, by_nearest)

    found = []
    for images in track(session.images.batches(queries), len(queries), f"disturbed queries, {name}", size=len):
        batch = slice(batch.stop, batch.stop + len(images))
        found.append(locate_disturbed(locate, images, rows[batch], disturbances, session.seed))
    return {key: Answer.concatenate([part[key] for part in found]) for key in found[0]}


def _geometrically_nearest(
    known: FrameTable, queries: FrameTable, excluded: NDArray[np.bool_] | None
) -> NDArray[np.int64] | None:
    """Return the map frame (n,) that is nearest to each query in position; None if a position is unknown."""
    if not known.has_position.all() or not queries.has_position.all():
        return None
    return VectorIndex(known.xy).search(queries.xy, excluded=excluded).indices[:, 0]
