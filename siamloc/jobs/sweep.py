"""The jobs of a sweep: the settings in which they differ, and the folder of each job."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Mapping
from contextvars import ContextVar, copy_context
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from foundation.settings import within

Choice = Callable[[str], bool]
_MOST_BYTES = 150  # in a folder name; file systems allow 255
_UNUSUAL = re.compile(r"[^\w.+/=\[\]'\",-]")
"""A symbol that values may differ in alone, such as the brackets of "Tag (1)"."""
_OF_MAPS = (
    "data",
    "unwrap",
    "protocol",
    "experiment",
    "descriptor",
    "heading",
    "distance",
    "model",
    "checkpoint",
    "mounting",
)
_OF_QUERIES = tuple(f"protocol.{key}" for key in ("train", "validation", "query", "kind", "leave_one_out", "apart"))


@dataclass(frozen=True)
class Sweep:
    """What distinguishes a job from the others of its sweep.

    Attributes:
        values: the settings that differ between the jobs, by key, such as {"model/branch": "vgg11", "seed": 1}.
        words: the same settings as texts, for the names of folders.
        number: number of the job in the sweep; None outside sweeps.
    """

    values: Mapping[str, Any] = field(default_factory=dict)
    words: Mapping[str, str] = field(default_factory=dict)
    number: int | None = None

    def run(self, call: Callable[..., Any], *arguments: Any) -> Any:
        """Call a function, in which jobs are those of this sweep."""
        context = copy_context()
        context.run(_RUNNING.set, self)
        return context.run(call, *arguments)


_RUNNING: ContextVar[Sweep] = ContextVar("sweep", default=Sweep())  # noqa: B039 (it is frozen)
"""What distinguishes the running job, in the context of the job."""


def swept() -> Mapping[str, Any]:
    """Return the settings of the running job that differ between the jobs of its sweep; none outside sweeps."""
    return _RUNNING.get().values


def sweep_suffix(wanted: Choice | None = None) -> str:
    """Return a suffix that distinguishes a sweep's jobs, such as "model-branch-vgg11_seed-1"; empty outside sweeps.

    Args:
        wanted: which keys to name. If None, all, and a job that differs in none gets its number.
    """
    sweep = _RUNNING.get()
    chosen = [f"{key}-{word}" for key, word in sweep.words.items() if wanted is None or wanted(key)]
    text = "_".join(sorted(chosen))
    if wanted is None and not text and sweep.number is not None:
        text = str(sweep.number)
    name = re.sub(r"[^\w.+-]+", "-", text)
    if not (unusual := _UNUSUAL.search(text)):
        text = name
    if unusual or len(name.encode()) > _MOST_BYTES:
        start = name.encode()[:_MOST_BYTES].decode(errors="ignore")
        text = text.replace("'", "").replace('"', "")
        name = f"{start}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"
    return name


def own_folder(folder: Path, titles: Mapping[str, str], wanted: Choice) -> Path:
    """Return the folder of a job inside the folder that a sweep shares; outside sweeps, the shared folder itself.

    Keys that the shared folder is named by do not count: the run, and the choice of a descriptor or a build if its
    title is the chosen word.

    Args:
        folder: folder that the jobs share.
        titles: titles of the job's descriptor and build, by group.
        wanted: which swept keys change the contents of the folder.
    """
    words = _RUNNING.get().words
    named = {"run", *(group for group, title in titles.items() if words.get(group) == title)}
    suffix = sweep_suffix(lambda key: key not in named and wanted(key))
    return folder / suffix if suffix else folder


def of_map(key: str) -> bool:
    """Whether a map depends on a key of the command line."""
    key = key.replace("/", ".")
    return within(key, _OF_MAPS) and not key.startswith(_OF_QUERIES)


def of_layer(key: str) -> bool:
    """Whether a coarse layer depends on a key of the command line."""
    return of_map(key) or within(key, ("build", "seed"))


def with_swept(name: str) -> str:
    """Return the name of results with the swept settings, such as "hog descriptor.bins=8"."""
    further = [f"{key}={value}" for key, value in swept().items() if key not in ("run", "descriptor", "distance")]
    return " ".join([name, *further])
