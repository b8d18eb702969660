"""`Result`: the result of an evaluation, the same for every task: measures, tables, pictures, files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from foundation.calls import typed
from foundation.files import atomic_files, plain, storage_errors
from siamloc.data.occupancy import read_occupancy
from siamloc.errors import DataError, FormatError
from siamloc.results import REMARKS, Columns, files_of, read_results, read_rows, write_results

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from siamloc.maps.error_model import ErrorModel
    from siamloc.maps.refinement import Refinement
    from siamloc.tables import Table


Measures = dict[str, Any]
"""The measures of a task over all queries. Each task fills in some of the keys.

Keys:
    unit: unit of positions and errors.
    queries: number of queries; by lighting in compact maps.
    map_frames: number of map frames.
    lighting: the same measures by lighting; likewise `room` and `room_by_lighting`.
    error: errors of positions, with "mean", "median", "p95", "max" and "rmse"; likewise `floor` (of the map
        frame that is truly nearest), `excess` (the error above the floor) and `heading_error` in degrees.
    hit_rate: share of queries whose answer lies within each of the `radii`, with "radius" and "rate".
    recall: share of queries with an answer within a radius among the first `ks`, with "radius", "k" and "recall".
    accuracy: share of queries whose room or building is found; `correct` of `queries`.
    confusion: "labels" and "counts" (row = true room or building, column = that of the answer).
    coarse: how often the right node comes first in a hierarchical search; `perfect_coarse` is what the map could do
        with the right node, `absolute` without nodes, and `loss` the difference of the mean errors.
    comparisons: number of map frames that a query is compared with.
    silhouette: silhouette of a map's nodes; likewise `inertia`, `purity`, `closures`, `nodes`, `bytes` and more.
    curves: errors of compact maps by way and number of nodes.
    methods: errors under disturbances, by method and disturbance.
"""


@dataclass(frozen=True, eq=False)
class Result:
    """The result of an evaluation: measures, and the tables from which they are computed.

    Attributes:
        name: name of its folder and of its rows in a comparison, such as "hog".
        parts: measures by kind, such as "absolute" and "room_retrieval", as in `results.json`.
        tables: columns by name; "queries" becomes `queries.csv`, "map" `map.csv`.
        denominators: numbers of queries, map frames, pairs or nodes behind the measures.
        skipped: what could not be measured, with the reason.
        baselines: results of other methods on the same queries, by name.
        cost: time and memory of the method; see `siamloc.evaluation.session.cost`.
        about: what was evaluated: data, protocol, descriptor and so on, as plain values.
        settings: settings of the evaluation, as plain values.
        error_model: the learned error model, if requested.
        refinement: how poses were refined, if requested; the robot does the same.
        layer: folder of the coarse layer, if it is on disk; some pictures need it.

    Example:
        >>> import siamloc
        >>> images = siamloc.data.example()
        >>> monday, tuesday = (images.frames.select(sequence=day) for day in ("monday", "tuesday"))
        >>> known = siamloc.maps.build("hog", images, monday, progress=False)
        >>> result = siamloc.evaluation.rooms(known, images, tuesday)
        >>> sorted(result.tables), result.rows[0]["room"]
        (['map', 'rooms'], 'office')
    """

    name: str
    parts: dict[str, Any]
    tables: dict[str, Columns]
    denominators: dict[str, Any] = field(default_factory=dict)
    skipped: dict[str, str] = field(default_factory=dict)
    baselines: dict[str, Result] = field(default_factory=dict)
    cost: dict[str, Any] = field(default_factory=dict)
    about: dict[str, Any] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)
    error_model: ErrorModel | None = None
    refinement: Refinement | None = None
    layer: Path | None = None

    @property
    def measures(self) -> Measures:
        """Measures of the first part, with keys of `Measures`; measures of all queries are at the top level.

        `measures["error"]["mean"]` is of all queries; the groups follow under "lighting" and "room":
        `measures["lighting"]["night"]["error"]`.
        """
        first: Measures = next(iter(self.parts.values()), {})
        return {**first.get("overall", {}), **{key: value for key, value in first.items() if key != "overall"}}

    @property
    def columns(self) -> Columns:
        """The first table: a row for each query, or for each frame of a map."""
        return next(iter(self.tables.values()))

    @property
    def rows(self) -> list[dict[str, Any]]:
        """The first table, one dictionary per row."""
        values = {name: column.tolist() for name, column in self.columns.items()}
        return [dict(zip(values, row, strict=True)) for row in zip(*values.values(), strict=True)]

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()))) if self.tables else 0

    def __repr__(self) -> str:
        rows = ", ".join(f"{len(next(iter(table.values())))} {name}" for name, table in self.tables.items())
        return f"Result({self.name}: {', '.join(self.parts) or 'nothing measured'}; {rows})"

    def _repr_html_(self) -> str:
        from html import escape

        return f"<pre>{escape(self.table())}</pre>"

    def summaries(self) -> list[Table]:
        """Return the measures as tables: by method and lighting, and what a query costs.

        Raises:
            FormatError: incomplete measures, as from an altered file.
        """
        from siamloc.summaries import tables_of

        baselines = {method: other.parts for method, other in self.baselines.items()}
        costs = {one.name: one.cost for one in (self, *self.baselines.values())}
        try:
            return tables_of(self.name, self.parts, baselines, costs)
        except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
            raise FormatError(f"the measures of {self.name} are not whole ({error!r}): evaluate again") from error

    def table(self) -> str:
        """Return the measures as text: the tables of `summaries`, and what could not be measured.

        Raises:
            FormatError: incomplete measures, as from an altered file.
        """
        lines = [reason if what in REMARKS else f"{what} left out: {reason}" for what, reason in self.skipped.items()]
        if "located" in self.tables:
            lines.append(f"located without a score: {len(self.tables['located']['path'])} queries, in located.csv")
        return "\n\n".join(filter(None, [*(table.text() for table in self.summaries()), "\n".join(lines)]))

    def plot(self, name: str | None = None, plan: str | Path | None = None) -> Figure:
        """Return a picture of the result: the first picture available, or the picture of a name such as "error_curve".

        Args:
            name: name of the picture.
            plan: map.yaml of a map server, which is drawn behind the floor plan; see `siamloc.data.read_occupancy`.

        Raises:
            DataError: there is no such picture; the message lists the available ones. Or the map cannot be read.
        """
        from siamloc.report.draw import pictures

        occupancy = None if plan is None else read_occupancy(plan)
        drawn = pictures(plain(self.parts), self.tables, self.name, occupancy)
        if not drawn or (name is not None and name not in drawn):
            raise DataError(f"there is no picture {name!r} of {self!r}: there is {', '.join(drawn) or 'none'}")
        return drawn[name if name is not None else next(iter(drawn))]()

    @typed
    def save(self, folder: str | Path, *, pictures: bool = True, plan: str | Path | None = None) -> list[Path]:
        """Write `results.json`, a CSV file for each table, and the pictures; return the paths of the pictures.

        Args:
            folder: where they are written.
            pictures: whether to draw any.
            plan: map.yaml of a map server, which is drawn behind floor plans; see `siamloc.data.read_occupancy`.

        Raises:
            DataError: the map cannot be read.
            StorageError: the disk is full or cannot be written to.
        """
        folder, occupancy = Path(folder), None if plan is None else read_occupancy(plan)
        older = files_of(folder)
        extra = {
            f"{name}_{method}": table
            for method, other in self.baselines.items()
            for name, table in other.tables.items()
            if name in ("queries", "rooms", "pairs")
        }
        learned = {"error_model.json": self.error_model, "refinement.json": self.refinement}
        with atomic_files(folder) as fresh:
            for name, model in learned.items():
                if model is not None:
                    model.save(fresh / name)
            write_results(fresh, self.as_dict(), tables={**self.tables, **extra})
        # Remove files that only the replaced result had, and nothing else.
        gone = (older - files_of(folder)) | {name for name, model in learned.items() if model is None}
        with storage_errors(folder):
            for name in gone:
                (folder / name).unlink(missing_ok=True)
        if not pictures:
            return []
        from siamloc.report.draw import save_all

        # Last: a picture that cannot be drawn must not cost the measures.
        return save_all(folder, self.layer, occupancy)

    def as_dict(self) -> dict[str, Any]:
        """Return the content of `results.json`, without the tables."""
        return {
            "command": "evaluate",
            "name": self.name,
            **self.about,
            "config": self.settings,
            "measures": self.parts,
            "baselines": {method: other.parts for method, other in self.baselines.items()},
            "cost": {method: one.cost for method, one in {self.name: self, **self.baselines}.items() if one.cost},
            "denominators": self.denominators,
            "skipped": self.skipped,
        }

    @classmethod
    @typed
    def load(cls, folder: str | Path) -> Result:
        """Read a result that `save` wrote; tables of its baselines are among `tables`, such as `queries_hog`.

        Raises:
            FormatError: a file is missing, truncated, altered, or of a newer version.
        """
        from siamloc.maps.error_model import ErrorModel
        from siamloc.maps.refinement import Refinement

        held = read_results(folder)
        tables = {name: read_rows(folder, name) for name in held.get("tables", {})}
        name, costs = held.get("name", Path(folder).name), held.get("cost", {})
        others = {*cls("", {}, {}).as_dict(), "tables", "pictures", "schema", "created", "versions"}
        about = {key: value for key, value in held.items() if key not in others}
        return cls(
            name=name,
            parts=held["measures"],
            tables=tables,
            denominators=held["denominators"],
            skipped=held.get("skipped", {}),
            baselines={
                method: cls(method, parts, {}, cost=costs.get(method, {}))
                for method, parts in held.get("baselines", {}).items()
            },
            cost=costs.get(name, {}),
            about=about,
            settings=held["config"],
            error_model=ErrorModel.saved(Path(folder) / "error_model.json"),
            refinement=Refinement.saved(Path(folder) / "refinement.json"),
        )

    def with_part(self, name: str, measures: Mapping[str, Any], queries: Columns) -> Result:
        """Return the result with the measures of another part and a new table "queries".

        Args:
            name: name of the part, a key of `parts`, such as "room_retrieval".
            measures: the measures of the part.
            queries: columns of the table that replaces "queries".
        """
        return replace(self, parts={**self.parts, name: measures}, tables={**self.tables, "queries": queries})

    def joined(self, other: Result) -> Result:
        """Return the result with the parts, tables and remarks of another result on the same queries."""
        return replace(
            self,
            parts={**self.parts, **other.parts},
            tables={**self.tables, **{name: table for name, table in other.tables.items() if name not in self.tables}},
            denominators={**other.denominators, **self.denominators},
            skipped={**self.skipped, **other.skipped},
            about={**self.about, **other.about},
            error_model=self.error_model or other.error_model,
            refinement=self.refinement or other.refinement,
        )
