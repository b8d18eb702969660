"""Compose a configuration from the words on the command line, with Hydra."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from siamloc.cli.help import COMMANDS
from siamloc.cli.schema import register
from siamloc.cli.sweeps import sweep_suffix
from siamloc.errors import ConfigError, SiamlocError, hint
from siamloc.jobs.options import choices, config_folder, groups
from siamloc.runs import runs_in
from siamloc.settings import shortened

Main = Callable[[DictConfig], None]
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


def run(command: str, main: Main, words: list[str]) -> int:
    """Compose the configuration of a command and run it; with -m once for each combination.

    Raises:
        ConfigError: an unknown key, group option or value, with the nearest valid one.
    """
    _check_words(words)
    given = words = [_network_of_a_run(word) for word in words]
    words = _sweep(command, words) if {"-m", "--multirun"} & set(words) else words
    words = _flags_first([*_HYDRA, *words])
    import hydra

    name = COMMANDS[command].begins_with
    register(name)
    failed: list[Exception] = []

    def job(config: DictConfig) -> None:
        sys.argv = arguments  # used by the trainer to start further processes
        try:
            _for_each_run(command, config, lambda one: main(finished(command, one, given)))
        except Exception as error:
            if sweep_suffix():
                raise
            failed.append(error)  # Hydra would print a line before passing it on

    before = {"HYDRA_FULL_ERROR": os.environ.get("HYDRA_FULL_ERROR", "0")}
    os.environ["HYDRA_FULL_ERROR"] = "1"  # pass errors through instead of printing them
    arguments = sys.argv
    sys.argv = [f"siamloc {command}", *words]
    try:
        hydra.main(version_base="1.3", config_path=str(folder_of(name)), config_name=name)(job)()
    except Exception as error:
        raise _explained(error, given, name) from error
    finally:
        sys.argv = arguments
        os.environ.update(before)
    if failed:
        raise _explained(failed[0], given, name)
    return 0


def composed(command: str, words: list[str]) -> DictConfig:
    """Return the configuration that a command would get from these words, without running it.

    Raises:
        ConfigError: as `run`.
    """
    name = COMMANDS[command].begins_with
    _check_words(words)
    words = [_network_of_a_run(word) for word in words]
    try:
        return finished(command, _hydra_compose(name, words), words)
    except Exception as error:
        raise _explained(error, words, name) from error


def finished(command: str, config: DictConfig, words: list[str]) -> DictConfig:
    """Return a configuration with the settings of its run, and with every value set.

    Raises:
        ConfigError: a key without a value.
    """
    keys = [_key(word) for word in words if not word.startswith("-")]
    chosen = [key for key in keys if key in groups()]
    for key in keys:
        if "." in key and key.replace(".", "/") in groups():
            raise ConfigError(f"{key} is chosen from files: write {key.replace('.', '/')}=NAME, with a slash")
    resumed = command in ("train", "pretrain") and config.get("resume") is True
    if (COMMANDS[command].inherits or resumed) and config.get("run") is not None:
        from siamloc.cli.inherit import with_settings_of_the_run

        config = with_settings_of_the_run(
            config,
            [key.replace("/", ".") for key in keys],
            [group.replace("/", ".") for group in chosen],
            resumed=resumed,
            replaces_map=command == "map",
            required=COMMANDS[command].reads_data and not resumed,
        )
    elif COMMANDS[command].inherits and COMMANDS[command].reads_data:
        from siamloc.cli.inherit import check_named

        check_named(config)
    if config.get("descriptor", {}).get("name") == "pretrained" and "data.image_size" not in keys:
        from siamloc.models.registry import PRETRAINED_SIZE

        config.data.image_size = list(PRETRAINED_SIZE)
    missing = sorted(OmegaConf.missing_keys(config))
    if not COMMANDS[command].reads_data:
        missing = [key for key in missing if not key.startswith("data.")]
    if missing:
        raise ConfigError(f"{missing[0]} is not set: give it as {missing[0]}=VALUE")
    from siamloc.cli.checking import check

    check(COMMANDS[command].begins_with, config)
    return config


def composed_defaults(name: str) -> DictConfig:
    """Return a configuration as its files define it, including values without a default."""
    return _hydra_compose(name, [])


def plain(config: DictConfig) -> dict[str, Any]:
    """Return a configuration as plain values, with references resolved."""
    return OmegaConf.to_container(config, resolve=True)  # type: ignore[return-value]


def _for_each_run(command: str, config: DictConfig, work: Main) -> None:
    """Do the work for each run of the given sweep, or once if there is none; a failing run does not stop the others.

    Raises:
        SiamlocError: what was wrong with the first run that failed.
    """
    found = runs_in(config.run) if command in OF_SWEEPS and str(config.run or "").strip() else []
    if not found:
        work(config)
    failed: dict[str, SiamlocError] = {}
    for number, run in enumerate(found, 1):
        print(f"run {number} of {len(found)}: {run.folder}", flush=True)
        one = config.copy()
        one.run = str(run.folder)
        try:
            work(one)
        except SiamlocError as error:
            failed[str(run.folder)] = error
            print(f"siamloc: {run.folder}: {error}", file=sys.stderr)
    if failed:
        folder, first = next(iter(failed.items()))
        raise ConfigError(f"{len(failed)} of {len(found)} runs failed, the first is {folder}: {first}") from first


def _hydra_compose(name: str, overrides: list[str]) -> DictConfig:
    """Compose a configuration, and restore the state of any running Hydra job afterwards."""
    from hydra import compose as hydra_compose
    from hydra import initialize_config_dir
    from hydra.core.global_hydra import GlobalHydra
    from hydra.core.singleton import Singleton

    register(name)
    state = Singleton.get_state()
    GlobalHydra.instance().clear()
    try:
        with initialize_config_dir(version_base="1.3", config_dir=str(folder_of(name))):
            return hydra_compose(name, overrides=overrides)
    finally:
        Singleton.set_state(state)


def folder_of(name: str) -> Path:
    """Return the folder of a command's configuration: its own if its keys have the names of groups."""
    folder = config_folder() / name
    return folder if folder.is_dir() else config_folder()


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
    said = [word.partition("=")[2].strip("'\"") for word in words if word.startswith("run=") and "run" in fixed]
    folder = said[0] if said and said[0] not in ("", "null") else "runs/sweep"
    settings = [
        f"hydra.sweep.dir={_quoted(folder if trains else f'{folder}/multirun/{command}')}",
        f"hydra.job.config.override_dirname.exclude_keys=[{','.join(map(_quoted, fixed))}]",
    ]
    named = any(word.startswith("run=") for word in words)
    return [*settings, *(["run=runs/sweep"] if trains and not named else []), *words]


def _check_words(words: list[str]) -> None:
    """Make sure that Hydra can read every word, and explain what is wrong with the first that it cannot."""
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import HydraException

    if "--resolve" in words and not {"-c", "--cfg"} & set(words):
        raise ConfigError("--resolve shows a configuration with its references resolved: add --cfg job")
    parser = OverridesParser.create()
    for before, word in zip(["", *words], words, strict=False):
        if word.startswith("-") or before.startswith("-"):
            continue
        if word.startswith("~"):
            raise ConfigError(f"{word} removes a key that is needed: leave it out, or set another value")
        if "=" not in word or word.startswith("="):
            shown = shortened(repr(word))
            raise ConfigError(f"{shown} is not of the form key=value, such as images=[photo.jpeg] or epochs=5")
        try:
            parser.parse_override(word)
        except (HydraException, ValueError) as error:
            key, shown = word.partition("=")[0], shortened(repr(word))
            raise ConfigError(
                f"the value of {shown} cannot be read: put texts with spaces, brackets or other symbols in quotes, "
                f"such as \"{key}='a (1)'\" or \"{key}=['a (1)','b']\""
            ) from error


def _network_of_a_run(word: str) -> str:
    """Read `descriptor=FOLDER` as the trained network of that run, and several folders as a sweep over networks."""
    key, _, value = word.partition("=")
    folders = [folder.strip("'\"") for folder in value.split(",")]
    if key != "descriptor" or not all((Path(folder) / "run.json").is_file() for folder in folders):
        return word
    return f"descriptor.run={','.join(map(_quoted, folders))}"


def _flags_first(words: list[str]) -> list[str]:
    """Move the overrides after the flags: Hydra's parser only takes them in one piece."""
    overrides = [word for word in words if word.startswith("~") or ("=" in word and not word.startswith("-"))]
    return [word for word in words if word not in overrides] + overrides


def _key(word: str) -> str:
    return word.partition("=")[0].lstrip("+~")


def _quoted(text: object) -> str:
    """Quote a text so that Hydra's grammar takes it as one value, whatever characters it holds."""
    return "'" + str(text).replace("\\", "\\\\").replace("'", "\\'") + "'"


def _explained(error: Exception, words: list[str], name: str) -> Exception:
    """Turn errors of Hydra and OmegaConf into one sentence with the nearest valid name; leave others alone."""
    from hydra.errors import HydraException
    from omegaconf.errors import OmegaConfBaseException

    if not isinstance(error, (HydraException, OmegaConfBaseException)):
        return error
    text = " ".join(str(error).split())
    if found := re.search(r"Could not override '([^']+)'", text):
        key = found[1].lstrip("+~").partition("@")[0]
        if inside := [group for group in groups() if group.startswith(f"{key}/")]:
            return ConfigError(f"{key} is a group of groups: choose {' or '.join(f'{one}=NAME' for one in inside)}")
        added = f"; add other arguments of Lightning's Trainer with a plus: +{key}=..."
        more = added if key.startswith("trainer.") else ""
        return ConfigError(f"unknown configuration key {key!r}: {_nearest_key(key, name, words)}{more}")
    if found := re.search(r"(?:Could not find|In '[^']*': Could not find) '([^']+)'", text):
        group, _, option = found[1].rpartition("/")
        return ConfigError(f"unknown option {group}={option}: {hint(option, choices(group))}")
    return ConfigError(f"{text} (given: {' '.join(words)})")


def _nearest_key(key: str, name: str, words: list[str]) -> str:
    from hydra.errors import HydraException

    chosen = [word for word in words if word.partition("=")[0] in groups() and "," not in word]
    try:
        config = _hydra_compose(name, chosen)
    except HydraException:  # a group has no such choice
        config = _hydra_compose(name, [])
    node, parents = config, []
    for part in key.split(".")[:-1]:
        if not isinstance(node, DictConfig) or not isinstance(node.get(part), DictConfig):
            break
        node = node[part]
        parents.append(part)
    if parents:
        return hint(key, [".".join([*parents, str(name)]) for name in node])
    if name != "config":
        return hint(key, map(str, config))
    return hint(key, sorted({*map(str, config), *groups()}))
