import numpy as np
import pytest

from analytic import AnalyticError
from analytic.descriptors.base import Description
from analytic.mapper import IncrementalMapper
from tests.analytic.mapper.world import World, corridor_drive, rows

WORLD = World()
FRAMES = rows(WORLD.at(corridor_drive(30)))


def changed(position=None, orientation=None, identity=None):
    frame = FRAMES[1]
    return Description(
        frame.position if position is None else position,
        frame.orientation if orientation is None else orientation,
        frame.identity if identity is None else identity,
    )


@pytest.mark.parametrize(
    ("frame", "says"),
    [
        (lambda: WORLD.at(corridor_drive(3)), "one image at a time, got a description of 3"),
        (lambda: changed(position=np.full((1, 16), np.nan, dtype=np.float32)), "position part .* finite real numbers"),
        (
            lambda: changed(orientation=np.full((1, 12, 3), np.inf, dtype=np.float32)),
            "orientation part .* finite real numbers",
        ),
        (lambda: changed(position=np.ones((1, 15), dtype=np.float32)), "different sizes .* position 15"),
        (lambda: Description(FRAMES[1].position, None), "different sizes .* no orientation part"),
        (lambda: changed(identity={"name": "other"}), "other parameters .*name=other"),
        (lambda: changed(position=np.ones(16, dtype=np.float32)), r"shape \(images, numbers\), got \(16,\)"),
        (
            lambda: changed(orientation=np.ones((2, 12, 3), dtype=np.float32)),
            "orientation part .* of 1 images .* as many rows",
        ),
        (lambda: Description(np.ones((1, 5000), dtype=np.float32)), "at most 4096 numbers, got 5000"),
        (lambda: changed(position=np.full((1, 16), 1e39)), "position part .* up to 1e\\+38, .* leave it out"),
        (lambda: changed(position=np.full((1, 16), "a")), "position part .* real numbers .* <U1"),
        (
            lambda: changed(orientation=np.ones((1, 12, 3), dtype=complex)),
            "orientation part .* real numbers .* complex128",
        ),
        (lambda: np.ones(16), "describe\\(\\) returns, got ndarray"),
    ],
)
def test_a_bad_description_is_one_sentence_and_changes_nothing(frame, says):
    mapper = IncrementalMapper(WORLD)
    mapper.add(FRAMES[0])
    with pytest.raises(AnalyticError, match=says):
        mapper.add(frame())
    assert len(mapper) == 1
    assert len(mapper.events) == 2


@pytest.mark.parametrize(
    ("parameters", "says"),
    [
        ({"version": 3}, "version must be 1 or 2, got 3"),
        ({"gamma": 0}, "gamma must be a number above 0, got 0"),
        ({"omega": float("nan")}, "omega must be a number above 0.*, got nan"),
        ({"x_slope": -0.1}, "x_slope must be a number from 0, got -0.1"),
        ({"omgea": 2}, "unknown key omgea: did you mean 'omega'"),
        ({"merge": "often"}, "merge must be changed or created or never, got 'often'"),
        ({"two_sided": 1}, "two_sided must be true or false"),
        ({"distance": "cosin"}, "unknown distance 'cosin': did you mean 'cosine'"),
        ({"shrinkage": 0.0}, "shrinkage must be ledoit_wolf, or a share above 0, up to 1, got 0.0"),
        ({"held_out": 1.0}, "held_out must be a number between 0 and 1"),
        ({"held_out": 0.1}, "holds out 1: at least two"),
        ({"exemplars": 1}, "exemplars must be a whole number from 2 to 10 million, or null, got 1"),
        ({"window": -1}, "window must be a whole number from 0 to"),
        ({"new_node": 5}, "new_node=5 would form nodes of fewer than smallest_node=10"),
        ({"first_node": 20.5}, "first_node must be a whole number"),
        ({"checked_unassigned": 25}, "checked_unassigned counts frames of the last checked_window: 25 of 20"),
    ],
)
def test_a_parameter_out_of_range_is_one_sentence(parameters, says):
    with pytest.raises(AnalyticError, match=says):
        IncrementalMapper(WORLD, **parameters)


def test_other_mistakes():
    mapper = IncrementalMapper(WORLD)
    with pytest.raises(AnalyticError, match="no node yet after 0 frames"):
        mapper.locate(FRAMES[0])
    with pytest.raises(AnalyticError, match="plain values, lists or objects"):
        mapper.add(FRAMES[0], frame=object())
    for frame in FRAMES[:20]:
        mapper.add(frame)
    with pytest.raises(AnalyticError, match=r"no node 3: it has \[0\]"):
        mapper.maintain(3, WORLD.at(corridor_drive(12)))
    with pytest.raises(AnalyticError, match=r"no node \[0\]: it has \[0\]"):
        mapper.maintain([0], WORLD.at(corridor_drive(12)))
    with pytest.raises(AnalyticError, match=r"takes a descriptor, such as .*, got 'hog'"):
        IncrementalMapper("hog")
    with pytest.raises(AnalyticError, match="at least smallest_node=10 images, got 4"):
        mapper.maintain(0, WORLD.at(corridor_drive(4)))
    with pytest.raises(AnalyticError, match="12 images need as many frames, got 2"):
        mapper.maintain(0, WORLD.at(corridor_drive(12)), frames=[1, 2])
    assert len(mapper) == 20
    assert mapper.maintain(np.int64(0), WORLD.at(corridor_drive(12))).node == 0
