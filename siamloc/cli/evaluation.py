"""What an evaluation of absolute localization and room retrieval leaves: results by task, and their files."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from analytic import Descriptor
from siamloc.cli.compose import plain
from siamloc.evaluation.absolute import AbsoluteResult
from siamloc.evaluation.error_model import ErrorModel
from siamloc.evaluation.room_retrieval import PairResult, RoomResult
from siamloc.results import Columns, write_results


@dataclass
class Evaluation:
    """The results of one descriptor by task.

    Attributes:
        absolute: absolute localization.
        rooms: room retrieval.
        pairs: pairs of images.
        further: measures of what stands beside absolute localization, by name.
        details: what that was made with, as plain values.
        errors: the model of the error, where one was learned.
        located: where queries without a pose were found.
        skipped: what could not be measured, with the reason.
    """

    absolute: AbsoluteResult | None = None
    rooms: RoomResult | None = None
    pairs: PairResult | None = None
    further: dict[str, Any] = field(default_factory=dict)
    details: dict[str, Any] = field(default_factory=dict)
    errors: ErrorModel | None = None
    located: Columns | None = None
    skipped: dict[str, str] = field(default_factory=dict)

    @property
    def scored(self) -> bool:
        """Whether anything was measured, and not located alone."""
        return self.absolute is not None or self.rooms is not None

    def measures(self) -> dict[str, Any]:
        """Return the measures of what was measured."""
        parts = {"absolute": self.absolute, "room_retrieval": self.rooms, "room_pairs": self.pairs}
        return {**{name: part.measures() for name, part in parts.items() if part is not None}, **self.further}

    def tables(self, suffix: str = "") -> dict[str, dict[str, Any]]:
        """Return the columns of what was measured by table name."""
        parts = {"queries": self.absolute, "rooms": self.rooms, "pairs": self.pairs}
        return {name + suffix: part.columns for name, part in parts.items() if part is not None}


def write(
    config: DictConfig,
    folder: Path,
    descriptor: Descriptor,
    result: Evaluation,
    baselines: dict[str, Evaluation],
    kind: str,
) -> dict[str, Any]:
    """Write the files and return the measures of the descriptor and of its baselines."""
    tables = result.tables()
    rows = tables.pop("queries", None)
    denominators: dict[str, Any] = {}
    if result.absolute is not None:
        for name, baseline in baselines.items():
            if baseline.absolute is not None:
                result.absolute = result.absolute.with_baseline(name, baseline.absolute)
        rows = result.absolute.columns
        tables["map"] = result.absolute.map_columns
        denominators = result.absolute.denominators()
    elif result.rooms is not None:
        denominators = {"queries": len(result.rooms)}
    if result.pairs is not None:
        denominators["pairs"] = len(result.pairs)
    for name, baseline in baselines.items():
        tables.update(baseline.tables(f"_{name}"))
    if result.located is not None:
        tables["located"] = result.located
    if result.errors is not None:
        result.errors.save(folder / result.details["error_model"]["file"])
    measures = {
        "measures": result.measures(),
        "baselines": {name: baseline.measures() for name, baseline in baselines.items()},
    }
    write_results(
        folder,
        {
            "command": "evaluate",
            "protocol": kind,
            "descriptor": descriptor.identity,
            "config": plain(config),
            **measures,
            "denominators": denominators,
            "skipped": result.skipped,
            **({"estimates": result.details} if result.details else {}),
        },
        rows,
        tables,
    )
    return measures
