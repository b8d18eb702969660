"""The text of `siamloc <command> --help`: the main keys of a command, then every key of its configuration."""

from __future__ import annotations

from pathlib import Path
from textwrap import dedent, fill, indent
from typing import Any

from siamloc.cli.help import COMMANDS
from siamloc.jobs.options import choices, values_of


def command_help(name: str) -> str:
    """Return the text of `siamloc <command> --help`: the main keys with an explanation of each, then all keys."""
    command = COMMANDS[name]
    groups = []
    if command.config is None:
        from siamloc.cli.robot import keys as keys_of_robot

        every, more = {"keys": keys_of_robot(name)}, ""
    else:
        every, more = keys_of(command.config), " (`--cfg job` shows their values)"
    for group, keys in every.items():
        listed = fill(" ".join(keys), 110, initial_indent="      ", subsequent_indent="      ", break_on_hyphens=False)
        groups.append(f"  {group}\n{listed}" if keys else f"  {group}")
    return (
        f"siamloc {name}: {command.summary}\n\n{indent(dedent(command.details).strip(), '  ')}\n\n"
        f"example:\n  {command.example}\n\n"
        f"all keys, by group{more}:\n" + "\n".join(groups)
    )


def keys_of(name: str) -> dict[str, list[str]]:
    """Return all keys of a configuration by group: "data=cold|folder|..." and "other keys".

    They are read from the configuration files and the settings classes, so the list is always complete.
    """
    from siamloc.cli.compose import composed_defaults, folder_of

    config = composed_defaults(name)
    found: dict[str, list[str]] = {}
    chosen = [*_groups_of(folder_of(name) / f"{name}.yaml"), *(["experiment"] if name == "config" else [])]
    for group in chosen:
        section, named = group.replace("/", "."), choices(group)
        keys = set(_flat(config, section))
        for option in named if group != "experiment" else []:
            for key, value in values_of(group, option).items():
                keys |= set(_flat(value, f"{section}.{key}"))
        found[f"{group}={'|'.join(named)}"] = sorted(keys)
    inside = {key for keys in found.values() for key in keys}
    others = [key for key in _flat(config, "") if key not in inside and key != "experiment"]
    return {**found, "other keys": sorted(others)} if found else {"keys": sorted(others)}


def _groups_of(file: Path) -> list[str]:
    """Return the groups that a configuration file chooses from, such as "data" and "model/branch"."""
    from omegaconf import OmegaConf

    held: Any = OmegaConf.to_container(OmegaConf.load(file))
    defaults = held.get("defaults", [])
    return [str(key) for entry in defaults if not isinstance(entry, str) for key in entry if "@" not in str(key)]


def _flat(value: Any, prefix: str) -> list[str]:
    """Return the keys inside a section, with dots."""
    from omegaconf import DictConfig, OmegaConf

    if isinstance(value, DictConfig):
        inside = OmegaConf.to_container(value, resolve=False)
        for part in prefix.split(".") if prefix else []:
            inside = inside.get(part, {}) if isinstance(inside, dict) else {}
        return _flat(inside, prefix)
    if not isinstance(value, dict):
        return [prefix]
    parts = [_flat(item, f"{prefix}.{key}" if prefix else str(key)) for key, item in value.items()]
    return [key for keys in parts for key in keys]
