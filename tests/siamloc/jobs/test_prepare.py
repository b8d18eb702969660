from __future__ import annotations

import re

import cv2
import numpy as np
import pytest

from tests.siamloc.cli.commands import done
from tests.siamloc.data.test_ring import drive

pytestmark = pytest.mark.slow


def test_the_rings_of_a_folder_are_said_and_drawn(tmp_path, capsys):
    """The pictures have nothing in common but the ring, so where its front is cannot be known."""
    room = tmp_path / "data" / "monday" / "hall"
    room.mkdir(parents=True)
    for number, picture in enumerate(drive(12)[0]):
        cv2.imwrite(str(room / f"{number:02d}.png"), picture)
    words = ["data.image_size=[32,128]", f"data.cache={tmp_path / 'cache'}", "unwrap.forward=30"]
    done("prepare", "data=folder", f"data.root={tmp_path / 'data'}", "unwrap=auto", *words)
    said = capsys.readouterr().out
    x, y, inner, outer = map(
        float, re.search(r"unwrap\.centre=\[(.+),(.+)\] unwrap\.inner=(\S+) unwrap\.outer=([0-9.]+)", said).groups()
    )
    assert np.hypot(x - 151.3, y - 108.6) < 0.3
    assert (inner, outer) == pytest.approx((22, 88), abs=1.5)
    assert "direction: unwrap.forward=30.0 as given, unwrap.mirrored=true as given; " in said
    drawn = cv2.imread(str(next((tmp_path / "cache").glob("ring_*.png"))))
    assert drawn.shape[0] == 220
    assert drawn.shape[1] > 300
