"""Test how nonsense is handled: every key of every command with impossible values, and files with damaged bytes.

Settings: each leaf of each command's configuration, from several starting points, is set to values of another type,
negative, zero, infinite, huge and empty ones, lists and mappings. Whether a value is nonsense follows from the type of
the default alone, not from what the code accepts. Calls: the same values for each argument of each public function.
Files: bytes of each kind of file that siamloc reads are flipped, cut, swapped, repeated and replaced with those of
another kind, and the file is read again.

Each case ends with an error message from siamloc, is accepted, ends with a traceback, or takes too long. Targets: no
traceback, nothing above 10 s, and no nonsense accepted.

    python -m benchmarks.torture
"""

from __future__ import annotations

import random
import signal
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from analytic.errors import AnalyticError
from augment.errors import AugmentError
from benchmarks.report import Report, parser
from benchmarks.torture_calls import call_cases
from benchmarks.torture_files import FILES, damaged
from siamloc.cli.compose import composed
from siamloc.data.image_files import UnreadableImageError
from siamloc.errors import SiamlocError
from siamloc.jobs import Localize, Watch
from siamloc.jobs.job import Job, leaves
from siamloc.training import fitting  # noqa: F401 (its packages take seconds to load, which no case should pay for)

LONGEST = 10.0
SENTENCES = (SiamlocError, AnalyticError, AugmentError, UnreadableImageError)
_COLD = ("data=cold", "data.root=x")
_LEARNS = ("train", *_COLD, "protocol.train.sequences=[a]")
STARTS: tuple[tuple[str, ...], ...] = (
    _LEARNS,
    (*_LEARNS, "experiment=modern", "unwrap=polar"),
    (*_LEARNS, "pairs=in_batch", "loss=triplet", "augment=thesis", "unwrap=hyperbolic"),
    (*_LEARNS, "pairs=frames", "loss=cross_entropy"),
    (*_LEARNS, "pairs=distance"),
    *((*_LEARNS, "pairs=in_batch", "model/head=flat", f"loss={loss}") for loss in ("circle", "multi_similarity")),
    (*_LEARNS, "pairs=in_batch", "model/head=flat", "loss=metric_calibrated"),
    ("pretrain",),
    ("simulate",),
    ("report",),
    ("compare", "runs=x"),
    ("augment expand", *_COLD, "out=y"),
    ("augment preview",),
    ("demo",),
    ("reproduce",),
    ("prepare", "data=folder", "data.root=x"),
    ("evaluate", *_COLD, "task=hierarchical", "descriptor=hog", "build=som", "heading=hog"),
    *(
        ("evaluate", *_COLD, "descriptor=hog", f"task={task}")
        for task in ("robustness", "mapping", "buildings", "compact")
    ),
    *(("map", *_COLD, "descriptor=hog", f"build={way}") for way in ("spectral", "incremental", "sample", "rooms")),
    *(
        ("map", *_COLD, f"descriptor={name}")
        for name in ("gist", "wisurf", "briefgist", "fs", "hsv", "radon_fourier", "radon_poc", "thumbnail")
    ),
)
"""Commands, with words that cover every group of keys."""

NOTHING: Any = None
STRANGE: dict[str, Any] = {
    "a text": "abc",
    "an empty text": "",
    "true": True,
    "minus one": -1,
    "zero": 0,
    "a half": 0.5,
    "three halves": 1.5,
    "below zero": -0.5,
    "not a number": float("nan"),
    "infinity": float("inf"),
    "minus infinity": float("-inf"),
    "tiny": 1e-300,
    "huge": 1e30,
    "a huge whole number": 10**12,
    "nothing": NOTHING,
    "an empty list": [],
    "a list": [1, 2],
    "a list of other things": ["abc", None],
    "a list of lists": [[1]],
    "a mapping": {"a": 1},
    "an empty mapping": {},
}
_NEVER_A_NUMBER = {
    *("a text", "an empty text", "true", "not a number", "infinity", "minus infinity"),
    *("an empty list", "a list", "a list of other things", "a list of lists", "a mapping", "an empty mapping"),
    *("huge", "a huge whole number"),
}
_NEVER_A_TEXT = (_NEVER_A_NUMBER - {"a text", "a huge whole number"}) | {"three halves"}
_MAY_BE = {
    ("pairs.scale", "a mapping"),  # by building
    ("pairs.scale", "an empty mapping"),
    ("compile", "true"),  # true, false or auto
    ("trainer.devices", "a list"),  # numbers of GPUs
    ("trainer.accelerator", "huge"),
    ("data.name", "an empty text"),  # that of the file
    ("data.unit", "an empty text"),
}


@dataclass(frozen=True)
class Outcome:
    """The outcome of a case: "refused", "accepted", "nonsense accepted", "traceback" or "too long", and a remark."""

    kind: str
    remark: str = ""


def main() -> None:
    """Run all cases, print the outcomes, and write the file."""
    arguments = parser(__doc__)
    arguments.add_argument("--files", type=int, default=600, help="damaged versions of each kind of file")
    arguments.add_argument("--seed", type=int, default=0)
    options = arguments.parse_args()
    report = Report("torture", options.out)
    found: dict[str, Counter[str]] = {}
    wrong: list[str] = []
    parts = {
        "settings": setting_cases(),
        "unknown keys": unknown_cases(),
        "calls": call_cases(STRANGE),
        "files": file_cases(options.files, options.seed),
    }
    for part, cases in parts.items():
        counts = found[part] = Counter()
        for name, case, nonsense in cases:
            outcome = outcome_of(case, nonsense)
            counts[outcome.kind] += 1
            if outcome.kind not in ("refused", "accepted"):
                wrong.append(f"{part}: {name}: {outcome.kind} {outcome.remark}")
        print(f"{part}: {', '.join(f'{count} {kind}' for kind, count in counts.most_common())}", flush=True)
    print(*wrong, sep="\n")
    total: Counter[str] = sum(found.values(), Counter())
    report.target(f"10,000 cases or more ({total.total()})", total.total() >= 10_000)
    for kind in ("traceback", "too long", "nonsense accepted"):
        report.target(f"no {kind} ({total[kind]})", total[kind] == 0)
    report.write({"rows": {part: dict(counts) for part, counts in found.items()}, "wrong": wrong})


def outcome_of(case: Callable[[], Any], nonsense: bool, longest: float = LONGEST) -> Outcome:
    """Run a case and return its outcome."""
    try:
        with limited(longest):
            case()
    except SENTENCES as error:
        return Outcome("refused", str(error))
    except TimeoutError:
        return Outcome("too long")
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        return Outcome("traceback", f"{type(error).__name__}: {error} ({Path(last.filename).name}:{last.lineno})")
    return Outcome("nonsense accepted" if nonsense else "accepted")


class limited:
    """End with a TimeoutError whatever takes longer than the given seconds."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds

    def __enter__(self) -> None:
        def end(*_: Any) -> None:
            raise TimeoutError

        self.before = signal.signal(signal.SIGALRM, end)
        signal.setitimer(signal.ITIMER_REAL, self.seconds)

    def __exit__(self, *_: object) -> None:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, self.before)


def setting_cases() -> Iterator[tuple[str, Callable[[], Any], bool]]:
    """Yield each leaf of each starting point with each strange value, once, and whether it is nonsense."""
    seen: set[tuple[str, str, str]] = set()
    for command, *words in STARTS:
        job = composed(command, words)
        for key, default in leaves(job.plain()):
            for called, value in STRANGE.items():
                case = (command, key, f"{default!r} {called}")
                if case in seen:
                    continue
                seen.add(case)

                def changed(key: str = key, value: Any = value, job: Job = job) -> None:
                    type(job).of(with_value(job.plain(), key, value))

                yield f"{command} {key}={value!r}", changed, is_nonsense(key, default, called)
    for command, kind in {"localize": Localize, "live": Watch}.items():
        for key, default in kind().plain().items():
            for called, value in STRANGE.items():

                def set_to(kind: type[Job] = kind, key: str = key, value: Any = value) -> None:
                    kind.of({"images": ["a.png"], "bundle": "b", key: value})

                yield f"{command} {key}={value!r}", set_to, is_nonsense(key, default, called)


def unknown_cases() -> Iterator[tuple[str, Callable[[], Any], bool]]:
    """Yield each group of each starting point with one unknown key added."""
    seen: set[tuple[str, str]] = set()
    for command, *words in STARTS:
        job = composed(command, words)
        held = job.plain()
        groups = ["", *(key for key, value in held.items() if isinstance(value, Mapping) and value)]
        for group in groups:
            if (command, f"{group} {held.get(group)}") in seen:
                continue
            seen.add((command, f"{group} {held.get(group)}"))

            def added(group: str = group, job: Job = job) -> None:
                type(job).of(with_value(job.plain(), f"{group}.zzz" if group else "zzz", 1))

            yield f"{command} +{group}.zzz=1", added, True


def file_cases(count: int, seed: int) -> Iterator[tuple[str, Callable[[], Any], bool]]:
    """Yield damaged versions of each kind of file; a change that does no harm does not count as nonsense."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        whole = {kind: one.write(folder / kind) for kind, one in FILES.items()}
        for kind, path in whole.items():
            original = path.read_bytes()
            others = [other.read_bytes() for other in whole.values() if other != path]
            for number in range(count):
                how, content = damaged(original, others, random.Random(f"{seed} {kind} {number}"))

                def read(kind: str = kind, path: Path = path, content: bytes = content) -> None:
                    path.write_bytes(content)
                    FILES[kind].read(path)

                yield f"{kind} {number}, {how}", read, False
            path.write_bytes(original)


def is_nonsense(key: str, default: Any, called: str) -> bool:
    """Whether a strange value is nonsense, judged by the type of the default."""
    if (key, called) in _MAY_BE:
        return False
    if isinstance(default, bool):
        return called != "true"
    if isinstance(default, int | float):
        return called in _NEVER_A_NUMBER
    if isinstance(default, str):
        return called in _NEVER_A_TEXT
    if isinstance(default, list):
        return called in {"a mapping", "not a number", "infinity", "true", "a list of other things", "a list of lists"}
    return called in {"a mapping", "a list of other things", "a list of lists", "not a number", "infinity"}


def with_value(values: Mapping[str, Any], key: str, value: Any) -> dict[str, Any]:
    """Return nested values with another value for a key with dots."""
    first, _, rest = key.partition(".")
    return {**values, first: with_value(values[first], rest, value) if rest else value}


if __name__ == "__main__":
    begin = time.perf_counter()
    main()
    print(f"{time.perf_counter() - begin:.0f} s")
