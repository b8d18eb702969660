import numpy as np

from analytic.mapper.frames import Rim
from analytic.mapper.node import Mode
from analytic.mapper.parameters import Parameters
from tests.analytic.mapper.world import World, corridor_drive, rows


def test_the_furthest_frame_is_found_while_the_centre_moves(monkeypatch):
    taken = []
    monkeypatch.setattr(Rim, "of", staticmethod(lambda *args, whole=Rim.of: taken.append(1) or whole(*args)))
    points = rows(World(size=6, steps=0, reach=5.0).at(corridor_drive(600, seed=3), noise=0.1))
    mode = Mode.of(Parameters(), range(3), points[:3])
    for count, point in enumerate(points[3:], start=3):
        inside = mode.rows.array
        furthest = np.linalg.norm(inside - inside.mean(axis=0), axis=1).max()
        np.testing.assert_allclose(mode.reach, furthest / (count - 1), rtol=1e-9)
        mode = mode.add(count, point)
    assert 1 < len(taken) < 300


def test_equal_frames_have_no_reach():
    frames = rows(World(steps=0).at(np.zeros((80, 3)), noise=0))
    mode = Mode.of(Parameters(), range(80), frames)
    assert mode.reach < 1e-7
    assert mode.add(80, frames[0]).reach < 1e-7
    assert Mode.of(Parameters(), [0], frames[:1]).reach == 0
