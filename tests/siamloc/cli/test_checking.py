"""Nonsense on the command line and in files: sentences of single keys, some cases of `benchmarks.torture`, limits."""

from __future__ import annotations

import itertools

import pytest

from analytic.errors import AnalyticError
from benchmarks.torture import FILES, file_cases, outcome_of, setting_cases, unknown_cases
from siamloc.cli.compose import composed
from siamloc.errors import ConfigError

SECONDS = 60.0  # for a case: other tests run at the same time
NEEDED = {"train": ["data=cold", "data.root=x"], "evaluate": ["data=cold", "data.root=x", "descriptor=hog"]}


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
    ("line", "says"),
    [
        # names and keys
        ("train data=manifst", "did you mean 'manifest'"),
        ("train data.rot=x", "did you mean 'data.root'"),
        ("train model/branch=vg16", "unknown option model/branch=vg16: did you mean 'vgg16'"),
        ("train run=a(1)", "in quotes"),
        ("train epoch=3", "did you mean 'epochs'"),
        ("simulate hours.a=5", "unknown configuration key 'hours.a': did you mean 'hours'"),
        ("evaluate descriptor.bens=5", "did you mean 'descriptor.bins'"),
        (
            "map data=folder data.root=x descriptor=hog mounting=straight",
            "mounting must be a group with the keys yaw, mirr",
        ),
        ("map data=folder data.root=x descriptor=hog mounting.yaw=left", "mounting.yaw must be a number, or null, got"),
        ("prepare data=cold data.root=x data.camera=std_cam", "show no full turn: set unwrap=none data.circular=false"),
        ("evaluate heading=wisurf", "unknown option heading=wisurf"),
        ("evaluate task.baselines=[hug]", "did you mean 'hog'"),
        ("evaluate task=absolute task.names=[absolut]", "unknown task 'absolut': did you mean 'absolute'"),
        ("train +foo=1", "unknown configuration key 'foo'"),
        ("train +pairs.foo=1", "unknown key pairs.foo"),
        ("train +trainer.foo=1", "unknown configuration key 'trainer.foo'"),
        ("train model.branch=alexnat", "unknown option model/branch=alexnat: did you mean 'alexnet'"),
        ("train model/branch=torchvision/resnat18", "torchvision has no network 'resnat18'"),
        ("train model/branch=not_there:factory", "model.branch=not_there:factory cannot be imported"),
        ("train model/branch=:factory", "model.branch=:factory cannot be imported (ValueError: Empty module name)"),
        ("train resume=true run=nowhere", "there is no run to resume in nowhere: leave out resume=true"),
        ("train hydra/launcher=slurm", "no launcher slurm is installed here: for joblib, run pip install '.[sweeps]'"),
        ("train photo.jpeg", "'photo.jpeg' is not of the form key=value"),
        ("train --resolve", "add --cfg job"),
        ("train epochs=2 --foo seed=1", "there is no option --foo: give settings as key=value"),
        ("train -5", "there is no option -5: give"),
        ("train epochs=2 -- --foo", "there is no option --: give"),
        ("augment expand out=x dept=3", "did you mean 'depth'"),
        # values
        ("train epochs=abc", "epochs must be a whole number from 1 to 10 million, got 'abc'"),
        ("train loss.margin=1e30", "loss.margin must be a number above 0, at most 10,000,000,000 in size"),
        ("train run=''", "run must be the name of a folder, or null, got ''"),
        ("train model/head=flat model.head.outputs=1000000", "outputs must be a whole number from 1 to 65,536"),
        ("train data.image_size=[32]", "rows, columns"),
        ("evaluate distance=cosin", "distance must be manhattan or euclidean or correlation or cosine, or null, got"),
        ("evaluate task.plots=maybe", "task.plots must be true or false, got 'maybe'"),
        ("evaluate task.filter=true task.filter_settings.kidnapping=1", "must be a number between 0 and 1"),
        ("evaluate task=robustness task.robustness.noise=[a]", "a list of numbers from 0"),
        ("augment preview out=x.gif", "out must be a picture's name, ending .jpg .jpeg .png .webp, got 'x.gif'"),
        # keys that do not go together
        ("evaluate task=hierarchical build=rooms task.filter=true", "unknown configuration key 'task.filter'"),
        ("evaluate task=absolute task.names=[buildings]", "choose it with task=buildings"),
        ("evaluate task=absolute task.names=[absolute,buildings]", "must be one of absolute, room_retrieval"),
        ("evaluate task=room_retrieval task.error_model=true", "which room_retrieval leaves out: use task=absolute"),
        ("evaluate task=absolute task.filter_tune=true", "set task.filter=true"),
    ],
)
def test_what_the_sentence_is(line, says):
    command, *words = line.split()
    if command == "augment":
        command, words = f"{command} {words[0]}", words[1:]
    with pytest.raises((ConfigError, AnalyticError)) as refusal:
        composed(command, [*NEEDED.get(command, []), *words])
    assert says in str(refusal.value)


def test_a_manifest_needs_its_name():
    with pytest.raises(ConfigError, match=r"data\.manifest is not set"):
        composed("train", ["data=manifest"])
