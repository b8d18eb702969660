import pickle
import re
import shlex
import shutil
from pathlib import Path

import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from foundation.words import as_words
from siamloc.cli import main
from siamloc.cli.completion import candidates
from siamloc.cli.compose import composed
from siamloc.data import Protocol
from siamloc.errors import ConfigError, logger
from siamloc.jobs import Evaluate, MapFrames, Prepare, Pretrain, Preview, Report, SurveyDrives, Train, Walk
from siamloc.jobs.options import choices, config_folder, groups, option
from siamloc.maps.axes import WrongAxesError
from tests.siamloc.cli.commands import done, refused

CALIBRATION = """\
image_width: 640
image_height: 480
distortion_model: equidistant
camera_matrix: {rows: 3, cols: 3, data: [200, 0, 320, 0, 200, 240, 0, 0, 1]}
distortion_coefficients: {rows: 1, cols: 4, data: [0, 0, 0, 0]}
"""


@pytest.mark.slow
@pytest.mark.parametrize("override", [f"{group}={option}" for group in groups() for option in choices(group)])
def test_every_option_of_every_group_composes(override, tmp_path):
    (tmp_path / "camera.yaml").write_text(CALIBRATION)
    given = {
        "data=manifest": ["data.manifest=x"],
        "data=trajectory": ["data.images=x", "data.poses=y"],
        "descriptor=frozen": ["data.root=x", "descriptor.branch=torchvision/resnet18"],
        "descriptor=fused": ["data.root=x", "descriptor.parts=[hog,hsv]"],
        "unwrap=calibrated": ["data.root=x", f"unwrap.file={tmp_path / 'camera.yaml'}"],
        "unwrap=own": ["data.root=x", "unwrap.kind=siamloc.data.panorama:PolarRing"],
    }
    where = given.get(override, ["data.root=x"])
    data = [] if override.startswith("data=") else ["data=folder"]
    measured = override.startswith(("descriptor", "heading", "build", "task"))
    usual = ["descriptor=hog"] if measured and not override.startswith("descriptor") else []
    words = [*data, *where, *usual, override]
    if override in ("descriptor=network", "descriptor=untrained"):
        with pytest.raises(ConfigError, match="no run is named"):
            composed("evaluate", words)
    else:
        assert isinstance(composed("evaluate" if measured else "train", words).protocol, Protocol)


@pytest.mark.parametrize(
    ("group", "content", "says"),
    [
        ("protocol", "a: b: c", r"protocol/own\.yaml, line 1, is not YAML: mapping values are not allowed"),
        *(("experiment", text, r"experiment/own\.yaml must be a mapping") for text in ("[1]", "", "defaults: {a: 1}")),
        *(("augment", text, r"augment/own\.yaml must be a mapping") for text in ("[1]", "5", "defaults: [5]")),
    ],
)
def test_a_broken_file_of_an_option_is_named(group, content, says, tmp_path, monkeypatch):
    folder = shutil.copytree(config_folder(), tmp_path / "conf")
    (folder / group / "own.yaml").write_text(content)
    for home in ("siamloc.cli.compose", "siamloc.jobs.options"):
        monkeypatch.setattr(f"{home}.config_folder", lambda: folder)
    with pytest.raises(ConfigError, match=says):
        composed("train", ["data.manifest=x", f"{group}=own"])


@pytest.mark.parametrize(
    ("command", "line", "kind", "values"),
    [
        (
            "train",
            "data.manifest=x loss=triplet pairs=in_batch model/branch=simple1 model.circular=true augment=thesis "
            "augment.where=gpu",
            Train,
            {
                "data": {"kind": "manifest", "name": "manifest", "manifest": "x"},
                **{"loss": "triplet", "pairs": "in_batch", "model": {"branch": "simple1", "circular": True}},
                "augment": {**option("augment", "thesis").values, "where": "gpu"},
            },
        ),
        (
            "train",
            "data.manifest=x model.branch=torchvision/resnet18 model.branch.weights=cached trainer.logger=csv",
            Train,
            {
                **{"data": {"kind": "manifest", "name": "manifest", "manifest": "x"}, "trainer": {"logger": "csv"}},
                "model": {"branch": {"name": "torchvision/resnet18", "weights": "cached"}},
            },
        ),
        ("report", "runs=[a,b]", Report, {"runs": ["a", "b"]}),
        ("pretrain", "loss.sigma=1.5", Pretrain, {"loss": {"sigma": 1.5}}),
        ("augment preview", "data.image_size=[32,128]", Preview, {"data": {"image_size": [32, 128]}}),
        (
            "survey",
            "data.manifest=x survey.alike=5 out=y",
            SurveyDrives,
            {"data": {"manifest": "x"}, "survey": {"alike": 5}, "out": "y"},
        ),
        ("walk", "file=x.mp4 spacing=0.5", Walk, {"file": "x.mp4", "spacing": 0.5}),
        # Options that choose options of other groups: how images unwrap, and which drives have which role.
        ("prepare", "data=cold data.root=x", Prepare, {"data": {"kind": "cold", "root": "x"}}),
        (
            "evaluate",
            "data=freiburg_sim descriptor=hog descriptor.bins=8 protocol.map.every=7 unwrap=polar distance=cosine",
            Evaluate,
            {
                **{"data": "freiburg_sim", "descriptor": {**option("descriptor", "hog").values, "bins": 8}},
                **{"protocol": {"map": {"every": 7}}, "unwrap": "polar", "distance": "cosine"},
            },
        ),
        (
            "map",
            "data=freiburg_sim descriptor=hog build=spectral build.nodes=9",
            MapFrames,
            {"data": "freiburg_sim", "descriptor": "hog", "build": {"name": "spectral", "nodes": 9}},
        ),
        (
            "map",
            "data=freiburg_sim descriptor=pretrained mounting.yaw=90 mounting.mirrored=true",
            MapFrames,
            {"data": "freiburg_sim", "descriptor": "pretrained", "mounting": {"yaw": 90, "mirrored": True}},
        ),
        # An experiment chooses before its data do, and what it does not choose follows the data that are given.
        (
            "train",
            "experiment=demo data=freiburg_sim protocol.kind=same_run pairs.near=0.5 epochs=2",
            Train,
            {
                **{"experiment": "demo", "data": "freiburg_sim", "protocol": {"kind": "same_run"}},
                **{"pairs": {"near": 0.5}, "epochs": 2},
            },
        ),
        (
            "train",
            "experiment=thesis_absolute data=folder data.root=x",
            Train,
            {"experiment": "thesis_absolute", "data": {"kind": "folder", "root": "x", "name": "freiburg"}},
        ),
    ],
)
def test_a_notebook_makes_the_same_job(command, line, kind, values):
    assert composed(command, line.split()) == kind.of(values)


def test_a_value_in_place_of_a_group_is_refused():
    with pytest.raises(ConfigError, match=r"model is a group of keys: set them one by one, such as model\.KEY=VALUE"):
        Train.of({"data": {"kind": "manifest", "manifest": "x"}, "model": "vgg16"})
    with pytest.raises(ConfigError, match="unknown loss 'triplett': did you mean 'triplet'"):
        Train.of({"data": {"kind": "manifest", "manifest": "x"}, "loss": "triplett"})


@pytest.mark.parametrize("group", groups())
def test_every_option_has_a_line_for_the_help(group):
    assert all(len(line) > 10 and line.endswith(".") for line in choices(group).values()), choices(group)


def test_omnidirectional_data_is_unwrapped_by_default():
    assert composed("train", ["data=cold", "data.root=x"]).unwrap["kind"] == "cold"
    assert composed("train", ["data=cold", "data.root=x", "unwrap=none"]).unwrap["kind"] == "none"


def test_other_arguments_of_the_trainer_are_added_with_a_plus():
    words = ["experiment=modern", "data.manifest=x", "trainer.limit_train_batches=3"]
    with pytest.raises(ConfigError, match=r"Trainer with a plus: \+trainer\.limit_train_batches="):
        composed("train", words)
    config = composed("train", [*words[:2], f"+{words[2]}"])
    assert config.trainer.further == {"limit_train_batches": 3}
    own = ["data.manifest=x", "unwrap=own", "unwrap.kind=siamloc.data.panorama:PolarRing", "unwrap.inner=3"]
    with pytest.raises(ConfigError, match=r"a camera of your own with a plus: \+unwrap\.inner="):
        composed("train", own)


@pytest.mark.parametrize(
    ("command", "word", "says"),
    [
        (
            "export",
            "out=x",
            "no key 'out', which is a key of siamloc evaluate: the folder that it writes to is bundle=",
        ),
        ("map", "out=x", "no key 'out', which is a key of siamloc evaluate: the folder that it writes to is run="),
        ("evaluate", "precision=int8", "has no key 'precision', which is a key of siamloc export: leave it out"),
        ("map", "+loss.margin=1", "has no key 'loss.margin', which is a key of siamloc train: leave it out"),
        ("prepare", "model/branch=vgg16", "no key 'model/branch', which is a key of siamloc train, siamloc map, "),
    ],
)
def test_keys_that_only_another_command_has_are_refused(command, word, says, capsys):
    words = ["data=freiburg_sim", word]
    with pytest.raises(ConfigError, match=re.escape(says)):
        composed(command, words)
    assert says in refused(capsys, command, "-m", *words, "data.name=a,b")


@pytest.mark.parametrize("command", ["prepare", "train", "map", "evaluate", "export"])
def test_an_experiment_may_set_keys_of_other_commands(command):
    words = [] if command in ("prepare", "train") else ["descriptor=hog"]
    composed(command, ["experiment=corridor_published", "data.manifest=x", *words])


def test_the_tab_key_offers_the_keys_of_the_command():
    assert candidates("siamloc export o") == ["overwrite="]
    assert candidates("siamloc evaluate o") == ["out=", "overwrite="]
    assert candidates("siamloc map exp") == ["experiment="]
    assert candidates("siamloc map mo") == ["model.", "model/", "mounting."]


def test_options_of_ones_own_are_files_in_a_folder_as_the_guide_says(tmp_path, monkeypatch, capsys):
    guide = (config_folder().parent / "docs/guide/commands.md").read_text(encoding="utf-8")
    file, text = re.search(r"The file `(.*?)` with\n\n```yaml\n(.*?)```", guide, flags=re.DOTALL).groups()
    command = re.search(r'`siamloc (train --config-dir "my conf" protocol=mine) \.\.\.`', guide)[1]
    (tmp_path / file).parent.mkdir(parents=True)
    (tmp_path / file).write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    done(*shlex.split(command), "data.manifest=x", "--cfg", "job")
    assert "- monday" in capsys.readouterr().out
    done(*shlex.split(command), "data.manifest=x", "protocol.map.every=5", "--cfg", "job")  # not in the file
    assert "every: 5" in capsys.readouterr().out


def test_mistakes_with_options_of_ones_own_are_explained(tmp_path, capsys):
    folder = tmp_path / "conf"
    for name in ("protocol/mine", "augment/dim", "building/lab"):
        (folder / name).parent.mkdir(parents=True)
        (folder / f"{name}.yaml").write_text("name: dim\neffect: noise\n" if "dim" in name else "kind: cross_run\n")
    own = ["--config-dir", folder]
    train = ["train", *own, "data.manifest=x", "--cfg", "job"]
    assert "unknown option protocol=mne: did you mean 'mine'?" in refused(capsys, *train, "protocol=mne")
    file = folder / "augment/dim.yaml"
    assert f"augment={file} names a file: FOLDER/augment/NAME" in refused(capsys, *train, f"augment={file}")
    said = refused(capsys, "simulate", *own, "building=mini", f"out={tmp_path}")
    assert "building is no group of options: rename the folder " in said


@given(st.text("ab1 \\\"'${}[](),:=é가\u0301", min_size=1))
@example("läufe/Lauf 1, größe +5% (ü)")
@example("\\${x} #;=&!|<>^`~")
@example("null")
@example("None")
@example("True")
@example("1e3")
@example("-.5")
@example("-a")
@example("[a]")
@example("C:\\läufe\\")
def test_proposed_words_are_read_as_they_were_meant(name):
    assume(name.strip())
    localize = composed("localize", shlex.split(as_words({"images": [name, "b"], "run": name})))
    assert (localize.folder, list(localize.images)) == (Path(name), [name, "b"])
    compare = composed("compare", shlex.split(as_words({"runs": [name, "b"], "out": name})))
    assert (compare.out, compare.runs) == (name, (name, "b"))


def test_an_error_of_a_reader_stays_itself_with_the_keys_of_the_command(monkeypatch):
    raised, cause = WrongAxesError("the clocks differ, give offset=SECONDS"), KeyError("time")

    def fails(job, say):
        raised.__cause__ = cause
        raise raised

    monkeypatch.setattr(Prepare, "run", fails)
    with pytest.raises(WrongAxesError, match=r"give data\.offset=SECONDS\. Leave x") as found:
        main(["prepare", "data=folder", "data.root=x", "--debug"])
    assert found.value is raised
    assert raised.__cause__ is cause
    assert "fails" in [entry.name for entry in found.traceback]
    copied = pickle.loads(pickle.dumps(raised))
    assert (str(copied), copied.finding) == (str(raised), raised.finding)
    assert str(copied).count("Leave x") == 1


@pytest.mark.parametrize(("words", "group"), [("data=folder data.root=x", "data"), ("monday", "recording")])
def test_warnings_of_a_reader_have_the_keys_of_the_command(monkeypatch, caplog, words, group):
    monkeypatch.setattr(Prepare, "run", lambda job, say: logger.warning("%s: give offset=SECONDS", "monday"))
    assert main(["prepare", *words.split()]) == 0
    assert caplog.messages == [f"monday: give {group}.offset=SECONDS"]
    assert not logger.filters
