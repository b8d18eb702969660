"""Check that killed commands recover: each is killed 100 times, restarted, and ends up like an undisturbed run.

A process is killed (SIGKILL) at a random moment, or right before a random file change: when it opens a file for
writing, renames or removes one, or makes a folder. Then the command is started again as one would type it, with
resume=true if that resumes it, and killed again; after some kills in a row it may finish. The files that exist by then
are compared with those of an undisturbed run, and no temporary file may be left.

Then each is interrupted at random moments, as with Ctrl-C once or twice: it must stop within seconds and without a
traceback, and reach the same end when it is run again.

Files are compared by their bytes; JSON, tables and checkpoints by their values. Anything that already differs between
two undisturbed runs (times, dates) is left out, and is listed in the benchmark's file.

    python -m benchmarks.kills
    python -m benchmarks.kills --only train map --kills 20
"""

from __future__ import annotations

import csv
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from benchmarks.report import Report, parser
from siamloc.cli import main as siamloc
from siamloc.cli.compose import composed
from siamloc.models import build
from siamloc.training import fitting  # noqa: F401 (a child inherits what is loaded, which would take it seconds)

IN_A_ROW = 5
"""Kills in a row after which a command may finish."""
_CHANGES = {"os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.truncate"}
_STARTED = 0.2
"""Seconds until Python itself has started; until then it answers Ctrl-C with a traceback."""
_WRITES = os.O_WRONLY | os.O_RDWR


@dataclass(frozen=True)
class Work:
    """A long command.

    Attributes:
        words: words of the command; {out} is its own folder, {data} the building.
        resume: the word that resumes a killed command, and the file that shows whether there is something to resume;
            None if the same words resume it.
        needs: what its folder contains at the start; see `stages`.
    """

    words: tuple[str, ...]
    resume: tuple[str, str] | None = None
    needs: str = ""


_DATA = ("data=cold", "data.root={data}/mini", "unwrap=none", "data.image_size=[32,128]")
_FEW = ("protocol.map.sequences=[mini_a_seq2_cloudy1]", "protocol.query.sequences=[mini_a_seq2_night1]")
_TRAINING = (
    *("train", *_DATA, "model/branch=simple1", "model/head=fc500_500_5", "batch_size=16", "epochs=4"),
    *("protocol.train.sequences=[mini_a_seq2_cloudy1]", "protocol.validation.sequences=[mini_a_seq2_cloudy2]"),
    *(*_FEW, "trainer.accelerator=cpu", "run={out}/run"),
)
WORKS: dict[str, Work] = {
    "simulate": Work(
        ("simulate", "building=mini", "camera=panorama", "runs=[cloudy1,night1]", "frames=40", "workers=1", "out={out}")
    ),
    "expand": Work(
        ("augment expand", *_DATA, "sequences=[mini_a_seq2_cloudy1]", "depth=6", "workers=1", "out={out}/expanded"),
        ("resume=true", "expanded/augmentation.json"),
    ),
    "prepare": Work(("prepare", *_DATA, "data.cache={out}")),
    "train": Work((*_TRAINING, "pairs.epoch_pairs=400"), ("resume=true", "run/run.json")),
    "train, batches of places": Work(
        (
            *(*_TRAINING, "pairs=in_batch", "model/head=flat", "loss=multi_similarity", "pairs.places=6"),
            *("pairs.epoch_batches=12", "checkpoint_every=5"),
        ),
        ("resume=true", "run/run.json"),
    ),
    "pretrain": Work(
        (
            *(
                "pretrain",
                "epochs=3",
                "model/branch=simple1",
                "model/head=flat",
                "model.canonical=false",
                "image_size=[32,128]",
            ),
            *("pairs.epoch_batches=6", "pairs.places=6", "pairs.images=2", "views.batches=6", "views.held=1"),
            *("views.together=1", "views.drives=2", "views.lights=2", "views.poses=8", "views.processes=0"),
            *("trainer.accelerator=cpu", "run={out}/run"),
        ),
        ("resume=true", "run/run.json"),
    ),
    "map": Work(("map", "run={out}/run", "build=incremental", "protocol.map.every=1"), needs="trained"),
    "evaluate": Work(
        ("evaluate", "run={out}/run", "task.baselines=[thumbnail]", "task.error_model=true"), needs="mapped"
    ),
    "export": Work(("export", "run={out}/run"), needs="mapped"),
    "reproduce": Work(("reproduce", "table_5_15", "data=mini", "root={data}/mini", "scale=smoke", "out={out}")),
}


@dataclass(frozen=True)
class Moment:
    """When to kill: after this many seconds, or right before this file change, counted from 1."""

    seconds: float | None = None
    changes: int | None = None


class Case:
    """A command in its own folder.

    Args:
        name: name of the work.
        folder: folder in which it works.
        stage: folder with `data`, `trained` and `mapped`, from which copies are made.
    """

    def __init__(self, name: str, folder: Path, stage: Path) -> None:
        self.work, self.folder, self._stage = WORKS[name], folder, stage
        self.log = folder.with_suffix(".log")

    def begin(self) -> None:
        """Make the folder as it should be before the command."""
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)
        if self.work.needs:
            shutil.copytree(self._stage / self.work.needs, self.folder / "run")

    def words(self) -> list[str]:
        """Return the words that one would type now."""
        words = [word.format(out=self.folder, data=self._stage / "data") for word in self.work.words]
        if self.work.resume is not None and (self.folder / self.work.resume[1]).is_file():
            words.append(self.work.resume[0])
        return words

    def run(self, moment: Moment | None = None) -> tuple[int | None, float]:
        """Run the command in a child process; return its exit status, None if it was killed, and its seconds."""
        words = self.words()
        begin = time.monotonic()
        child = os.fork()
        if child == 0:
            self._as_child(words, moment)
        limit = None if moment is None else moment.seconds
        while True:
            ended, status = os.waitpid(child, os.WNOHANG)
            if ended:
                break
            if limit is not None and time.monotonic() - begin > limit:
                os.kill(child, signal.SIGKILL)
                limit = None
            time.sleep(0.002)
        seconds = time.monotonic() - begin
        return (None if os.WIFSIGNALED(status) else os.WEXITSTATUS(status)), seconds

    def changes(self) -> int:
        """Return the number of file changes made by the last run that finished."""
        return int(self.log.with_suffix(".changes").read_text())

    def contents(self) -> dict[str, str]:
        """Return the current contents of the folder."""
        return contents(self.folder)

    def last_line(self) -> str:
        """Return the last line that was printed."""
        return self.log.read_text().strip().rpartition("\n")[2]

    def _as_child(self, words: list[str], moment: Moment | None) -> None:
        """Run the command in this process, then exit."""
        status = 99
        try:
            log = os.open(self.log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
            os.dup2(log, 1)
            os.dup2(log, 2)
            count = _count_changes(self.folder, None if moment is None else moment.changes)
            print("$", *words, flush=True)
            status = siamloc(words)
            self.log.with_suffix(".changes").write_text(str(count()))
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(status)


def _count_changes(folder: Path, last: int | None) -> Callable[[], int]:
    """Count this process's file changes in a folder from now on, and kill it right before a given change."""
    inside, done = str(folder), 0

    def watch(event: str, arguments: tuple[Any, ...]) -> None:
        nonlocal done
        writes = event == "open" and isinstance(arguments[2], int) and arguments[2] & _WRITES
        if (writes or event in _CHANGES) and str(arguments[0]).startswith(inside):
            done += 1
            if done == last:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(watch)
    return lambda: done


def contents(folder: Path) -> dict[str, str]:
    """Return the contents of a folder: for each file a hash of its bytes, or of each of its values."""
    found: dict[str, str] = {}
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        name = path.relative_to(folder).as_posix()
        if path.suffix == ".json":
            values = json.loads(path.read_text())
            if path.name == "run.json":  # a resumed training opens another event file
                values["written"] = [item for item in values["written"] if "/events." not in item]
            found.update({f"{name}:{key}": value for key, value in _leaves(values)})
        elif path.suffix == ".csv":
            with path.open(newline="") as file:
                rows = list(csv.DictReader(file))
            names = list(rows[0]) if rows else []
            found.update({f"{name}:{key}": _hashed([row[key] for row in rows]) for key in names})
            found[name] = f"{len(rows)} rows of {names}"
        elif path.suffix == ".ckpt":
            state = torch.load(path, map_location="cpu", weights_only=True)
            for key, value in {**state["state_dict"], "step": state["global_step"], "epoch": state["epoch"]}.items():
                found[f"{name}:{key}"] = _hashed(value.tolist() if isinstance(value, torch.Tensor) else value)
        elif path.name.startswith("events."):
            found["events"] = "there"
        else:
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def _leaves(value: Any, key: str = "") -> Iterator[tuple[str, str]]:
    items: Any = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, list) else None
    if not items:
        yield key, json.dumps(value)
        return
    for name, item in items:
        yield from _leaves(item, f"{key}.{name}")


def _hashed(value: Any) -> str:
    return hashlib.sha256(repr(value).encode()).hexdigest()


@contextmanager
def stages(folder: Path) -> Iterator[Path]:
    """Make the building, a trained run, and the run with its map."""
    data, out = folder / "data", folder / "whole"
    simulated = [word.format(out=data) for word in WORKS["simulate"].words if not word.startswith(("runs", "frames"))]
    _done([*simulated, "runs=[cloudy1,cloudy2,cloudy3,night1,night2,sunny1,sunny2]", "frames=60"])
    train = [word.format(out=out, data=data) for word in WORKS["train"].words]
    _done([*train, "pairs.epoch_pairs=200"])
    (out / "run").rename(folder / "trained")
    shutil.copytree(folder / "trained", folder / "mapped")
    _done(["map", f"run={folder / 'mapped'}"])
    yield folder


def _done(words: Sequence[str]) -> None:
    """Run a command in a child process, so that this one stays without threads."""
    child = os.fork()
    if child == 0:
        status = 99
        try:
            status = siamloc(list(words))
        finally:
            os._exit(status)
    if os.waitpid(child, 0)[1]:
        raise SystemExit(f"siamloc {' '.join(words)} failed")


def killed(case: Case, kills: int, draw: random.Random) -> dict[str, Any]:
    """Kill a command this many times, and return the outcome."""
    undisturbed = []
    for _ in range(2):
        case.begin()
        status, seconds = case.run()
        if status != 0:
            raise SystemExit(f"{' '.join(case.words())} failed: {case.last_line()}")
        undisturbed.append(case.contents())
    changes = case.changes()
    wanted, other = undisturbed
    varying = sorted(key for key in wanted.keys() | other.keys() if wanted.get(key) != other.get(key))
    if any(wanted.keys() ^ other.keys()):
        raise SystemExit(f"two runs leave different files: {sorted(wanted.keys() ^ other.keys())}")
    done, ended, wrong = 0, 0, list[str]()
    while done < kills:
        case.begin()
        for number in range(IN_A_ROW):
            by_time = (done + number) % 2
            moment = Moment(draw.uniform(0, seconds)) if by_time else Moment(changes=draw.randint(1, changes))
            status, _ = case.run(moment)
            if status is not None:
                break
            done += 1
        if status is None:
            status, _ = case.run()
        ended += 1
        found = case.contents() if status == 0 else {}
        differing = sorted(
            key for key in wanted.keys() | found.keys() if key not in varying and wanted.get(key) != found.get(key)
        )
        if status != 0:
            wrong.append(f"ended with status {status}: {case.last_line()}")
        elif differing:
            wrong.append(f"differs in {', '.join(differing[:5])}")
        if wrong:
            print(wrong[-1], flush=True)
    return {"kills": done, "ends": ended, "seconds": seconds, "changes": changes, "wrong": wrong, "varying": varying}


def interrupted(case: Case, times: int, draw: random.Random) -> dict[str, Any]:
    """Interrupt a command this many times, every other time twice, and return the outcome."""
    case.begin()
    begin = time.monotonic()
    command = [sys.executable, "-m", "siamloc"]
    subprocess.run([*command, *case.words()], capture_output=True, check=True)
    seconds, longest, wrong = time.monotonic() - begin, 0.0, list[str]()
    wanted = case.contents()
    for number in range(times):
        case.begin()
        pipes: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
        with subprocess.Popen([*command, *case.words()], start_new_session=True, **pipes) as process:
            time.sleep(draw.uniform(_STARTED, seconds))
            pressed = time.monotonic()
            for pause in (0.0, *(draw.choice([0.001, 0.02, 0.1, 0.4]) for _ in range(number % 2))):
                time.sleep(pause)
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGINT)
            said = process.communicate()[1]
        longest = max(longest, time.monotonic() - pressed)
        if "Traceback" in said or "Exception ignored" in said or process.returncode not in (0, 130, -signal.SIGINT):
            print(f"status {process.returncode}: {said.strip()}", flush=True)
            wrong.append(f"status {process.returncode}: {said.strip()[-300:]}")
        subprocess.run([*command, *case.words()], capture_output=True, check=True)
        files = case.contents()
        if differing := sorted(key for key in wanted.keys() ^ files.keys()):
            wrong.append(f"leaves {differing[:5]}")
            print(wrong[-1], flush=True)
    return {"interrupts": times, "longest_seconds": longest, "interrupts_wrong": wrong}


def main() -> None:
    """Kill each command, print the outcome, and write the file."""
    arguments = parser(__doc__, keeps=True)
    arguments.add_argument("--kills", type=int, default=100, help="kills of each command")
    arguments.add_argument("--interrupts", type=int, default=20, help="interrupts of each command")
    arguments.add_argument("--only", nargs="+", choices=WORKS, default=list(WORKS), help="commands")
    arguments.add_argument("--seed", type=int, default=0)
    options = arguments.parse_args()
    composed("train", ["data=cold", "data.root=x", "protocol.train.sequences=[a]"])
    build("simple1", "fc500_500_5")
    report = Report("kills", options.out)
    rows: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as name, stages(Path(name, "stages")) as stage:
        for number, work in enumerate(options.only):
            case = Case(work, Path(name, f"work{number}"), stage)
            draw = random.Random(options.seed)
            row = killed(case, options.kills, draw) | interrupted(case, options.interrupts, draw)
            rows[work] = row
            print(f"{work}: { {**row, 'varying': len(row['varying'])} }", flush=True)
    for work, row in rows.items():
        report.target(f"{work}: {row['kills']} kills end as undisturbed ({len(row['wrong'])} do not)", not row["wrong"])
        wrong, times = row["interrupts_wrong"], row["interrupts"]
        report.target(f"{work}: {times} interrupts end without a traceback ({len(wrong)} do not)", not wrong)
    report.write({"rows": report.kept(rows, list(WORKS)) if options.keep else rows})


if __name__ == "__main__":
    main()
