"""The command line: `siamloc <command> [Hydra overrides]`.

This module loads nothing heavy, so help and mistyped commands are answered at once.
"""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from os.path import exists

from foundation.extras import lacking
from foundation.words import quoted, unquoted
from siamloc.cli.help import COMMANDS, command_help, job_of, overview
from siamloc.cli.words import values_of
from siamloc.errors import ConfigError, SiamlocError, hint
from siamloc.interrupts import follows_from, sigterm_stops


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return the exit status: 0, 2 for an error that the user can fix, 130 when interrupted."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in words
    words = [word for word in words if word != "--debug"]
    try:
        status = _dispatch(words)
        sys.stdout.flush()  # a full disk shows up here, and not when Python exits
        return status
    except KeyboardInterrupt as error:
        if not error.args:  # an interrupt with a message has already printed it
            print("siamloc: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:
        sys.stderr.close()
        return 141
    except Exception as error:
        sentence = _sentence(error, words)
        if sentence is None and follows_from(error) and not debug:
            print("siamloc: interrupted", file=sys.stderr)
            return 130
        if debug or sentence is None:
            raise
        print(f"siamloc: {sentence}", file=sys.stderr)
        if isinstance(error, OSError) and error.filename is None:
            # What could not be printed is discarded, so that Python does not try again on exit.
            with suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 2


def _dispatch(words: list[str]) -> int:
    if not words or words[0] in ("-h", "--help", "help"):
        print(overview())
        return 0
    if words[0] in ("-V", "--version"):
        from siamloc.versions import versions

        found = versions()
        print(f"siamloc {found.pop('siamloc')}", *(f"{name} {version}" for name, version in found.items()), sep="\n")
        return 0
    if words[0] == "completion":
        from siamloc.cli.completion import completion

        print(completion(words[1:]))
        return 0
    command, overrides = _command(words)
    if command is None:
        return 0
    if "-h" in overrides or "--help" in overrides:
        print(command_help(command))
        return 0
    kind = job_of(command)
    if not kind.BY_HYDRA:  # the robot has none
        with sigterm_stops():
            kind.of(values_of(overrides, kind)).run(partial(print, flush=True))
        return 0
    from siamloc.cli.compose import run

    if key := kind.ALONE:
        overrides = ["list=true" if word == "--list" else word for word in overrides]
        words = [word for word in overrides if not word.startswith("-")]
        alone = [word for word in words if "=" not in word or exists(word)]  # noqa: PTH110 (takes any text)
        if len(alone) > 1:
            raise ConfigError(f"siamloc {command} takes one {key}, got {' '.join(alone)}: run it once for each")
        overrides = [f"{key}={quoted(unquoted(word))}" if word in alone else word for word in overrides]
    run(command, overrides)
    return 0


def _command(words: list[str]) -> tuple[str | None, list[str]]:
    """Return the command (one or two words) and the words after it; None as the command if only help was requested.

    Raises:
        ConfigError: an unknown command.
    """
    for count in (2, 1):
        if " ".join(words[:count]) in COMMANDS:
            return " ".join(words[:count]), words[count:]
    family = [name for name in COMMANDS if name.startswith(f"{words[0]} ")]
    if not family:
        raise ConfigError(f"unknown command {words[0]!r}: {hint(words[0], COMMANDS)}")
    if {"-h", "--help"} & set(words):
        print("\n\n".join([command_help(name) for name in family]))  # `map` is a module of this package
        return None, []
    given = " ".join(words[:2]) if len(words) > 1 and "=" not in words[1] else words[0]
    raise ConfigError(f"unknown command {given!r}: use one of {', '.join(family)}")


def _sentence(error: Exception, words: list[str]) -> str | None:
    """Return the line to print, or None if the error is a bug in siamloc and needs its traceback."""
    if isinstance(error, SiamlocError):
        return str(error)
    if isinstance(error, ModuleNotFoundError):
        from siamloc import checkup

        return lacking(error, "simulate" if words[0] in checkup.COMMANDS["simulate"] else "train")
    if isinstance(error, FileNotFoundError) and error.errno and error.filename is None:  # of os.getcwd
        return "the current folder was removed: change to another one"
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        return f"{error.filename} cannot be used: {error.strerror.lower()}"
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EIO, errno.EDQUOT) and error.strerror:
        return f"what is printed cannot be written: {error.strerror.lower()}"
    if isinstance(error, MemoryError):
        return f"there is not enough memory for this ({error}): request less at a time"
    return None
