"""Compose the settings of a job from the words on the command line, with Hydra, and run it."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from logging import LogRecord
from typing import Any, NoReturn

from omegaconf import DictConfig, OmegaConf

from foundation.extras import installing
from foundation.files import expanded
from foundation.settings import checked, merged
from foundation.words import quoted, unquoted
from siamloc.cli.help import job_of
from siamloc.cli.overrides import flags_first, folder_of_options, key_of, meant, only_of_others, together
from siamloc.cli.words import values_of
from siamloc.errors import ConfigError, DataError, SiamlocError, check_known, hint, logger
from siamloc.jobs.job import Given, Job, at, import_own
from siamloc.jobs.options import choices, config_folder, groups, is_fused, option, options
from siamloc.jobs.sweep import Sweep
from siamloc.models.registry import is_backbone
from siamloc.runs import Run, runs_in

OF_SWEEPS = ("map", "evaluate")
"""Commands that do their work for each run if the folder of a sweep is given."""
# Keep Hydra from changing the folder and from writing files or log lines.
_HYDRA = (
    "hydra/job_logging=none",
    "hydra/hydra_logging=none",
    "hydra.run.dir=.",
    "hydra.sweep.subdir=.",
    "hydra.output_subdir=null",
    "hydra.job.chdir=false",
)
_OF_A_READER = re.compile(r"(?<![\w./])(root|places|form|order|axes|offset|times|clock|on_error)=(?=[A-Za-z])")
"""Arguments that the messages of readers name, and which are keys of a group here."""
_BRANCH = ("model/branch", "model.branch.name")
"""Keys that name a branch."""
_NAME = "siamloc"
"""Name of the configuration of a command, which `_register` composes."""
_print = partial(print, flush=True)


def run(command: str, words: list[str]) -> None:
    """Run the job of a command with the settings of these words; with -m once for each combination.

    Raises:
        ConfigError: an unknown key, group option or value, with the nearest valid one.
    """
    kind = job_of(command)
    given = words = meant(words, kind)
    words = _sweep(command, words) if {"-m", "--multirun"} & set(words) else words
    words = flags_first([*_HYDRA, *words])
    import hydra

    _register(kind, words)
    failed, not_run = list[tuple[Exception, Sweep]](), 0
    process = os.getpid()

    def names_keys(record: LogRecord) -> bool:
        record.msg, record.args = _with_keys(record.getMessage(), given, kind), ()
        return True

    def job(config: DictConfig) -> None:
        nonlocal not_run
        if failed:  # an earlier job of the sweep
            not_run += 1
            return
        sys.argv = arguments  # used by the trainer to start further processes
        sweep = _sweep_of_the_job()
        try:
            sweep.run(_for_each_run, command, config, given, lambda one, words: _made(kind, one, words).run(_print))
        except Exception as error:
            if os.getpid() != process:  # of a launcher, whose list is a copy
                raise
            failed.append((error, sweep))  # Hydra would print a line before passing it on

    before = {"HYDRA_FULL_ERROR": os.environ.get("HYDRA_FULL_ERROR", "0")}
    os.environ["HYDRA_FULL_ERROR"] = "1"  # pass errors through instead of printing them
    arguments = sys.argv
    sys.argv = [f"siamloc {command}", *words]
    logger.addFilter(names_keys)
    try:
        hydra.main(version_base="1.3", config_path=_path(kind), config_name=_NAME)(job)()
    except Exception as error:
        _raise_explained(error, given, kind)
    finally:
        logger.removeFilter(names_keys)
        sys.argv = arguments
        os.environ.update(before)
    if failed:
        first, sweep = failed[0]
        try:
            _raise_explained(first, given, kind)
        except SiamlocError as problem:
            if not sweep.words:
                raise
            where = " ".join(f"{key}={word}" for key, word in sweep.words.items())
            raise SiamlocError(f"{problem} (at {where}, which ended the sweep; jobs not run: {not_run})") from problem


def composed(command: str, words: list[str]) -> Job:
    """Return the job that a command would run with these words, such as "data=cold".

    Raises:
        ConfigError: as `run`.
    """
    kind = job_of(command)
    if not kind.BY_HYDRA:
        return kind.of(values_of(words, kind))
    words = meant(words, kind)
    try:
        return _made(kind, compose_values(kind, words), words)
    except Exception as error:
        _raise_explained(error, words, kind)


def compose_values(kind: type[Job], words: list[str]) -> DictConfig:
    """Return the settings of a job composed by Hydra; the state of a running Hydra job is restored afterwards."""
    from hydra import compose as hydra_compose

    with _initialized(kind, words):
        return hydra_compose(_NAME, overrides=words)


def completed(kind: type[Job], line: str) -> list[str]:
    """Return the possible next words of a command line, for the tab key."""
    from hydra.core.global_hydra import GlobalHydra
    from hydra.plugins.completion_plugin import DefaultCompletionPlugin

    with _initialized(kind, []):
        found = DefaultCompletionPlugin(GlobalHydra.instance().config_loader())._query(_NAME, line)
    return [word for word in found if not only_of_others(key_of(word), kind)]


@contextmanager
def _initialized(kind: type[Job], words: list[str]) -> Iterator[None]:
    """Let Hydra know the configuration of a job, and restore the state of any running Hydra job afterwards."""
    from hydra import initialize, initialize_config_dir
    from hydra.core.global_hydra import GlobalHydra
    from hydra.core.singleton import Singleton

    state = Singleton.get_state()
    GlobalHydra.instance().clear()
    _register(kind, words)
    folder = _path(kind)
    try:
        with initialize_config_dir(folder, version_base="1.3") if folder else initialize(None, version_base="1.3"):
            yield
    finally:
        Singleton.set_state(state)


def _made(kind: type[Job], config: DictConfig, words: list[str]) -> Job:
    """Make a job from its composed values.

    Raises:
        ConfigError: an unknown key, a key without a value, or a value of the wrong type or out of range.
    """
    keys = [key_of(word) for word in words if not word.startswith("-")]
    known = groups() if kind.GROUPS else []
    chosen = [key for key in keys if key in known]
    values: Any = OmegaConf.to_container(config, resolve=True)
    check_known(values, {key for one in together(kind) for key in one.key_names()}, "")
    own = {key: value for key, value in values.items() if key in kind.key_names()}
    for group in kind.GROUPS:
        if isinstance(own.get(group), str):  # no name of an option: Hydra has taken those
            raise ConfigError(f"{group} is a group of keys: set them one by one, such as {group}.KEY=VALUE")
    dotted = [[key.replace("/", ".") for key in some] for some in (keys, chosen)]
    return kind.of(own, Given(*dotted))


def _register(kind: type[Job], words: list[str]) -> None:
    """Give Hydra the configuration of a job: its defaults, and the options of its groups from the registries.

    Fused descriptors, and networks that siamloc does not define, such as timm/resnet18, become options if words name
    them.
    """
    from hydra.core.config_store import ConfigStore

    store = ConfigStore.instance()
    jobs = together(kind)
    chosen = {group: name for one in jobs for group, name in one.GROUPS.items()}
    # Nothing of another job, whose keys may have the names of groups.
    store.repo = {key: node for key, node in store.repo.items() if key == "hydra" or key.startswith("_")}
    values: dict[str, Any] = {}
    for one in jobs:
        values = merged(values, one.defaults())
    last = [{"experiment": None}] if kind.SHARED else []
    defaults = [*({group: name} for group, name in chosen.items()), "_self_", *last]
    store.store(_NAME, OmegaConf.create({"defaults": defaults, **values}))
    for group, inside in options().items() if chosen else ():
        for name, entry in inside.items():
            store.store(name, entry.node(), group=group, package="_global_" if group == "experiment" else None)
    for group, is_made in (("descriptor", is_fused), ("model/branch", is_backbone)):
        chosen_names = (name for word in words if key_of(word) == group for name in word.partition("=")[2].split(","))
        for name in (name.strip("'\" ") for name in chosen_names):
            if is_made(name):
                folder, _, leaf = f"{group}/{name}".rpartition("/")
                node = OmegaConf.create(option(group, name).node())
                store.store(leaf, node, group=folder, package=group.replace("/", "."))


def _path(kind: type[Job]) -> str | None:
    """Return the folder of options as files; None for a job without groups, whose keys may have names of groups."""
    return str(config_folder()) if kind.GROUPS else None


def _sweep_of_the_job() -> Sweep:
    """Return what distinguishes the running job from the others of its sweep."""
    from hydra.core.hydra_config import HydraConfig
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.types import RunMode

    hydra = HydraConfig.get()
    if hydra.mode != RunMode.MULTIRUN:
        return Sweep()
    fixed = set(hydra.job.config.override_dirname.exclude_keys)
    words = {key: word.lstrip("+~") for word in hydra.overrides.task if (key := key_of(word)) not in fixed}
    parser = OverridesParser.create()
    values = {key: parser.parse_override(word).value() for key, word in words.items()}
    return Sweep(values, {key: word.partition("=")[2] for key, word in words.items()}, int(hydra.job.num))


def _for_each_run(
    command: str, config: DictConfig, given: list[str], work: Callable[[DictConfig, list[str]], object]
) -> None:
    """Do the work for each run of the given sweep, or once if there is none; a failing run does not stop the others.

    A branch of one's own is imported for all runs of a sweep, of which each keeps its own branch.

    Raises:
        SiamlocError: what was wrong with the first run that failed; or no run has the branch.
    """
    swept = command in OF_SWEEPS and str(config.run or "").strip()
    found = runs_in(checked(config.run, str, "run")) if swept else []
    if not found:
        work(config, given)
    words = given
    own = str(OmegaConf.select(config, "model.branch.name", default=""))
    if found and ":" in own and (named := [word for word in given if key_of(word) in _BRANCH]):
        if own not in map(_branch_of, found):
            raise ConfigError(f"{named[0]}: no run in {config.run} has this branch: leave it out, each keeps its own")
        import_own(key_of(named[0]), own)
        words = [word for word in given if word not in named]
    failed: dict[str, Exception] = {}
    for number, run in enumerate(found, 1):
        print(f"run {number} of {len(found)}: {run.folder}", flush=True)
        one = config.copy()
        one.run = str(run.folder)
        try:
            work(one, words)
        except SiamlocError as error:
            failed[str(run.folder)] = problem = _explained(error, words, job_of(command))
            print(f"siamloc: {run.folder}: {problem}", file=sys.stderr)
    if failed:
        folder, first = next(iter(failed.items()))
        raise ConfigError(f"{len(failed)} of {len(found)} runs failed, the first is {folder}: {first}") from first


def _branch_of(run: Run) -> object:
    try:
        return at(run.settings, "model.branch")
    except SiamlocError:  # for which the work for the run fails
        return None


def _sweep(command: str, words: list[str]) -> list[str]:
    """Add the folder of a sweep and the words that all its jobs share; trainings go to runs/sweep by default.

    Hydra stores the words of a sweep in its folder. Those of the trainings stay when their runs are evaluated.
    """
    from hydra.core.override_parser.overrides_parser import OverridesParser

    given = [word for word in words if not word.startswith("-") and "=" in word]
    overrides = [OverridesParser.create().parse_override(word) for word in given]
    swept = {override.key_or_group for override in overrides if override.is_sweep_override()}
    fixed = [override.key_or_group for override in overrides if override.key_or_group not in swept]
    trains = command in ("train", "pretrain")
    said = [unquoted(word.partition("=")[2]) for word in words if word.startswith("run=") and "run" in fixed]
    folder = str(expanded(said[0])) if said and said[0] not in ("", "null") else "runs/sweep"
    settings = [
        f"hydra.sweep.dir={quoted(folder if trains else f'{folder}/multirun/{command}')}",
        f"hydra.job.config.override_dirname.exclude_keys=[{','.join(map(quoted, fixed))}]",
    ]
    named = any(word.startswith("run=") for word in words)
    return [*settings, *(["run=runs/sweep"] if trains and not named else []), *words]


def _raise_explained(error: Exception, words: list[str], kind: type[Job]) -> NoReturn:
    problem = _explained(error, words, kind)
    if problem is error:  # which keeps its own cause
        raise error
    raise problem from error


def _with_keys(text: str, words: list[str], kind: type[Job]) -> str:
    """Return a message with the keys of the command for the arguments of readers."""
    of_data, recorded = "data" in kind.GROUPS, "recording" in getattr(kind, "__dataclass_fields__", {})
    if not (of_data or recorded):
        return text
    recorded = recorded and (not of_data or any(word.startswith("recording.") for word in words))
    return _OF_A_READER.sub(rf"{'recording' if recorded else 'data'}.\1=", text)


def _explained(error: Exception, words: list[str], kind: type[Job]) -> Exception:
    """Turn errors of Hydra and OmegaConf into one sentence with the nearest valid name; leave others alone."""
    from hydra.errors import HydraException
    from omegaconf.errors import OmegaConfBaseException

    for group, _, name in (word.partition("=") for word in words):
        if group in groups() and name in choices(group):
            try:
                option(group, name)
            except ConfigError as wrong:
                return wrong
    if isinstance(error, DataError):
        error.args = tuple(_with_keys(part, words, kind) if isinstance(part, str) else part for part in error.args)
        return error
    text = " ".join(str(error).split())
    index = re.search(r"invalid literal for int\(\) .*'(\w+)'", text) if type(error) is ValueError else None
    if index and (keys := [key for key in map(key_of, words) if f".{index[1]}" in key]):  # a key inside a list
        return ConfigError(f"unknown configuration key {keys[0]!r}: {_nearest_key(keys[0], kind, words)}")
    if not isinstance(error, (HydraException, OmegaConfBaseException)):
        return error
    if found := re.match(r"Error merging override ([^=]+)=", text):
        return ConfigError(f"{found[1]} is a group of keys: set them one by one, such as {found[1]}.KEY=VALUE")
    if found := re.search(r"Could not override '([^']+)'", text):
        key = found[1].lstrip("+~").partition("@")[0]
        if inside := [group for group in kind.GROUPS if group.startswith(f"{key}/")]:
            return ConfigError(f"{key} is a group of groups: choose {' or '.join(f'{one}=NAME' for one in inside)}")
        if (folder := folder_of_options(words)) is not None and (folder / key).is_dir() and key in kind.key_names():
            return ConfigError(f"{key} is no group of options: rename the folder {folder / key}")
        added = "other arguments of Lightning's Trainer" if key.startswith("trainer.") else ""
        if key.startswith("unwrap.") and "unwrap=own" in words:
            added = "parameters of a camera of your own"
        more = f"; add {added} with a plus: +{key}=..." if added else ""
        return ConfigError(f"unknown configuration key {key!r}: {_nearest_key(key, kind, words)}{more}")
    if found := re.search(r"(?:Could not find|In '[^']*': Could not find) '([^']+)'", text):
        group, _, name = found[1].rpartition("/")
        if group == "hydra/launcher":
            return ConfigError(f"no launcher {name} is installed here: for joblib, {installing('sweeps')}")
        group = next((one for one in groups() if found[1].startswith(f"{one}/")), group)
        name = found[1].removeprefix(f"{group}/")
        if name.endswith((".yaml", ".yml")):
            return ConfigError(
                f"{group}={name} names a file: FOLDER/{group}/NAME.yaml is {group}=NAME with --config-dir FOLDER"
            )
        folder = folder_of_options(words)
        own = [] if folder is None else [path.stem for path in (folder / group).glob("*.yaml")]
        return ConfigError(f"unknown option {group}={name}: {hint(name, sorted({*choices(group), *own}))}")
    return ConfigError(f"{text} (given: {' '.join(words)})")


def _nearest_key(key: str, kind: type[Job], words: list[str]) -> str:
    from hydra.errors import HydraException

    choices = {*kind.GROUPS, "experiment"}
    chosen = [word for word in words if word.partition("=")[0] in choices and "," not in word]
    try:
        config = compose_values(kind, chosen)
    except HydraException:  # a group has no such choice
        config = compose_values(kind, [])
    parents = key.split(".")[:-1]
    while parents:
        if isinstance(node := OmegaConf.select(config, ".".join(parents)), DictConfig):
            return hint(key, [".".join([*parents, str(name)]) for name in node])
        parents.pop()
    shared = ("experiment",) if kind.SHARED else ()
    return hint(key, sorted({*kind.key_names(), *kind.GROUPS, *shared}))
