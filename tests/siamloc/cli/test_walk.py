"""`siamloc walk` gives `siamloc.walk` the settings of its words, and refuses recordings that it cannot use."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tests.siamloc.cli.commands import done, refused


def test_the_words_of_the_command_are_the_settings_of_the_call(monkeypatch, capsys):
    given = {}

    def walk(file, out, *, say, overwrite, settings):
        given.update(file=file, out=out, overwrite=overwrite, settings=settings)
        say("key frames: 7")

    monkeypatch.setattr("siamloc.jobs.walk.walk", walk)
    done(
        "walk",
        "monday.mp4",
        "out=robot",
        "spacing=0.5",
        "recording.rate=2",
        "unwrap=polar",
        "unwrap.inner=9",
        "overwrite=true",
    )
    assert (given["file"].name, given["out"], given["settings"].spacing) == ("monday.mp4", "robot", 0.5)
    assert given["overwrite"]
    assert (given["settings"].recording.rate, given["settings"].recording.poses) == (2, "none")
    assert (given["settings"].unwrap["kind"], given["settings"].unwrap["inner"]) == ("polar", 9)
    assert capsys.readouterr().out == "key frames: 7\n"


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ([], "file is not set: give it as file=VALUE"),
        (["nothing.mp4"], "there is no recording nothing.mp4"),
        (["empty"], "empty holds no images"),
        (["counted", "recording.odometry=wheels.txt"], "so give recording.times=FILE"),
        (["a.mp4", "left_out=1"], "left_out must be a whole number from 2, got 1"),
        (["a.mp4", "unwrap=polr"], "polr"),
    ],
)
def test_what_cannot_be_a_recording_is_named(words, says, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "counted").mkdir()
    (tmp_path / "counted/1.png").write_bytes(b"picture")
    (tmp_path / "wheels.txt").write_text("0 0 0 0\n1 1 0 0\n")
    assert says in refused(capsys, "walk", *words)
    assert not (tmp_path / "walk").exists()


def test_a_video_without_a_ring_is_refused(tmp_path, capsys):
    film = cv2.VideoWriter(str(tmp_path / "plain.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 5, (120, 90))
    for picture in np.random.default_rng(0).integers(0, 256, (8, 90, 120, 3)).astype(np.uint8):
        film.write(picture)
    film.release()
    assert "finds no ring" in refused(capsys, "walk", tmp_path / "plain.avi", f"out={tmp_path / 'walk'}")
