"""Write the report of a benchmark: the machine, the versions, the figures, and whether the targets were met.

Run a benchmark as a module from the project's root, such as `python -m benchmarks.search`. Each writes
`<name>.json`, which contains the date, into the folder given by `--out`.
"""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from datetime import date
from importlib import metadata
from pathlib import Path
from typing import Any

from foundation.files import read_json, write_json
from siamloc.results import versions

RESULTS = Path(__file__).parent / "results"

Work = Callable[[], Any]


class Report:
    """Collects the targets of a benchmark and writes its file.

    Args:
        name: name of the benchmark and of its file.
        folder: folder of the file.
        packages: packages whose versions are reported in addition to those that siamloc always reports.
    """

    def __init__(self, name: str, folder: Path, packages: Sequence[str] = ()) -> None:
        self.name = name
        self.path = folder / f"{name}.json"
        self._hardware = hardware()  # here, because the load is of interest before the work begins
        self._packages = packages
        self._targets: list[dict[str, Any]] = []
        self._kept: dict[str, Any] = {}

    def target(self, text: str, met: bool) -> None:
        """Print and record whether a target was met."""
        self._targets.append({"target": text, "met": bool(met)})
        print(f"target {text}: {'met' if met else 'NOT met'}")

    def kept(self, rows: Mapping[str, Any], order: Sequence[str] | None = None) -> dict[str, Any]:
        """Return the rows of the existing file, updated with those of this run, in the given order if there is one.

        For each row that this run did not measure, the new file gives the date and the processor it comes from.
        """
        former = read_json(self.path) if self.path.is_file() else {"rows": {}}
        old = {name: row for name, row in former["rows"].items() if name not in rows}
        whence = {"date": former.get("date"), "cpu": former.get("hardware", {}).get("cpu")}
        self._kept = {name: former.get("kept", {}).get(name, whence) for name in old}
        merged = {**old, **rows}
        return {name: merged[name] for name in order or merged if name in merged}

    def former(self, key: str) -> dict[str, Any]:
        """Return a table of the existing file that this run did not measure."""
        former = read_json(self.path) if self.path.is_file() else {}
        if former.get(key):
            whence = {"date": former.get("date"), "cpu": former.get("hardware", {}).get("cpu")}
            self._kept[key] = former.get("kept", {}).get(key, whence)
        return dict(former.get(key, {}))

    def write(self, figures: Mapping[str, Any]) -> None:
        """Write the figures with the date, the hardware, the versions and the targets."""
        about = {
            "benchmark": self.name,
            "schema": 1,
            "date": date.today().isoformat(),
            "hardware": self._hardware,
            "versions": {**versions(), **{package: _version(package) for package in self._packages}},
        }
        kept = {"kept": self._kept} if self._kept else {}
        write_json(self.path, {**about, **figures, **kept, "targets": self._targets})
        print(f"written to {self.path}")


def parser(doc: str | None, keeps: bool = False) -> argparse.ArgumentParser:
    """Return a parser that shows the module's docstring and accepts `--out`, and `--keep` if rows can be kept."""
    made = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--out", type=Path, default=RESULTS, metavar="FOLDER", help="folder of the JSON file")
    if keeps:
        made.add_argument("--keep", action="store_true", help="keep rows of the existing file that this run leaves out")
    return made


def hardware() -> dict[str, Any]:
    """Return the processor, the usable cores, the requested threads, the load, and the system."""
    return {
        "cpu": _cpu(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "threads": os.environ.get("OMP_NUM_THREADS", "all"),
        "load_average_before": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "system": platform.platform(),
    }


def seconds(works: Mapping[str, Work], repeats: int) -> dict[str, list[float]]:
    """Return the seconds of each workload, timed in turn after a warm-up, so that a busy machine slows all alike."""
    for work in works.values():
        work()
    times: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(repeats):
        for name, work in works.items():
            start = time.perf_counter()
            work()
            times[name].append(time.perf_counter() - start)
    return times


def medians(works: Mapping[str, Work], repeats: int) -> dict[str, float]:
    """Return the median seconds of each workload, measured as in `seconds`."""
    return {name: statistics.median(values) for name, values in seconds(works, repeats).items()}


def milliseconds(work: Work, repeats: int) -> dict[str, float]:
    """Return median wall-clock and CPU times after a warm-up; CPU time is less sensitive to other programs."""
    work()
    clock, processor = [], []
    for _ in range(repeats):
        started = time.perf_counter(), time.process_time()
        work()
        clock.append(time.perf_counter() - started[0])
        processor.append(time.process_time() - started[1])
    return {"ms": round(1000 * statistics.median(clock), 2), "cpu_ms": round(1000 * statistics.median(processor), 2)}


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _cpu() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()
