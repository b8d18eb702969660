"""Commands as a user gives them, and what they leave behind."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from siamloc.cli import main
from siamloc.results import read_results

QUICK = ["task.baselines=[]", "task.plots=false"]
SMALL = ["model/branch=simple1", "model/head=fc500_500_5", "batch_size=8", "trainer.accelerator=cpu"]


def done(*words: object) -> None:
    """Run a command that must succeed."""
    status = main([str(word) for word in words])
    assert status == 0, f"siamloc {' '.join(map(str, words))} returned {status}"


def refused(capsys: Any, *words: object) -> str:
    """Run a command that must end in one sentence, and return the sentence."""
    capsys.readouterr()
    assert main([str(word) for word in words]) == 2
    lines = capsys.readouterr().err.splitlines()  # before the sentence, images may have been decoded
    assert [line for line in lines if line.startswith(("siamloc: ", "Traceback"))] == lines[-1:]
    return lines[-1]


def measures(folder: Path) -> dict[str, Any]:
    """Return the measures of the results in a folder, by part."""
    return read_results(folder)["measures"]
