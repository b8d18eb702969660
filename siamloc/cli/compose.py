"""From the words on the command line to a configuration, by Hydra."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable
from contextvars import ContextVar
from dataclasses import asdict
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from siamloc.cli.checks import check
from siamloc.cli.help import COMMANDS
from siamloc.errors import ConfigError, hint
from siamloc.files import plain as as_plain
from siamloc.runs import Run, newest_run

Main = Callable[[DictConfig], None]
# Hydra neither changes folder nor writes files or log lines of its own; a sweep names its jobs by what is swept.
_HYDRA = (
    "hydra/job_logging=none",
    "hydra/hydra_logging=none",
    "hydra.run.dir=.",
    "hydra.sweep.subdir=.",
    "hydra.output_subdir=null",
    "hydra.job.chdir=false",
    "hydra.job.config.override_dirname.kv_sep=-",
    "hydra.job.config.override_dirname.item_sep=_",
)
_given: ContextVar[list[str] | None] = ContextVar("overrides of a command that another command runs", default=None)
_PATH_KEYS = ("data.manifest", "data.root", "data.cache", "model.branch.weights")


def config_folder() -> Path:
    """Return the folder of the configuration files: inside the installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parents[1]
    for folder in (package / "conf", package.parent / "conf"):
        if (folder / "config.yaml").is_file():
            return folder
    raise ConfigError(f"the configuration files are missing from {package}: install siamloc anew")


def run(command: str, main: Main, words: list[str]) -> int:
    """Compose the configuration of a command and run it; with -m once for each combination.

    A command that works on a finished run begins with the overrides the run was trained with, so that only what
    differs has to be said again.

    Raises:
        ConfigError: an unknown key, group option or value, with the nearest valid one.
    """
    given = words
    _check_words(words)
    words = [_network_of_a_run(word) for word in words]
    if COMMANDS[command].inherits or (command == "train" and _value_of("resume", words) == "true"):
        words = _inherited(command, words)
    if {"-m", "--multirun"} & set(words):
        words = _sweep(words)
    words = _flags_first([*_HYDRA, *words])
    import hydra

    name = COMMANDS[command].config
    _register_defaults(name)

    failed: list[Exception] = []

    def job(config: DictConfig) -> None:
        sys.argv = arguments  # what the trainer starts further processes with
        try:
            check(config)
            main(config)
        except Exception as error:
            if sweep_suffix():
                raise
            failed.append(error)  # Hydra would print a line of its own before passing it on

    before = {"HYDRA_FULL_ERROR": os.environ.get("HYDRA_FULL_ERROR", "0")}
    os.environ["HYDRA_FULL_ERROR"] = "1"  # lets errors through to us instead of printing them
    arguments = sys.argv
    sys.argv = [f"siamloc {command}", *words]
    try:
        hydra.main(version_base="1.3", config_path=str(_folder_of(name)), config_name=name)(job)()
    except Exception as error:
        raise _explained(error, given, name) from error
    finally:
        sys.argv = arguments
        os.environ.update(before)
    if failed:
        raise _explained(failed[0], given, name)
    return 0


def run_composed(command: str, main: Main, words: list[str]) -> None:
    """Run a command inside another one, as `run` would, without Hydra's launcher."""
    if COMMANDS[command].inherits:
        words = _inherited(command, words)
    config = compose(words, COMMANDS[command].config)
    check(config)
    token = _given.set(words)
    try:
        main(config)
    finally:
        _given.reset(token)


def compose(overrides: list[str], name: str = "config") -> DictConfig:
    """Return the configuration that these overrides make, without running anything.

    Raises:
        ConfigError: as `run`.
    """
    try:
        return _hydra_compose(name, overrides)
    except Exception as error:
        raise _explained(error, overrides, name) from error


def plain(config: DictConfig) -> dict[str, Any]:
    """Return a configuration as plain values, references resolved."""
    return OmegaConf.to_container(config, resolve=True)  # type: ignore[return-value]


def task_overrides() -> list[str]:
    """Return the overrides of the job that is running, with the paths made absolute."""
    from hydra.core.hydra_config import HydraConfig

    overrides = _given.get()
    if overrides is None:
        overrides = list(HydraConfig.get().overrides.task) if HydraConfig.initialized() else []
    passing = ("run=", "resume=", "overwrite=", "bundle=", "images=", "descriptor")
    return [_absolute(word) for word in overrides if not word.startswith(passing)]


def _hydra_compose(name: str, overrides: list[str]) -> DictConfig:
    """Compose beside a Hydra job that may be running, whose state is put back afterwards."""
    from hydra import compose as hydra_compose
    from hydra import initialize_config_dir
    from hydra.core.global_hydra import GlobalHydra
    from hydra.core.singleton import Singleton

    _register_defaults(name)
    state = Singleton.get_state()
    GlobalHydra.instance().clear()
    try:
        with initialize_config_dir(version_base="1.3", config_dir=str(_folder_of(name))):
            return hydra_compose(name, overrides=overrides)
    finally:
        Singleton.set_state(state)


def _folder_of(name: str) -> Path:
    """Return where a command's configuration lies: in a folder of its own if its keys are named as groups are."""
    folder = config_folder() / name
    return folder if folder.is_dir() else config_folder()


def _register_defaults(name: str) -> None:
    """Make the dataclasses that hold a command's defaults known to Hydra, so that a value stands in one place."""
    from hydra.core.config_store import ConfigStore

    store = ConfigStore.instance()
    if name == "simulate":
        from siamloc.simulate import SimulateConfig

        store.store("simulate_defaults", OmegaConf.create(as_plain(asdict(SimulateConfig()))))
    if name == "config":
        from analytic.descriptors.registry import DESCRIPTORS, parameters
        from analytic.mapper import Parameters

        for descriptor in DESCRIPTORS:
            # Whether columns wrap around follows from the data, and where to compute from `device`.
            fields = {k: v for k, v in parameters(descriptor).items() if k not in ("circular", "device")}
            store.store(descriptor, OmegaConf.create(fields), group="parameters/descriptor")
        store.store("mapper", OmegaConf.create(asdict(Parameters())), group="parameters")


def sweep_suffix() -> str:
    """Return what tells the jobs of a sweep apart, such as "model-branch-vgg11_seed-1"; empty outside sweeps."""
    from hydra.core.hydra_config import HydraConfig
    from hydra.types import RunMode

    if not HydraConfig.initialized() or HydraConfig.get().mode != RunMode.MULTIRUN:
        return ""
    swept = HydraConfig.get().job.override_dirname or str(HydraConfig.get().job.num)
    return re.sub(r"[^\w.+-]+", "-", swept)


def _sweep(words: list[str]) -> list[str]:
    """Let the folders of a sweep's jobs lie in the run's folder, named by what is swept alone."""
    from hydra.core.override_parser.overrides_parser import OverridesParser

    folder = _value_of("run", words) or "runs/sweep"
    fixed = []
    for word in words:
        if not word.startswith("-") and "=" in word:
            override = OverridesParser.create().parse_override(word)
            if not override.is_sweep_override():
                fixed.append(override.key_or_group)
    settings = [
        f"hydra.sweep.dir={_quoted(folder)}",
        f"hydra.job.config.override_dirname.exclude_keys=[{','.join(map(_quoted, fixed))}]",
    ]
    if _value_of("run", words) is None:
        settings.append(f"run={_quoted(folder)}")
    return [*settings, *words]


def _inherited(command: str, words: list[str]) -> list[str]:
    """Put the overrides of the run that is named, or of the newest one, before those that were given."""
    folder = _value_of("run", words)
    if folder is None and _value_of("bundle", words) is not None:
        return words
    network = _value_of("descriptor.run", words)
    if folder is not None:
        found = Run(Path(folder))
        if command == "train" and not found.record.is_file():
            return words
        if network is not None and not found.record.is_file():
            found = Run(Path(network))
    elif network is not None:
        found = Run(Path(network))
        words = [f"run={_quoted(network)}", *words]
    else:
        try:
            found = newest_run()
        except ConfigError:
            if _needs_network(words):
                raise
            return words
        print(f"using the newest run, {found.folder}")
        words = [f"run={_quoted(found.folder)}", *words]
    if not found.record.is_file() and not _needs_network(words):
        return words
    record = found.load_record()
    kept = list(record["overrides"])
    if command in ("evaluate", "export", "localize"):
        kept += _of_map(found)
    given = set(map(_key, words))
    return [*(word for word in kept if _key(word) not in given and _has_place(_key(word), words)), *words]


def _has_place(key: str, words: list[str]) -> bool:
    """Say whether a key still exists when groups are chosen anew: with data=cold there is no data.manifest."""
    group, _, name = key.rpartition(".")
    option = _value_of(group.replace(".", "/"), words) if group else None
    path = config_folder() / group.replace(".", "/") / f"{option}.yaml"
    return option is None or not path.is_file() or name in OmegaConf.load(path)


def _of_map(run: Run) -> list[str]:
    """Return the overrides that chose the frames of the run's map."""
    if not run.map.is_file():
        return []
    from siamloc.maps import VisualMap

    return list(VisualMap.load(run.map).made.get("overrides", []))


def _check_words(words: list[str]) -> None:
    """Make sure that every word is one that Hydra can read, and say what is wrong with the first that is not."""
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import HydraException

    parser = OverridesParser.create()
    for before, word in zip(["", *words], words, strict=False):
        if word.startswith("-") or before.startswith("-"):
            continue
        if "=" not in word and not word.startswith("~"):
            raise ConfigError(f"{word!r} is not of the form key=value, such as images=[photo.jpeg] or epochs=5")
        try:
            parser.parse_override(word)
        except HydraException as error:
            key = word.partition("=")[0]
            raise ConfigError(
                f"the value of {word!r} cannot be read: put texts with blanks, brackets or other signs in quotes, "
                f"such as \"{key}='a (1)'\" or \"{key}=['a (1)','b']\""
            ) from error


def _needs_network(words: list[str]) -> bool:
    return (_value_of("descriptor", words) or "network") in ("network", "untrained")


def _flags_first(words: list[str]) -> list[str]:
    """Gather the overrides behind the flags: Hydra's parser takes them in one piece only."""
    overrides = [word for word in words if word.startswith("~") or ("=" in word and not word.startswith("-"))]
    return [word for word in words if word not in overrides] + overrides


def _key(word: str) -> str:
    return word.partition("=")[0].lstrip("+~")


def _value_of(key: str, words: list[str]) -> str | None:
    values = [word.partition("=")[2] for word in words if word.startswith(f"{key}=")]
    return values[-1].strip("'\"") if values else None


def _quoted(text: object) -> str:
    """Return a text as a value that Hydra's grammar takes whole, whatever signs it holds."""
    return "'" + str(text).replace("\\", "\\\\").replace("'", "\\'") + "'"


def _network_of_a_run(word: str) -> str:
    """Read `descriptor=FOLDER` as the trained network of that run."""
    key, _, value = word.partition("=")
    if key == "descriptor" and (Path(value) / "run.json").is_file():
        return f"descriptor.run={value}"
    return word


def _absolute(word: str) -> str:
    key, _, value = word.partition("=")
    value = value.strip("'\"")
    if key.lstrip("+") in _PATH_KEYS and value and Path(value).exists():
        return f"{key}={_quoted(Path(value).resolve())}"
    return word


def _explained(error: Exception, words: list[str], name: str) -> Exception:
    """Turn Hydra's and OmegaConf's errors into one sentence with the nearest valid name; leave others alone."""
    from hydra.errors import HydraException
    from omegaconf.errors import OmegaConfBaseException

    if not isinstance(error, (HydraException, OmegaConfBaseException)):
        return error
    text = " ".join(str(error).split())
    if found := re.search(r"Could not override '([^']+)'", text):
        key = found[1].lstrip("+~").partition("@")[0]
        return ConfigError(f"unknown configuration key {key!r}: {_nearest_key(key, name, words)}")
    if found := re.search(r"(?:Could not find|In '[^']*': Could not find) '([^']+)'", text):
        group, _, option = found[1].rpartition("/")
        folder = config_folder() / group
        options = sorted(path.stem for path in folder.glob("*.yaml")) if folder.is_dir() else []
        return ConfigError(f"unknown option {group}={option}: {hint(option, options)}")
    return ConfigError(f"{text} (given: {' '.join(words)})")


def _nearest_key(key: str, name: str, words: list[str]) -> str:
    groups = [word for word in words if (config_folder() / word.partition("=")[0]).is_dir() and "," not in word]
    config = _hydra_compose(name, groups)
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
    folders = [path.relative_to(config_folder()).as_posix() for path in config_folder().rglob("*") if path.is_dir()]
    return hint(key, sorted({*map(str, config), *folders}))
