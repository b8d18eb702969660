"""`siamloc survey` writes a manifest with the poses, figures, a picture and a film."""

from __future__ import annotations

import shlex
from pathlib import Path

import cv2
import numpy as np
import pytest

import siamloc
from foundation.files import read_json
from siamloc.cli import main
from siamloc.data import FrameTable
from siamloc.data.moves import chained, moves, wrapped
from siamloc.errors import DataError
from tests.drawn import write_manifest
from tests.siamloc.cli.commands import done, refused
from tests.surveyed import a_survey

HOUSE = Path(__file__).parents[4] / "shared" / "data" / "house" / "manifest.csv"


def test_the_command_writes_what_the_next_commands_read(tmp_path, monkeypatch, capsys):
    manifest = write_manifest(tmp_path / "data", {"monday": "cloudy"}, frames_per_room=4)
    given = {}

    def survey(network, images, frames, **options):
        given.update(options, frames=frames, size=images.image_size)
        return a_survey(manifest.parent / "monday")

    monkeypatch.setattr("siamloc.jobs.survey.survey", survey)
    anchors = tmp_path / "anchors.csv"
    anchors.write_text(manifest.read_text().replace("monday/", "data/monday/"))
    out = tmp_path / "my survey"
    camera = ["unwrap=equirectangular", "unwrap.turn=300"]
    done("survey", f"data.manifest={manifest}", f"anchors={anchors}", f"out={out}", "survey.alike=5", *camera)
    assert given["size"] == (64, 256)
    assert given["settings"].alike == 5
    assert set(given["frames"].sequence.tolist()) == {"monday"}
    assert given["anchors"].has_position.all()
    shown = capsys.readouterr().out
    assert "2 used, 2 refused" in shown
    words = shlex.split(shown.splitlines()[-1])
    assert {f"data.manifest={out / 'surveyed.csv'}", 'protocol.map.sequences=["*"]', *camera} <= set(words)
    assert {path.name for path in out.iterdir()} == {"surveyed.csv", "survey.json", "survey.png", "survey.gif"}
    figures = read_json(out / "survey.json")
    assert figures["loops"] == {"accepted": 2, "unlike": 0, "alone": 1, "contradicted": 1}
    assert figures["settings"]["survey"]["alike"] == 5
    assert list(figures["odometry"]) == ["monday"], "tuesday has none"
    lines = (out / "surveyed.csv").read_text().splitlines()
    assert lines[0] == "image,x,y,theta,sequence,odom_x,odom_y,odom_theta,deviation,theta_deviation"
    assert lines[1].startswith("../data/monday/0.png,4.0,0.0,")


def test_faults_of_the_panoramas_are_said_before_the_survey(tmp_path, monkeypatch, capsys):
    manifest = write_manifest(tmp_path / "data", {"monday": "cloudy"}, frames_per_room=4)
    for picture in (tmp_path / "data/monday").iterdir():
        cv2.imwrite(str(picture), cv2.resize(cv2.imread(str(picture)), (64, 48)) // 40)

    def survey(*_, **__):
        raise DataError("the long work begins")

    monkeypatch.setattr("siamloc.jobs.survey.survey", survey)
    assert main(["survey", f"data.manifest={manifest}", f"out={tmp_path / 'survey'}"]) == 2
    said = capsys.readouterr().out
    assert "note: images of 64 x 48 px (columns x rows) are resized to 256 x 64 without unwrapping" in said
    assert "note: sequence monday: 12 of 12 images are more than" in said


def test_a_network_that_does_not_compare_is_refused(tmp_path, trained, data, capsys):
    text = refused(capsys, "survey", *data, f"network={trained}", f"out={tmp_path / 'survey'}")
    assert "needs a network that compares panoramas" in text
    assert not (tmp_path / "survey").exists()


@pytest.mark.slow
def test_the_shipped_network_surveys_a_house_of_others():
    if not HOUSE.is_file():
        pytest.skip("the path-traced house is not beside the project")
    frames = siamloc.data.read("manifest", manifest=str(HOUSE)).select(sequence="*cloudy3").every(2)
    images = siamloc.data.PanoramaLibrary(frames, image_size=(64, 256))
    true = np.column_stack([frames.xy, frames.theta])
    steps = moves(true)
    steps[:, :2] *= 1.02
    steps[:, 2] += np.radians(0.5) * np.hypot(steps[:, 0], steps[:, 1])
    unknown = FrameTable(path=frames.path, sequence=frames.sequence)
    found = siamloc.maps.survey("pretrained", images, unknown, odometry=chained(steps), progress=False)
    turned = wrapped(true[:, 2] - found.frames.theta).mean()
    given, wanted = (xy - xy.mean(axis=0) for xy in (found.frames.xy, true[:, :2]))
    cosine, sine = np.cos(turned), np.sin(turned)
    moved = given @ np.array([[cosine, sine], [-sine, cosine]])
    assert np.hypot(*(moved - wanted).T).mean() < 0.15  # by odometry alone 0.3
    assert found.loops.accepted.sum() > 20
