"""Grouping the frames of a map into the nodes of a coarse layer: by rooms, by clustering, or frame by frame."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from analytic import clustering
from analytic.mapper import IncrementalMapper, Parameters
from foundation.calls import typed
from foundation.errors import known as known_name
from foundation.extras import need
from foundation.files import read_json, storage_errors, write_json, write_text
from foundation.locks import LOCK, locked
from foundation.settings import Count, Natural, Positive, Probability, Seed, Settings
from foundation.words import as_words
from siamloc.errors import DataError, FormatError, logger
from siamloc.maps.checked_arrays import check_means
from siamloc.maps.coarse import CoarseLayer, naming, numbered
from siamloc.maps.visual_map import VisualMap
from siamloc.progress import track


@dataclass(frozen=True)
class Rooms(Settings):
    """One node for each room label."""

    WHERE = "build"


@dataclass(frozen=True)
class Sample(Settings):
    """Runs of consecutive frames: the baseline for the clusterings ([C] 5.4).

    Attributes:
        nodes: number of nodes.
    """

    WHERE = "build"

    nodes: Count = 40


@dataclass(frozen=True)
class Spectral(Settings):
    """Normalized spectral clustering of the descriptors ([C] 3).

    Attributes:
        nodes: number of nodes.
        sigma: width of the Gaussian similarity; chosen from the descriptors if None.
        neighbours: neighbours of each frame in a sparse graph; a full graph if None.
        assign: how eigenvectors become nodes.
    """

    WHERE = "build"

    nodes: Count = 40
    sigma: Positive | None = None
    neighbours: Count | None = None
    assign: Literal["kmeans", "som"] = "kmeans"


@dataclass(frozen=True)
class SelfOrganizing(Settings):
    """A self-organizing map of the descriptors ([C] 3).

    Attributes:
        grid: rows and columns of its units; each unit gives at most one node.
    """

    WHERE = "build"

    grid: tuple[Count, Count] = (8, 5)


@dataclass(frozen=True, kw_only=True)
class Incremental(Parameters):
    """The incremental mapper, which adds nodes while the robot drives ([I] 4, [T] 4.3, 4.6); see its `Parameters`."""

    WHERE = "build"

    version: Literal[1, 2] = 2


@dataclass(frozen=True, kw_only=True)
class IncrementalSparse(Incremental):
    """The incremental mapper for frames about 15 cm apart.

    The published thresholds count frames, and are meant for about 5 cm: here a node takes a third as many frames, so
    that it is as long on the ground, and nodes are never merged.
    """

    omega: Positive = 1.0
    x_start: Positive = 1.0
    merge: Literal["changed", "created", "never"] = "never"
    held_out: Probability = 0.5
    first_node: Count = 8
    checked_unassigned: Count = 6
    checked_window: Count = 8
    forced_unassigned: Count = 9
    forced_window: Count = 10
    node_changes: Count = 5
    changes_window: Count = 10
    window: Natural = 12
    smallest_node: Count = 4


WAYS: dict[str, type[Settings]] = {
    "rooms": Rooms,
    "sample": Sample,
    "spectral": Spectral,
    "som": SelfOrganizing,
    "incremental": Incremental,
    "incremental_sparse": IncrementalSparse,
}


@dataclass(frozen=True, repr=False)
class Built:
    """A coarse layer and how it was built.

    Attributes:
        layer: nodes over the frames of the map.
        seconds: time for each frame (n,) if frames were added one by one, else for all frames together (1,); NaN
            for frames that `siamloc.maps.update` added.
        map_digest: digest of the map it was built over.
        reasons: names of `analytic.Reason` for each frame (n): why the incremental mapper put it where it did at the
            time; empty for the other methods.
        mapper: the incremental map; None for the other methods, and after `load`.
    """

    layer: CoarseLayer
    seconds: NDArray[np.float64]
    map_digest: str
    reasons: tuple[str, ...] = ()
    mapper: IncrementalMapper | None = None

    def __repr__(self) -> str:
        return f"Built({self.summary()})"

    def check_map(self, known: VisualMap) -> None:
        """Check that the layer was built over a map.

        Raises:
            DataError: it was built over another map.
        """
        if self.map_digest != known.digest:
            raise DataError(
                f"the layer was not built over {known!r}: build it from this map with siamloc.maps.group, or, where it "
                "ranks nodes by another descriptor, give the map it was built over as coarse_map="
            )

    @typed
    def save(self, folder: str | Path) -> None:
        """Write the layer, and how it was built, to a folder.

        Raises:
            StorageError: the disk is full or cannot be written to.
        """
        folder = Path(folder)
        with storage_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
        with storage_errors(folder), locked(folder / LOCK):
            # Removed first and written last: an interruption leaves no layer next to the explanation of another.
            (folder / "layer.npz").unlink(missing_ok=True)
            placing = {"seconds": self.seconds.tolist(), "reasons": list(self.reasons), "map": self.map_digest}
            write_json(folder / "placing.json", placing)
            if self.mapper is not None:
                self.mapper.save(folder / "mapper.npz")
                if "frames" in self.layer.made:  # its frames are other than those of the map: some were forgotten
                    (folder / "events.jsonl").unlink(missing_ok=True)
                else:
                    write_text(folder / "events.jsonl", "".join(f"{line}\n" for line in self.mapper.events))
                self.mapper.graph().to_json(folder / "graph.json")
            self.layer.save(folder / "layer.npz")

    def summary(self, folder: str | Path | None = None) -> str:
        """Return one line about what was built, and where it is stored."""
        lost = int((self.layer.labels < 0).sum())
        none = f", {lost} frames in none" if lost else ""
        where, frames = "" if folder is None else f"layer: {folder}, ", len(self.layer.labels)
        text = f"{where}{len(self.layer)} nodes over {frames} frames{none}, built in {np.nansum(self.seconds):.1f} s"
        if self.reasons and len(self.layer) == 1:
            text += (
                "; one node: the thresholds count frames that lie a few centimetres apart, so take more frames into "
                "the map (protocol.map.every=1)"
            )
            sparse = IncrementalSparse().plain()
            if any(self.layer.made.get(key) != value for key, value in sparse.items()):
                text += ", or use build=incremental_sparse"
        return text

    @classmethod
    @typed
    def load(cls, folder: str | Path) -> Built:
        """Read what `save` wrote, except the mapper: that is `analytic.IncrementalMapper.load(folder / "mapper.npz")`.

        Raises:
            FormatError: a file is missing, truncated, of another kind, or of another version.
        """
        folder = Path(folder)
        layer, placing = CoarseLayer.load(folder / "layer.npz"), read_json(folder / "placing.json")
        try:
            seconds = np.array(placing["seconds"], dtype=np.float64)
            return cls(layer, seconds, placing["map"], tuple(placing.get("reasons", ())))
        except (KeyError, TypeError, ValueError) as error:
            raise FormatError(f"{folder / 'placing.json'} is not whole: build the layer again") from error


@typed
def group(
    known: VisualMap,
    way: str,
    *,
    seed: Seed = 0,
    folder: str | Path | None = None,
    progress: bool = True,
    **parameters: Any,
) -> Built:
    """Group the frames of a map into the nodes of a coarse layer.

    Args:
        known: a map of n frames in capture order.
        way: a name in `WAYS`: "rooms", "sample", "spectral", "som", "incremental" or "incremental_sparse".
        seed: seed of the clusterings.
        folder: folder of the layer. A layer that was built over this map in the same way is read from there, otherwise
            the result is written there. Nothing is written if None.
        progress: whether to show the progress of the incremental mapper.
        **parameters: parameters of the method; see its settings, such as `Spectral`.

    Raises:
        ConfigError: an unknown method or parameter, a value out of range, or descriptors that it cannot group.
        DataError: no frame has a room label, or no frame ended up in a node.
        AnalyticError: mapper parameters that contradict each other, or descriptors that cannot be clustered.

    Example:
        >>> from siamloc.data import FrameTable
        >>> rooms = FrameTable(path=["1.png", "2.png", "3.png"], room=["office", "office", "hall"])
        >>> group(VisualMap([[0.0], [1.0], [2.0]], rooms), "rooms").layer.names
        array(['hall', 'office'], dtype='<U6')
    """
    settings = WAYS[known_name(way, WAYS, "build")].of(parameters)
    name = "incremental" if isinstance(settings, Incremental) else way  # with thresholds of its own
    made = {"name": name, **settings.plain(), **({} if isinstance(settings, Rooms | Incremental) else {"seed": seed})}
    if folder is not None and (found := _built_before(Path(folder), known, made)) is not None:
        return found
    if not isinstance(settings, Rooms | Sample):
        need("sklearn")
        check_means(known, "use build=sample or rooms, or another descriptor")
    start = time.perf_counter()
    if isinstance(settings, Incremental):
        built = _grown(known, settings, made, progress)
    else:
        layer = CoarseLayer.of_rooms(known) if way == "rooms" else _clustered(known, settings, made, seed)
        built = Built(layer, np.array([time.perf_counter() - start]), known.digest)
    if folder is not None:
        built.save(folder)
    return built


def _built_before(folder: Path, known: VisualMap, made: dict[str, Any]) -> Built | None:
    """Return the layer in a folder if it was built over this map in this way, else None."""
    if not (folder / "layer.npz").is_file():
        return None
    try:
        built = Built.load(folder)
    except FormatError:
        return None
    if built.map_digest != known.digest:
        return None
    had = built.layer.made
    if other := {key: had.get(key) for key, value in made.items() if had.get(key) != value}:
        said = {"name": had.get("name")} if "name" in other else other
        logger.warning("the nodes in %s were made with %s: they are made again", folder, as_words(said))
        return None
    if made["name"] == "rooms" and built.layer.classifier is None:  # the map's network was missing then
        return built if naming(known, built.layer) is None else None
    return built


def _clustered(known: VisualMap, settings: Settings, made: dict[str, Any], seed: int) -> CoarseLayer:
    if isinstance(settings, Sample):
        return CoarseLayer.of_labels(known, clustering.sample(len(known), settings.nodes), made=made)
    if isinstance(settings, SelfOrganizing):
        return CoarseLayer.of_labels(known, clustering.som(known.learned, settings.grid, seed=seed), made=made)
    parameters = settings.plain()
    labels = clustering.spectral(known.learned, parameters.pop("nodes"), seed=seed, **parameters)
    return CoarseLayer.of_labels(known, labels, made=made)


def _grown(known: VisualMap, settings: Incremental, made: dict[str, Any], progress: bool) -> Built:
    mapper = IncrementalMapper(known.descriptor, **settings.plain())
    seconds, reasons = np.zeros(len(known)), []
    poses = np.column_stack([known.frames.xy, known.frames.theta])
    rows: Iterable[int] = range(len(known))
    for row in track(rows, len(known), "mapping") if progress else rows:
        one = known.description.take(slice(row, row + 1))
        start = time.perf_counter()
        decision = mapper.add(one, poses[row].tolist() if np.isfinite(poses[row]).all() else None)
        seconds[row] = time.perf_counter() - start
        reasons.append(decision.reason.name)
    labels = mapper.labels()
    ids = [node.id for node in mapper.nodes]
    if not ids:
        raise DataError(
            f"the mapper made no node of {len(known)} frames: give it more frames, or lower build.first_node"
        )
    layer = CoarseLayer.of_labels(known, numbered(labels, ids), made={**made, "ids": ids})
    return Built(layer, seconds, known.digest, tuple(reasons), mapper)
