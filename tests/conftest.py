"""Shared by all tests: Ctrl-C works, and a small custom data set for tests that run the code of the pages."""

import os
import signal

import cv2
import hypothesis
import numpy as np
import pytest

ANY_SPEED = {"deadline": None, "suppress_health_check": [hypothesis.HealthCheck.too_slow]}  # of a busy machine
hypothesis.settings.register_profile("quick", max_examples=20, **ANY_SPEED)
hypothesis.settings.register_profile("thorough", max_examples=100, **ANY_SPEED)
hypothesis.settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "quick"))

FRAMES = 6


@pytest.fixture(autouse=True)
def _interruptible():
    """Lightning ignores Ctrl-C once a training was interrupted, and so do processes that are started then."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def robot(tmp_path, monkeypatch):
    """Make a folder the current one: `robot.csv` with two drives of a few small pictures each, and a photograph."""
    places = np.random.default_rng(0).integers(0, 256, (FRAMES, 8, 32, 3)).astype(np.uint8)
    rows = ["image,x,y,theta,room,sequence"]
    for drive in ("monday", "tuesday"):
        for number, place in enumerate(places):
            name = f"{drive}_{number}.png"
            cv2.imwrite(str(tmp_path / name), cv2.resize(place, (128, 32), interpolation=cv2.INTER_NEAREST))
            rows.append(f"{name},{0.25 * number},0,0,{'office' if number < FRAMES // 2 else 'corridor'},{drive}")
    (tmp_path / "robot.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    (tmp_path / "photo.jpg").write_bytes((tmp_path / "tuesday_4.png").read_bytes())
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SIAMLOC_CACHE", str(tmp_path / "cache"))
    return tmp_path
