"""The jobs of a sweep: the swept settings, and the folder of each job."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from siamloc.errors import ConfigError

Choice = Callable[[str], bool]
_MOST_LETTERS = 150  # in a folder name; file systems allow 255 bytes
_OF_MAPS = ("data", "unwrap", "protocol", "experiment", "descriptor", "heading", "distance", "model", "checkpoint")
_OF_QUERIES = tuple(f"protocol.{key}" for key in ("train", "validation", "query", "kind", "leave_one_out", "apart"))


def swept() -> dict[str, Any]:
    """Return the settings of the running job that differ between the jobs of its sweep; none outside sweeps.

    The keys are those of the command line, such as "model/branch" and "seed", in the order given.
    """
    from hydra.core.override_parser.overrides_parser import OverridesParser

    parser = OverridesParser.create()
    return {key: parser.parse_override(word).value() for key, word in _words().items()}


def sweep_suffix(wanted: Choice | None = None) -> str:
    """Return a suffix that distinguishes a sweep's jobs, such as "model-branch-vgg11_seed-1"; empty outside sweeps.

    Args:
        wanted: which keys count. If None, all do, and a job in which nothing is swept gets its number.
    """
    chosen = [word for key, word in _words().items() if wanted is None or wanted(key)]
    text = "_".join(sorted("-".join(word.split("=", 1)) for word in chosen))
    if wanted is None and not text and _job() is not None:
        text = str(_job())
    text = re.sub(r"[^\w.+-]+", "-", text)
    if len(text) > _MOST_LETTERS:
        text = f"{text[:_MOST_LETTERS]}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"
    return text


def own_folder(folder: Path, config: DictConfig, wanted: Choice) -> Path:
    """Return the folder of a job inside the folder that a sweep shares; outside sweeps, the shared folder itself.

    Keys that already name the shared folder do not count: the run, and the choice of a descriptor or a build.

    Args:
        folder: shared by the jobs.
        config: of the job.
        wanted: which swept keys change the contents of the folder.
    """
    named = {"run", *(group for group in ("descriptor", "build") if _is_named(config, group))}
    suffix = sweep_suffix(lambda key: key not in named and wanted(key))
    return folder / suffix if suffix else folder


def of_map(key: str) -> bool:
    """Whether a map depends on a key of the command line."""
    key = key.replace("/", ".")
    return _begins(key, _OF_MAPS) and not key.startswith(_OF_QUERIES)


def of_layer(key: str) -> bool:
    """Whether a coarse layer depends on a key of the command line."""
    return of_map(key) or _begins(key, ("build", "seed"))


def of_results(key: str) -> bool:
    """Whether results depend on a key that is not yet part of their name (the distance already is)."""
    return key != "distance"


def with_swept(name: str) -> str:
    """Return the name of results with the swept settings, such as "hog descriptor.bins=8"."""
    further = [f"{key}={value}" for key, value in swept().items() if key not in ("run", "descriptor", "distance")]
    return " ".join([name, *further])


def evaluates(folders: str | Sequence[str], by: str | None) -> bool:
    """Whether to compare the evaluations in folders instead of the trainings.

    Figures of trainings have a slash in their names, such as "val/error". If no figure is requested, several trainings
    are compared rather than their evaluations.

    Raises:
        ConfigError: missing folders, or folders with neither.
    """
    from siamloc.comparison import files_named

    runs, results = (files_named(folders, name) for name in ("run.json", "results.json"))
    if not runs and not results:
        where = folders if isinstance(folders, str) else ", ".join(folders)
        raise ConfigError(f"{where} holds neither runs nor evaluations: name the folder of a sweep, such as runs/sweep")
    if not results:
        return False
    return "/" not in by if by is not None else len(runs) < 2


def _is_named(config: DictConfig, group: str) -> bool:
    """Whether the label of a group shows its choice; a label that was set hides the choice."""
    options: Mapping[str, Any] = OmegaConf.select(config, group) or {}
    word = _words().get(group, "").partition("=")[2]
    return word == str(options.get("label") or options.get("name"))


def _begins(key: str, sections: tuple[str, ...]) -> bool:
    return any(key == section or key.startswith(f"{section}.") for section in sections)


def _job() -> int | None:
    """Return the number of the running job of a sweep; None outside sweeps."""
    from hydra.core.hydra_config import HydraConfig
    from hydra.types import RunMode

    if not HydraConfig.initialized() or HydraConfig.get().mode != RunMode.MULTIRUN:
        return None
    return int(HydraConfig.get().job.num)


def _words() -> dict[str, str]:
    """Return the words of the running job that differ between the jobs of its sweep, by key."""
    from hydra.core.hydra_config import HydraConfig

    if _job() is None:
        return {}
    fixed = set(HydraConfig.get().job.config.override_dirname.exclude_keys)
    words = {word.partition("=")[0].lstrip("+~"): word.lstrip("+~") for word in HydraConfig.get().overrides.task}
    return {key: word for key, word in words.items() if key not in fixed}
