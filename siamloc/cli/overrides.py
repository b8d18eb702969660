"""The words of a command line as Hydra is to read them: checked, in quotes where needed, and with what they mean."""

from __future__ import annotations

import re
from pathlib import Path

from analytic.descriptors.fused import SIGN, distinct
from foundation.settings import shortened
from foundation.words import quoted, unquoted
from siamloc.cli.help import job_of
from siamloc.errors import ConfigError
from siamloc.jobs.job import Job
from siamloc.jobs.options import choices, option
from siamloc.runs import Run, runs_in

_SHARING = ("prepare", "train", "map", "evaluate", "export")
"""Commands that experiments set keys for."""
_OUTPUT = ("out", "bundle", "run", "recording.out")
"""Keys that name the folder a command writes to, in the order in which they are looked for."""


def meant(words: list[str], kind: type[Job]) -> list[str]:
    """Return the words as Hydra is to read them, after checking them."""
    words = list(map(_with_quotes, words))
    _check_words(words)
    _check_own(words, kind)
    stored = _of_stored_data() if _takes_data_of_a_run(words, kind) else ()
    return [f"++{_whole(word)}" if word.startswith(stored) else _as_meant(word, kind) for word in words]


def folder_of_options(words: list[str]) -> Path | None:
    """Return the folder of options of the user's own, which --config-dir names."""
    from hydra._internal.utils import get_args_parser

    folder = get_args_parser().parse_known_args(words)[0].config_dir
    return None if folder is None else Path(folder)


def together(kind: type[Job]) -> list[type[Job]]:
    """Return the jobs that an experiment sets keys for, if this job is one of them; otherwise only this job."""
    return [job_of(name) for name in _SHARING] if kind.SHARED else [kind]


def only_of_others(key: str, kind: type[Job]) -> list[str]:
    """Return the commands that have a key which this job lacks, although it shares experiments with them."""
    top = re.split("[./]", key)[0]
    if not kind.SHARED or top in kind.key_names():
        return []
    return [name for name in _SHARING if top in job_of(name).key_names()]


def _check_words(words: list[str]) -> None:
    """Make sure that Hydra can read every word, and explain what is wrong with the first that it cannot."""
    from argparse import ArgumentError

    from hydra._internal.utils import get_args_parser
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import HydraException

    options = get_args_parser()
    options.exit_on_error = False
    try:
        known, rest = options.parse_known_args(words)  # whose overrides may hold -5, and what follows --
    except ArgumentError as error:
        raise ConfigError(f"{error}: --help lists what can be given") from error
    if known.multirun and known.cfg:
        raise ConfigError("--cfg shows the configuration of one job: leave out -m, and give each key one value")
    unread = ["--", *rest, *known.overrides]
    if unknown := [word for word in words if word.startswith("-") and word in unread]:
        raise ConfigError(f"there is no option {unknown[0]}: give settings as key=value, which --help lists")
    if "--resolve" in words and not {"-c", "--cfg"} & set(words):
        raise ConfigError("--resolve shows a configuration with its references resolved: add --cfg job")
    parser = OverridesParser.create()
    for word in [*known.overrides, *rest]:
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
                f"the value of {shown} cannot be read: put texts with spaces, brackets, letters such as ö or other "
                f"symbols in quotes, such as \"{key}='a (1)'\" or \"{key}=['a (1)','b']\""
            ) from error


def _check_own(words: list[str], kind: type[Job]) -> None:
    """Refuse typed keys that only other commands have; an experiment may set such keys.

    Raises:
        ConfigError: there is such a key.
    """
    for key in (key_of(word) for word in words if "=" in word and not word.startswith("-")):
        if others := only_of_others(key, kind):
            command = next(name for name in _SHARING if job_of(name) is kind)
            folder = next((name for name in _OUTPUT if name.partition(".")[0] in kind.key_names()), None)
            todo = f"the folder that it writes to is {folder}=FOLDER" if folder and key in _OUTPUT else "leave it out"
            having = ", ".join(f"siamloc {name}" for name in others)
            raise ConfigError(f"siamloc {command} has no key {key!r}, which is a key of {having}: {todo}")


def _takes_data_of_a_run(words: list[str], kind: type[Job]) -> bool:
    """Whether a run says of which kind the data are, so that only the job can judge the keys of data and cameras."""
    said = {key_of(word): word.partition("=")[2] for word in words}
    resumes = said.get("resume", "").lower() == "true"
    if "data" not in kind.GROUPS or "run" not in said or not ("descriptor" in kind.GROUPS or resumes):
        return False
    networks = [name for key in ("descriptor", "descriptor.run") for name in said.get(key, "").split(",")]
    folders = [Path(unquoted(name) or "nowhere") for name in (said["run"], *networks)]
    return any(Run(one).record.is_file() or runs_in(one) or any(one.glob("evaluation/*/map.npz")) for one in folders)


def _of_stored_data() -> tuple[str, ...]:
    """Return how words begin that set keys of any kind of data or camera: "data.root=", "unwrap.front.", and so on."""
    keys = {
        f"{group}.{key}"
        for group in ("data", "unwrap")
        for name in choices(group)
        for key in option(group, name).values
    }
    return tuple(f"{key}{end}" for key in keys for end in "=.")


def _whole(word: str) -> str:
    """Return a word, but refuse one that sets a single item of a list, since the list is known only to the run."""
    parts = key_of(word).split(".")
    if item := next((at for at, part in enumerate(parts) if part.isdigit()), None):
        raise ConfigError(f"{key_of(word)} is one item of a list: give the whole list, {'.'.join(parts[:item])}=[...]")
    return word


def _with_quotes(word: str) -> str:
    """Quote values with signs that Hydra's grammar lacks, umlauts or ~, unless they have symbols of that grammar.

    A comma separates the values of a sweep.
    """
    key, equals, value = word.partition("=")
    plain = not equals or word.startswith("-") or set(value) & set("'\"[](){}$\\")
    values = (one if one.isascii() and "~" not in one else quoted(one) for one in value.split(","))
    return word if plain else f"{key}={','.join(values)}"


def _as_meant(word: str, kind: type[Job]) -> str:
    """Read `model.branch=NAME` as the choice `model/branch=NAME`, and `descriptor=FOLDER` as the network of that run.

    Several folders are a sweep over networks. A list of descriptors becomes the name of all of them fused.
    """
    key, _, value = word.partition("=")
    if key == "descriptor":
        value = re.sub(r"\[([^\[\]]*)\]", lambda found: _fused(found[1]), value)
        word = f"{key}={value}"
    if "." in key and key.replace(".", "/") in kind.GROUPS:
        return f"{key.replace('.', '/')}={value}"
    folders = [unquoted(folder) for folder in value.split(",")]
    if key != "descriptor" or not all((Path(folder) / "run.json").is_file() for folder in folders):
        return word
    return f"descriptor.run={','.join(map(quoted, folders))}"


def _fused(listed: str) -> str:
    """Return the name of several descriptors fused, for their names with commas in between."""
    return SIGN.join(distinct([name.strip("'\" ") for name in listed.split(",")] if listed.strip() else []))


def flags_first(words: list[str]) -> list[str]:
    """Move the overrides after the flags: Hydra's parser only takes them in one piece."""
    overrides = [word for word in words if word.startswith("~") or ("=" in word and not word.startswith("-"))]
    return [word for word in words if word not in overrides] + overrides


def key_of(word: str) -> str:
    """Return the key of a word, without the signs that Hydra takes before it."""
    return word.partition("=")[0].lstrip("+~")
