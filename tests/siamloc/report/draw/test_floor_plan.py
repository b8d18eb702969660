"""The map of a building behind the plans of a result."""

from __future__ import annotations

import math

import numpy as np
import pytest
from matplotlib.image import AxesImage

from siamloc.data import OccupancyMap
from siamloc.report.draw.floor_plan import floor_plan, surroundings
from siamloc.report.draw.nodes import NodePlan, nodes_on_plan

XY = np.array([[0.0, 0.0], [4.0, 1.0], [2.0, 3.0]])
OCCUPANCY = np.where(np.indices((60, 80)).sum(axis=0) % 7, 0, 1).astype(np.float32)


def known(heading: float = 0.0) -> OccupancyMap:
    """Return a map of 8 x 6 m, before it is turned, from (-2, -2)."""
    return OccupancyMap(OCCUPANCY, 0.1, (-2.0, -2.0, heading))


def drawn(occupancy: OccupancyMap | None) -> list:
    columns = dict(zip(("x", "y"), XY.T, strict=True))
    queries = {**columns, "est_x": XY[:, 0], "est_y": XY[:, 1], "error": np.zeros(3), "lighting": np.full(3, "night")}
    by_query = floor_plan(queries, {**columns, "room": np.full(3, "")}, occupancy=occupancy)
    links = np.array([[0, 1]])
    nodes = NodePlan(
        XY, np.array([0, 0, 1]), XY[[0, 2]], links, links[:0], 1.0, {0: "#c44e00", 1: "#0072b3"}, "m", "", occupancy
    )
    return [by_query.axes[0], nodes_on_plan(nodes).axes[0]]


def images(axes) -> list[AxesImage]:
    return [one for one in axes.get_children() if isinstance(one, AxesImage)]


def test_every_plan_has_the_building_behind_it() -> None:
    for axes in drawn(known()):
        (image,) = images(axes)
        assert image.get_zorder() < min(one.get_zorder() for one in axes.collections)
        corners = [image.get_transform().transform(corner) for corner in ((0, 0), (8, 6))]
        placed = axes.transData.inverted().transform(corners)
        np.testing.assert_allclose(placed, [[-2, -2], [6, 4]], atol=1e-6)
        (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
        assert left < -2 < 6 < right
        assert low < -2 < 4 < high
    assert not [one for axes in drawn(None) for one in images(axes)]


def test_a_very_long_name_of_a_room_is_cut_in_the_middle() -> None:
    columns = {"x": XY[:, 0], "y": XY[:, 1]}
    queries = {**columns, "est_x": XY[:, 0], "est_y": XY[:, 1], "error": np.zeros(3), "lighting": np.full(3, "night")}
    figure = floor_plan(queries, {**columns, "room": np.full(3, "begin" + "x" * 140 + "end")})
    (name,) = [text.get_text() for text in figure.axes[0].texts]
    assert len(name) == 40
    assert name.startswith("begin")
    assert name.endswith("end")
    alike = [f"{'x' * 30}{number}{'x' * 30}" for number in range(3)]
    figure = floor_plan(queries, {**columns, "room": np.array(alike)})
    assert [text.get_text() for text in figure.axes[0].texts] == alike, "names that differ in the middle stay whole"


def test_a_turned_map_is_turned_about_its_corner() -> None:
    axes = drawn(known(math.pi / 2))[0]
    (image,) = images(axes)
    far = axes.transData.inverted().transform(image.get_transform().transform((8, 6)))
    np.testing.assert_allclose(far, [-8, 6], atol=1e-6)


@pytest.mark.parametrize(("occupancy", "expected"), [(None, [[0, 0], [4, 3]]), (known(), [[-2, -2], [6, 4]])])
def test_what_a_plan_shows(occupancy, expected) -> None:
    np.testing.assert_allclose(surroundings(XY, occupancy), expected, atol=1e-6)
