import io
import sys

import siamloc
from siamloc import progress
from siamloc.progress import track


def test_plain_lines_where_nobody_watches(monkeypatch):
    screen = io.StringIO()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setattr(progress, "_PAUSE", 0)
    assert list(track(iter("abc"), 3, "counting")) == ["a", "b", "c"]
    first, second, last = screen.getvalue().splitlines()
    assert first.startswith("counting: 1 of 3")
    assert "s left" in first
    assert second.startswith("counting: 2 of 3")
    assert last.startswith("counting: 3 of 3 in ")
    assert list(track([], 0, "waiting")) == []
    assert screen.getvalue().splitlines()[-1].startswith("waiting: 0 of 0")


def test_nothing_is_shown_where_progress_is_hidden(capsys):
    with progress.hidden():
        assert list(track("abc", 3, "counting")) == ["a", "b", "c"]
        images = siamloc.data.example()
        known = siamloc.maps.build("hog", images, images.frames)
        siamloc.evaluation.localization(known, images, images.frames, protocol="same_run")
    assert capsys.readouterr().err == ""
    list(track("abc", 3, "counting"))
    assert "counting: 3 of 3" in capsys.readouterr().err


def test_a_bar_where_a_person_watches(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    assert list(track(range(5), 5, "counting")) == [0, 1, 2, 3, 4]
    assert "counting" in screen.getvalue()
    assert "5/5" in screen.getvalue()
