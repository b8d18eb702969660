"""The commands and their help, which comes from the docstrings and the fields of their jobs."""

from __future__ import annotations

from importlib import import_module
from inspect import cleandoc
from textwrap import fill, indent, shorten
from typing import Any

from foundation.settings import leaves
from siamloc.jobs.job import Job

COMMANDS = {
    "simulate": ("jobs.simulate.Simulate", "render a made-up building in the COLD layout"),
    "fetch": ("jobs.fetch.Fetch", "load the COLD database, or parts of it"),
    "prepare": ("jobs.prepare.Prepare", "check a data set and decode its images once"),
    "walk": ("jobs.walk.Walk", "make a robot that knows where it is from one recording"),
    "survey": ("jobs.survey.SurveyDrives", "estimate the poses of drives from their images and odometry"),
    "train": ("jobs.train.Train", "train a siamese network"),
    "pretrain": ("jobs.train.Pretrain", "train a network on random buildings, before it sees any data"),
    "map": ("jobs.map.MapFrames", "describe the map frames of a run"),
    "evaluate": ("jobs.evaluate.Evaluate", "measure localization and room retrieval"),
    "export": ("jobs.export.Export", "write the model file for the robot"),
    "localize": ("jobs.robot.Localize", "locate image files with an exported bundle"),
    "live": ("jobs.robot.Watch", "show on a web page where the robot is while it drives"),
    "report": ("jobs.report.Report", "write one HTML page with a run's results"),
    "compare": ("jobs.report.Compare", "tabulate and plot a sweep, best first"),
    "reproduce": ("jobs.reproduce.Reproduce", "reproduce a published table or figure"),
    "augment expand": ("jobs.augment.Expand", "write an augmented data set in the input's own layout"),
    "augment preview": ("jobs.augment.Preview", "draw every effect at several strengths on one sheet"),
    "doctor": ("jobs.doctor.Doctor", "show what is installed, what it lets you do, and whether it works"),
    "demo": ("cli.demo.Demo", "run the whole workflow on a small made-up building"),
}
"""The class of each command's job inside `siamloc`, and one line about it; loaded when the command is used."""


def job_of(command: str) -> type[Job]:
    """Return the class of a command's job."""
    module, _, name = COMMANDS[command][0].rpartition(".")
    job: type[Job] = getattr(import_module(f"siamloc.{module}"), name)
    return job


def overview() -> str:
    """Return the text of `siamloc --help`: the commands, a line each."""
    width = max(map(len, COMMANDS))
    lines = "\n".join(f"  {name:<{width}}  {summary}" for name, (_, summary) in COMMANDS.items())
    return (
        "siamloc: siamese place recognition for robots with omnidirectional cameras\n\n"
        "usage: siamloc <command> [key=value ...]\n\n"
        f"{lines}\n\n"
        "siamloc <command> --help          the keys of a command, with an example\n"
        "siamloc <command> --cfg job       the whole configuration (not for localize, live and doctor)\n"
        "siamloc completion bash|zsh|fish  complete commands, groups and keys with the tab key\n"
        "siamloc --version                 its version, and those that a report of a bug needs\n\n"
        "--debug shows the traceback of an error."
    )


def command_help(command: str) -> str:
    """Return the text of `siamloc <command> --help`: the docstring of the job, then all keys by group."""
    job = job_of(command)
    text, _, example = cleandoc(job.__doc__ or "").partition("\n\nExample:\n    $ ")
    listed = []
    for group, (options, keys) in keys_of(job).items():
        listed.append(f"  {group}=" if options else f"  {group}")
        width = max(map(len, options), default=0)
        listed += [f"      {name:<{width}}  {shorten(line, 105 - width)}" for name, line in options.items()]
        if keys:
            listed.append(indent(fill(" ".join(keys), 106, break_on_hyphens=False), "    "))
    more = " (`--cfg job` shows their values)" if job.BY_HYDRA else ""
    body = indent(text.partition("\n\n")[2], "  ")
    all_keys = "\n".join([f"\n\nall keys, by group{more}:", *listed]) if listed else ""
    return f"siamloc {command}: {COMMANDS[command][1]}\n\n{body}\n\nexample:\n  {example}{all_keys}"


def keys_of(job: type[Job]) -> dict[str, tuple[dict[str, str], list[str]]]:
    """Return all keys of a job by group, such as "data", and "other keys".

    Returns:
        For each group its options, with one line about each, and its keys.
    """
    if not job.BY_HYDRA:
        return {"keys": ({}, job.key_names())} if job.key_names() else {}
    from siamloc.jobs.options import choices, option

    found: dict[str, tuple[dict[str, str], list[str]]] = {}
    defaults = job.defaults()
    for group in job.GROUPS:
        options, section = choices(group), group.replace("/", ".")
        held: dict[str, Any] = job.MORE.get(group, {})
        inside = {key for name in options for key, _ in leaves({**option(group, name).values, **held}, f"{section}.")}
        found[group] = (options, sorted(inside))
    if job.SHARED:
        found["experiment"] = (choices("experiment"), [])
    inside = {key for _, keys in found.values() for key in keys}
    others = sorted(key for key, _ in leaves(defaults) if key not in inside)
    return {**found, "other keys": ({}, others)} if found else {"keys": ({}, others)}
