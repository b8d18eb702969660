"""`reproduce`: measure what a study requires, and keep the results."""

from __future__ import annotations

import os
import platform
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from foundation.calls import typed
from foundation.files import content_key, plain, read_json, storage_errors, write_json
from siamloc.errors import ConfigError, DataError, FormatError
from siamloc.progress import track
from siamloc.reproduce.claims import spread_of
from siamloc.reproduce.published import Record, over_seeds
from siamloc.reproduce.reproduction import Reproduction
from siamloc.reproduce.study_book import DataName, Job, Scale, Study, data_named, experiment, folder_of, study

if TYPE_CHECKING:
    from siamloc.reproduce.experiments import Data

_VERSIONS = {"disturbed": 2, "mapping": 3, "matched": 3}
"""Version of each kind of experiment, 1 if not listed: records from another version are measured again."""


@typed
def reproduce(
    id: str | Study,
    *,
    data: DataName = "freiburg_sim",
    root: str | Path | None = None,
    scale: Scale = "short",
    out: str | Path = "reproduced",
    measure: bool = True,
    progress: bool = True,
) -> Reproduction:
    """Measure the numbers of a study; earlier measurements on the same data are read from `out`.

    Args:
        id: id of the study, such as "figure_3_11", or your own `Study`.
        data: "cold", "freiburg_sim" or "mini".
        root: folder of the data; the usual place of the data set if None.
        scale: "smoke" (seconds), "short" (minutes) or "full" (as published).
        out: folder for the measured numbers; every job is saved there as soon as it is done.
        measure: whether to measure what is missing; otherwise missing numbers are an error.
        progress: whether to show the progress.

    Raises:
        ConfigError: an unknown study, data set or scale.
        DataError: data that do not exist or lack a drive (the message says where they should be); with
            `measure=False`, numbers that have not been measured before.
        StorageError: the disk is full or cannot be written to; finished measurements are kept.

    Example:
        >>> reproduce("figure_3_11", scale="long")
        Traceback (most recent call last):
        foundation.errors.ConfigError: scale must be smoke or short or full, got 'long'
    """
    chosen = study(id) if isinstance(id, str) else id
    measured = Path(out) / "measured"
    with storage_errors(measured):
        measured.mkdir(parents=True, exist_ok=True)  # a folder that cannot be made fails here, not after the first job
    jobs, opened = chosen.jobs(scale, data), dict[tuple[bool, str, tuple[int, int]], "Data"]()
    records: dict[bool, list[Record]] = {False: [], True: []}
    seconds, machines = dict.fromkeys(chosen.experiments, 0.0), []
    for job in track(jobs, len(jobs), f"measuring {chosen.id}") if progress else jobs:
        kept = _done(job, open_data(job, data, root, Path(out), opened), Path(out), measure)
        made = [Record(**one) for one in kept["records"]]
        records[experiment(job.experiment).beside] += [replace(one, spread=spread_of(job.kind, one)) for one in made]
        seconds[job.experiment] += kept["seconds"]
        machines.append(kept["machine"])
    ours, beside = (tuple(over_seeds(found)) for found in records.values())
    return Reproduction(chosen, data, scale, ours, beside, seconds, tuple(dict.fromkeys(filter(None, machines))))


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


def open_data(job: Job, name: str, root: str | Path | None, out: Path, opened: dict[Any, Data]) -> Data:
    """Return the data set of a job, and open it unless it is open already.

    Args:
        job: the job, which needs frames of one place at one image size.
        name: a name in `study_book.yaml`.
        root: folder of the data set, with the data sets of other places next to it, or the folder that holds all of
            them; the usual folder if None.
        out: folder in whose "training" folder unfinished trainings are kept.
        opened: data sets that are open, to which a newly opened one is added.

    Raises:
        ConfigError: no root for a data set without a usual one.
        DataError: a folder that does not exist.
    """
    from siamloc.reproduce.experiments import Data, image_size

    key, about = (job.dense, job.at, image_size(job)), data_named(name)
    if key not in opened:
        folder = root if root is not None else about["root"]
        if folder is None:
            raise ConfigError(f"say where {about['title']} is: root=FOLDER; {about['how']}")
        own = folder_of(name, Path(folder, about["within"])) if "within" in about else Path(folder)
        own = own if own.is_dir() else Path(folder)
        place = about["at"].get(job.at, "{}").format(own.name)
        place = Path("dense", place) if job.dense and about.get("dense") else place
        opened[key] = Data(name, folder_of(name, own.parent / place), key[2], out / "training")
    return opened[key]


def _done(job: Job, data: Data, out: Path, measure: bool) -> dict[str, Any]:
    """Return the records of a job and their cost, measured or read from an earlier measurement."""
    from siamloc.reproduce.experiments import measured

    wanted = {
        "version": _VERSIONS.get(job.kind, 1),
        "data": data.name,
        "frames": _fingerprint(job, data),
        **job.plain(),
    }
    path = out / "measured" / job.experiment / f"{content_key(wanted)}.json"
    if (kept := _kept(path, wanted)) is not None:
        return kept
    if not measure:
        raise DataError(f"not all of it was measured before on these data and kept in {out}")
    start = time.monotonic()
    records = [
        {"measure": one.measure, "value": one.value, "settings": dict(one.settings)} for one in measured(job, data)
    ]
    made = {"job": wanted, "seconds": time.monotonic() - start, "machine": machine(), "records": records}
    write_json(path, {**made, "key": content_key(made)})
    return made


def _kept(path: Path, wanted: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return the saved results of a job; None if it has to be measured, as there are none or they were altered."""
    try:
        kept = read_json(path)
    except FormatError:
        return None
    key = kept.pop("key", None) if isinstance(kept, dict) else None
    return kept if key == content_key(kept) and kept["job"] == plain(dict(wanted)) and kept["records"] else None


def _fingerprint(job: Job, data: Data) -> str:
    """Return a key of the frames that a job uses: their names, poses and rooms, regardless of their folder."""
    used = []
    for one in [data, data.other] if job.kind == "buildings" else [data]:
        for name, role in sorted(job.roles.items()):
            frames = one.role(role)
            names = [Path(path).name for path in frames.path.tolist()]
            used.append([name, frames.sequence.tolist(), names, frames.xy.tolist(), frames.room.tolist()])
    return content_key(used)
