"""`reproduce`: measure what a recipe requires, and keep the results."""

from __future__ import annotations

import os
import platform
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from foundation.calls import typed
from foundation.files import content_key, plain, read_json, storage_errors, write_json
from foundation.settings import NotNegative, Text, checked
from siamloc.errors import ConfigError, DataError, FormatError
from siamloc.progress import track
from siamloc.reproduce.published import Record
from siamloc.reproduce.recipe_book import DataName, Job, Recipe, Scale, data_named, experiment, recipe
from siamloc.reproduce.reproduction import Reproduction

if TYPE_CHECKING:
    from siamloc.reproduce.experiments import Data

_VERSION = 1
"""Version of the experiments: records from another version are measured again."""


@typed
def reproduce(
    id: str | Recipe,
    *,
    data: DataName = "freiburg_sim",
    root: str | Path | None = None,
    scale: Scale = "short",
    out: str | Path = "reproduced",
    measure: bool = True,
    progress: bool = True,
) -> Reproduction:
    """Measure what a recipe requires; earlier measurements on the same data are read from `out`.

    Args:
        id: id of the recipe, such as "figure_3_11", or your own `Recipe`.
        data: "cold", "freiburg_sim" or "mini".
        root: folder of the data; the usual place of the data set if None.
        scale: "smoke" (seconds), "short" (minutes) or "full" (as published).
        out: folder for the measured numbers; every job is saved there as soon as it is done.
        measure: whether to measure what is missing; otherwise missing numbers are an error.
        progress: whether to show the progress.

    Raises:
        ConfigError: an unknown recipe, data set or scale.
        DataError: data that do not exist or lack a drive (the message says where they should be); with
            `measure=False`, numbers that have not been measured before.
        StorageError: the disk is full or cannot be written to; finished measurements are kept.

    Example:
        >>> reproduce("figure_3_11", scale="long")
        Traceback (most recent call last):
        foundation.errors.ConfigError: scale must be smoke or short or full, got 'long'
    """
    chosen = recipe(id) if isinstance(id, str) else id
    measured = Path(out) / "measured"
    with storage_errors(measured):
        measured.mkdir(parents=True, exist_ok=True)  # fails here, not after the first job
    jobs, opened = chosen.jobs(scale), _Opened(data, None if root is None else Path(root), Path(out) / "training")
    records: list[Record] = []
    beside: list[Record] = []
    seconds, machines = dict.fromkeys(chosen.experiments, 0.0), []
    for job in track(jobs, len(jobs), f"measuring {chosen.id}") if progress else jobs:
        done = _done(job, opened, Path(out), data, measure)
        (beside if experiment(job.experiment).beside else records).extend(_with_size(done["records"], job))
        seconds[job.experiment] += done["seconds"]
        machines.append(done["machine"])
    return Reproduction(
        chosen, data, scale, tuple(records), tuple(beside), seconds, tuple(dict.fromkeys(filter(None, machines)))
    )


def machine() -> str:
    """Describe this machine: its processors, and its graphics card if PyTorch uses one."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    said = f"{os.cpu_count()} cores of {names[0] if names else platform.processor() or platform.machine()}"
    torch = sys.modules.get("torch")
    if torch is not None and torch.cuda.is_available():
        said += f" with {torch.cuda.get_device_name()}"
    return said


class _Opened:
    """The data sets that jobs need, opened once."""

    def __init__(self, name: str, root: Path | None, work: Path) -> None:
        self.name, self.root, self.work = name, root, work
        self._held: dict[tuple[bool, tuple[int, int]], Data] = {}

    def of(self, job: Job) -> Data:
        from siamloc.reproduce.experiments import Data, image_size

        key = job.dense, image_size(job)
        if key not in self._held:
            about = data_named(self.name)
            if self.root is None and about["root"] is None:
                raise ConfigError(f"say where {about['title']} is: root=FOLDER; {about['how']}")
            root = self.root or Path(about["root"])
            if job.dense and about.get("dense"):
                root = root.parent / "dense" / root.name
            self._held[key] = Data(self.name, root, key[1], self.work)
        return self._held[key]


def _done(job: Job, opened: _Opened, out: Path, data: str, measure: bool) -> dict[str, Any]:
    """Return the records of a job and their cost, measured or read from an earlier measurement."""
    held = opened.of(job)
    wanted = {"version": _VERSION, "data": data, "frames": _fingerprint(job, held), **job.plain()}
    path = out / "measured" / job.experiment / f"{content_key(wanted)}.json"
    if (kept := _kept(path, wanted)) is not None:
        return kept
    if not measure:
        raise DataError(f"not all of it was measured before on these data and kept in {out}")
    from siamloc.reproduce.experiments import measured

    start = time.monotonic()
    records = list(measured(job, held))
    took = {"seconds": time.monotonic() - start, "machine": machine()}
    told = [{"measure": one.measure, "value": one.value, "settings": dict(one.settings)} for one in records]
    write_json(path, {"job": wanted, **took, "records": told, "key": content_key(told)})
    return {"records": records, **took}


def _kept(path: Path, wanted: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return the saved results of a job; None if there are none or they were altered: then it is measured again."""
    try:
        kept = checked(read_json(path), dict, "kept")
        told = checked(kept.get("records"), tuple[dict, ...], "records")
        seconds = float(checked(kept.get("seconds"), NotNegative, "seconds"))
        if not told or plain(kept.get("job")) != plain(dict(wanted)):
            return None
        if "key" in kept and kept["key"] != content_key(told):  # files of older versions of siamloc have none
            return None
        # The oldest records name only the processor family, which says little.
        known = str(kept.get("machine", ""))
        return {
            "records": [_of_plain(one) for one in told],
            "seconds": seconds,
            "machine": known if " " in known else "",
        }
    except (FormatError, ConfigError, KeyError):
        return None


def _fingerprint(job: Job, data: Data) -> str:
    """Return a key of the frames that a job uses: their names, poses and rooms, regardless of their folder."""
    told = []
    held = [data, data.other] if job.kind == "buildings" else [data]
    for name, role, one in ((*item, one) for one in held for item in sorted(job.roles.items())):
        frames = one.role(role)
        names = [Path(path).name for path in frames.path.tolist()]
        told.append([name, frames.sequence.tolist(), names, frames.xy.tolist(), frames.room.tolist()])
    return content_key(told)


def _of_plain(one: Mapping[str, Any]) -> Record:
    """Return a saved record.

    Raises:
        ConfigError, KeyError: it is not a record.
    """
    measure, settings = checked(one["measure"], Text, "measure"), checked(one["settings"], dict, "settings")
    for name, value in settings.items():
        checked(value, str | bool | int | float | None, name)
    return Record(measure, float(checked(one["value"], float, "value")), MappingProxyType(settings))


def _with_size(records: Sequence[Record], job: Job) -> list[Record]:
    """Add the size of the descriptor to records of disturbed images, since [T] 3.5.2 draws them over it."""
    if job.kind != "disturbed" or job.options["descriptor"]["name"] == "pretrained":
        return list(records)
    from siamloc.reproduce.experiments import information

    size = information(job)
    return [Record(one.measure, one.value, MappingProxyType({**one.settings, "information": size})) for one in records]
