"""`siamloc doctor`: what is here, what is lacking, and whether it computes."""

from importlib import util

import numpy as np
import pytest

from foundation.extras import EXTRAS
from siamloc import checkup
from siamloc.cli import main
from siamloc.cli.help import COMMANDS
from siamloc.runtime import describing


@pytest.fixture
def without(monkeypatch):
    """Return a function that hides modules from the search for what is installed."""
    find = util.find_spec

    def hide(*names):
        monkeypatch.setattr(checkup, "find_spec", lambda name: None if name in names else find(name))

    return hide


def test_every_command_belongs_to_one_extra():
    told = [name for names in checkup.COMMANDS.values() for name in names]
    own = [name for name in told if name in COMMANDS]
    assert sorted([*own, "doctor"]) == sorted(COMMANDS)
    assert {name.split()[0] for name in set(told) - set(own)} == {"-m", "prepare", "train"}
    assert set(EXTRAS.values()) == set(checkup.COMMANDS)


@pytest.mark.slow
def test_nothing_is_wrong_here_and_the_network_describes_what_it_should():
    found = checkup.doctor()
    assert found.problems == ()
    assert found.described == "the shipped network"
    assert found.providers["CPUExecutionProvider"]
    assert found.devices[0].startswith("cpu (")
    assert {extra for extra, lacks in found.missing.items() if lacks} <= {"wandb", "mlflow"}, "those of loggers alone"


def test_a_robot_describes_by_hog_and_is_told_what_lacks(without, capsys):
    without("torch", "embreex", "onnxruntime")
    found = checkup.doctor()
    assert (found.described, found.problems, dict(found.providers)) == ("hog", (), {})
    assert found.missing["simulate"] == ("torch", "embreex")
    assert found.missing["live"] == (), "onnxruntime comes by any of the robot's extras"
    assert "lacks onnxruntime: run pip install '.[robot]'" in found.text()
    assert main(["doctor"]) == 0
    assert found.text() in capsys.readouterr().out


def test_a_wrong_description_is_a_problem_and_the_exit_status(without, monkeypatch, capsys):
    without("torch")
    right = checkup._HOG
    for wrong in (0.01, np.nan):
        monkeypatch.setattr(checkup, "_HOG", {index: value + wrong for index, value in right.items()})
        assert main(["doctor"]) == 2
        shown = capsys.readouterr()
        assert "hog describes a picture otherwise than it should" in shown.out
        assert shown.err == "siamloc: problems found: 1, listed above\n"


def test_two_distributions_of_one_module_are_a_problem(without, monkeypatch):
    without("torch")
    both = {"opencv-python": "5.0", "opencv-python-headless": "5.0"}
    monkeypatch.setattr(checkup, "installed", lambda package: both if package == "opencv" else {})
    (problem,) = checkup.doctor().problems
    assert problem.startswith("opencv-python and opencv-python-headless share the files of one module")


def test_a_provider_that_does_not_start_is_a_problem(without, monkeypatch):
    without("torch")
    monkeypatch.setattr(describing, "working_providers", lambda: {"CUDAExecutionProvider": False})
    found = checkup.doctor()
    assert "CUDAExecutionProvider does not work" in found.text()
    assert "onnxruntime has CUDAExecutionProvider, which does not work here" in found.problems[0]

    def broken():
        raise ImportError("libcudart.so cannot be opened")

    monkeypatch.setattr(describing, "working_providers", broken)
    assert "onnxruntime cannot be used (ImportError: libcudart" in checkup.doctor().problems[0]
