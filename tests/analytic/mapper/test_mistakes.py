from dataclasses import replace

import numpy as np
import pytest

from analytic import AnalyticError
from analytic.mapper import IncrementalMapper
from tests.analytic.mapper.world import FRAMES, POSES, WORLD, mapped


def changed(**parts):
    return lambda: replace(FRAMES[1], **parts)


@pytest.mark.parametrize(
    ("frame", "says"),
    [
        (lambda: WORLD.at(POSES[:3]), "one image at a time, got a description of 3"),
        (changed(position=np.full((1, 8), np.nan)), "position part .* finite real numbers"),
        (changed(orientation=np.full((1, 12, 3), np.inf)), "orientation part .* finite real numbers"),
        (changed(position=np.ones((1, 7))), "different sizes .* position 7"),
        (changed(orientation=None), "different sizes .* no orientation part"),
        (changed(identity={"name": "other"}), "other parameters .*name=other"),
        (changed(identity={"name": "other"}, position=np.ones((1, 5000))), "other parameters .*name=other"),
        (changed(position=np.ones(8)), r"numbers for each image, got shape \(8,\)"),
        (changed(orientation=np.ones((2, 12, 3))), "orientation part .* of 1 images .* as many rows"),
        (changed(position=np.ones((1, 5000))), r"1 to 4096 numbers .* shape \(1, 5000\)"),
        (changed(position=np.full((1, 8), 1e39)), "position part .* up to 1e\\+38, .* does not: use another"),
        (changed(position=np.full((1, 8), "a")), "position part .* real numbers .* <U1"),
        (
            changed(orientation=np.ones((1, 12, 3), dtype=complex)),
            "orientation part .* real numbers .* complex128 .* set orientation=false",
        ),
        (lambda: np.ones(8), "describe\\(\\) returns, got ndarray"),
    ],
)
def test_a_bad_description_is_one_sentence_and_changes_nothing(frame, says):
    mapper = IncrementalMapper(WORLD)
    mapper.add(FRAMES[0])
    with pytest.raises(AnalyticError, match=says):
        mapper.add(frame())
    assert len(mapper) == 1
    assert len(mapper.events) == 2


def test_an_orientation_part_that_is_not_used_is_not_checked():
    mapper = IncrementalMapper(WORLD, orientation=False)
    mapper.add(replace(FRAMES[1], orientation=np.ones((1, 12, 3), dtype=complex)))
    assert len(mapper) == 1


@pytest.mark.parametrize(
    ("parameters", "says"),
    [
        ({"version": 3}, "version must be 1 or 2, got 3"),
        ({"gamma": 0}, "gamma must be a number above 0, got 0"),
        ({"omgea": 2}, "unknown key omgea: did you mean 'omega'"),
        ({"distance": "cosin"}, "unknown distance 'cosin': did you mean 'cosine'"),
        ({"shrinkage": 0.0}, "shrinkage must be ledoit_wolf, or a share above 0, up to 1, got 0.0"),
        ({"held_out": 1.0}, "held_out must be a number between 0 and 1"),
        ({"held_out": 0.1}, "holds out 1: at least two"),
        ({"exemplars": 1}, "exemplars must be a whole number from 2 to 10 million, or null, got 1"),
        ({"new_node": 5}, "new_node=5 is less than smallest_node=10"),
        ({"checked_unassigned": 25}, "checked_unassigned=25 is more than checked_window=20"),
    ],
)
def test_a_parameter_out_of_range_is_one_sentence(parameters, says):
    with pytest.raises(AnalyticError, match=says):
        IncrementalMapper(WORLD, **parameters)


def test_other_mistakes():
    with pytest.raises(AnalyticError, match="no node yet after 0 frames"):
        mapped(0).locate(FRAMES[0])
    with pytest.raises(AnalyticError, match=r"takes a descriptor, like .*, got 'hog'"):
        IncrementalMapper("hog")
    mapper, night = mapped(20), WORLD.at(POSES[:12])
    for call, says in (
        (lambda: mapper.add(FRAMES[0], frame=object()), "plain values, lists or objects"),
        (lambda: mapper.maintain(3, night), r"no node 3: it has \[0\]"),
        (lambda: mapper.maintain([0], night), r"no node \[0\]: it has \[0\]"),
        (lambda: mapper.maintain(0, WORLD.at(POSES[:4])), "needs smallest_node=10 images or more, got 4"),
        (lambda: mapper.maintain(0, night, frames=[1, 2]), "12 images need as many frames, got 2"),
    ):
        with pytest.raises(AnalyticError, match=says):
            call()
    assert len(mapper) == 20
    assert mapper.maintain(np.int64(0), night).node == 0
