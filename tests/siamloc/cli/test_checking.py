"""Nonsense on the command line and in files: some of the cases of `benchmarks.torture`, and the limits."""

from __future__ import annotations

import itertools

import pytest

from benchmarks.torture import FILES, file_cases, outcome_of, setting_cases, unknown_cases
from siamloc.cli.compose import composed
from siamloc.errors import ConfigError

COLD = ["data=cold", "data.root=x"]
SECONDS = 60.0  # for a case: other tests run at the same time


@pytest.mark.slow
def test_every_key_refuses_nonsense():
    """Every 61st case: with the seven kinds of defaults and 21 strange values, each of both is covered."""
    wrong = []
    for name, case, nonsense in itertools.islice(setting_cases(), 0, None, 61):
        outcome = outcome_of(case, nonsense, SECONDS)
        if outcome.kind not in ("refused", "accepted"):
            wrong.append(f"{name}: {outcome}")
    assert not wrong


@pytest.mark.slow
def test_no_group_takes_a_key_that_it_does_not_know():
    outcomes = [(name, outcome_of(case, True, SECONDS)) for name, case, _ in unknown_cases()]
    assert [(name, one) for name, one in outcomes if one.kind != "refused"] == []
    assert all("unknown" in one.remark or "no " in one.remark for _, one in outcomes)


@pytest.mark.slow
def test_damaged_files_are_told_in_a_sentence():
    wrong = [
        f"{name}: {outcome}"
        for name, case, nonsense in file_cases(10, seed=1)
        if (outcome := outcome_of(case, nonsense, SECONDS)).kind not in ("refused", "accepted")
    ]
    assert not wrong
    assert len(FILES) >= 16


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["epochs=abc"], r"epochs must be a whole number from 1 to 10 million, got 'abc'"),
        (["+foo=1"], "unknown configuration key 'foo'"),
        (["+pairs.foo=1"], "unknown key pairs.foo"),
        (["pairs.scale=nan"], "pairs.scale must be"),
        (["run=[a,b]"], "run must be the name of a folder, or null, got"),
        (["run=''"], "run must be the name of a folder, or null, got ''"),
        (["augment.where=foo"], "augment.where must be auto or cpu or gpu, got 'foo'"),
        (["trainer.devices=0"], "trainer.devices must be"),
        (["+trainer.foo=1"], "unknown configuration key 'trainer.foo'"),
        (["epochs=1000000000000"], r"epochs must be a whole number from 1 to 10 million, got 1000000000000"),
        (["seed=4294967296"], "seed must be a whole number from 0 to 4,294,967,295, got 4294967296"),
        (["loss.margin=1e-300"], r"loss.margin must be a number above 0, at least 1e-12, got 1e-300"),
        (["loss.margin=1e30"], r"loss.margin must be a number above 0, at most 10,000,000,000 in size"),
        (
            ["model/head=flat", "model.head.outputs=1000000"],
            "outputs must be a whole number from 1 to 65,536",
        ),
        (["device=tpu"], "device must be auto, cpu or cuda, got 'tpu'"),
        (["data.image_size=[1000000,1000000]"], "data.image_size must be"),
        (["loader.workers=100000"], "loader.workers must be"),
        (["task.plots=maybe"], "task.plots must be true or false, got 'maybe'"),
        (["task.baselines=hog"], "task.baselines must be a list"),
        (["model/head=flat", "model.head.outputs=1.5"], "model.head.outputs must be"),
    ],
)
def test_what_the_sentence_is(words, says):
    command = ["evaluate", "descriptor=hog"] if words[0].startswith(("task", "device")) else ["train"]
    with pytest.raises(ConfigError, match=says):
        composed(command[0], [*COLD, *command[1:], *words])


def test_a_picture_that_cannot_be_one_is_refused_before_the_work():
    with pytest.raises(ConfigError, match=r"out must be a picture's name, ending .jpg .jpeg .png .webp, got 'x.gif'"):
        composed("augment preview", ["out=x.gif"])
