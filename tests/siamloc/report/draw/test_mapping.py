from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from PIL import Image

from benchmarks import sweeps
from siamloc import evaluation, maps
from siamloc.data.frames import FrameTable
from siamloc.errors import FormatError
from siamloc.maps import VisualMap
from siamloc.report.draw import film, growth, nodes, save_all
from siamloc.report.draw.look import INK
from siamloc.report.draw.node_colours import POOL, ink, neighbouring, node_colours
from siamloc.report.draw.nodes import NodePlan, node_plan, nodes_on_plan, spread_out
from siamloc.results import read_rows
from tests.analytic.mapper.world import World, corridor_drive
from tests.siamloc.report.draw.looking import lines_of, text_of, whole_png


def mapped(folder: Path, way: str, unplaced: int = 0, **options: Any) -> tuple[Path, Path]:
    """Build and measure a small map, its first frames unplaced; return the folders of the results and of the layer."""
    world, drive = World(size=8, reach=5.0, seed=1), corridor_drive(260, seed=1)
    found = world.at(drive, noise=0.2, seed=1)
    x, y, theta = drive.T
    room = np.where(x > np.median(x), "CR-A", "KT-A")
    paths = np.array([f"{i}.jpeg" for i in range(len(x))])
    shown = np.where(np.arange(len(x)) < unplaced, np.nan, x)
    frames = FrameTable(path=paths, x=shown, y=y, theta=theta, room=room, sequence=np.full(len(x), "drive"))
    known = VisualMap(found.position, frames, world.identity, orientation=found.orientation).with_descriptor(world)
    layer, target = folder / "layer", folder / "results"
    built = maps.group(known, way, folder=layer, **options)
    evaluation.mapping(known, built).save(target, pictures=False)
    return target, layer


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[int, tuple[Path, Path]]:
    """Incremental maps of both versions."""
    folder = tmp_path_factory.mktemp("maps")
    return {v: mapped(folder / str(v), "incremental", version=v) for v in (1, 2)}


def read_plan(folder: Path) -> NodePlan:
    measures = json.loads((folder / "results.json").read_text())["measures"]
    return node_plan(measures["mapping"], read_rows(folder, "frames"), read_rows(folder, "nodes"))


def told(folders: tuple[Path, Path]) -> growth.Story:
    return growth.read_story(folders[1] / "events.jsonl", read_plan(folders[0]))


def plan(node: list[int], xy: np.ndarray | None = None, edges: tuple = (), closures: tuple = ()) -> NodePlan:
    labels = np.array(node)
    k = int(labels.max()) + 1
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 9, (len(labels), 2)) if xy is None else xy
    places = np.array([points[labels == i].mean(axis=0) for i in range(k)]).reshape(-1, 2)
    pairs = np.array(edges, dtype=np.int64).reshape(-1, 2)
    colours = node_colours(neighbouring(points, labels, pairs), range(k))
    return NodePlan(points, labels, places, pairs, np.array(closures, dtype=np.int64).reshape(-1, 2), 1.0, colours)


@pytest.mark.parametrize("version", [1, 2])
def test_all_pictures_of_an_incremental_map(runs: dict, version: int, monkeypatch: pytest.MonkeyPatch) -> None:
    target, layer = runs[version]
    monkeypatch.setattr(film, "PICTURES", 3)
    drawn = save_all(target, layer)
    assert [path.name for path in drawn] == ["nodes.png", "growth.gif"]
    assert {path.parent for path in drawn} == {target}
    assert whole_png(drawn[0])
    before = [path.read_bytes() for path in drawn]
    assert [path.read_bytes() for path in save_all(target, layer)] == before


def test_a_clustered_map_has_one_picture(tmp_path: Path) -> None:
    target, layer = mapped(tmp_path, "sample", nodes=7)
    assert [path.name for path in save_all(target, layer)] == ["nodes.png"]
    assert "7 nodes" in text_of(nodes_on_plan(read_plan(target)))


def test_frames_without_positions_are_not_drawn(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    target, layer = mapped(tmp_path / "some", "sample", nodes=30, unplaced=100)
    (layer / "events.jsonl").write_text("")
    assert [path.name for path in save_all(target, layer)] == ["nodes.png"], "no picture of how it grew"
    shown, frames = read_plan(target), read_rows(target, "frames")
    assert np.isnan(shown.places).any(), "some nodes have no position"
    np.testing.assert_array_equal(shown.xy[:, 0], frames["x"][100:])
    np.testing.assert_array_equal(shown.node, frames["node"][100:])
    ends = np.column_stack([np.arange(260), frames["closes_with"]])[100:]
    np.testing.assert_array_equal(shown.closures, ends[ends[:, 1] >= 100] - 100)
    assert not caplog.text
    target, layer = mapped(tmp_path / "none", "sample", nodes=30, unplaced=260)
    assert save_all(target, layer) == []


def test_the_plan_shows_what_was_measured(runs: dict) -> None:
    target, _ = runs[2]
    shown, measures = read_plan(target), json.loads((target / "results.json").read_text())["measures"]["mapping"]
    text = text_of(figure := nodes_on_plan(shown))
    lost, silhouette = measures["unassigned"]["frames"], measures["silhouette"]["with_unassigned"]
    assert f"silhouette {silhouette:.2f} (1: compact and far apart, 0: touching); frames in no node" in text
    assert f"{measures['nodes']} nodes, {260 - lost} frames" in text
    assert f"{lost} frames in no node ({100 * lost / 260:.1f} %)" in text
    assert f"{measures['closures']['right']} loop closures within 1 m" in text
    right, wrong = (axes_lines(figure, colour) for colour in (INK, nodes.WRONG))
    assert measures["closures"]["right"] in right
    assert wrong == [measures["closures"]["closures"] - measures["closures"]["right"]]
    dots = figure.axes[0].collections[1]
    known = shown.node[shown.node >= 0].tolist()
    expected = matplotlib.colors.to_rgba_array([shown.colours[node] for node in known])
    np.testing.assert_array_equal(dots.get_facecolors(), expected)
    np.testing.assert_array_equal(dots.get_offsets(), shown.xy[shown.node >= 0])


def axes_lines(figure, colour: str) -> list[int]:
    """Return how many lines each collection of lines of a colour has."""
    collections = figure.axes[0].findobj(matplotlib.collections.LineCollection)
    rgb = matplotlib.colors.to_rgb(colour)
    return [len(lines.get_segments()) for lines in collections if np.allclose(lines.get_colors()[:, :3], rgb)]


@pytest.mark.parametrize("seed", range(5))
def test_neighbouring_nodes_have_different_colours(seed: int) -> None:
    rng = np.random.default_rng(seed)
    seats = rng.uniform(0, 20, (60, 2))
    points = rng.uniform(0, 20, (3000, 2))
    labels = np.linalg.norm(points[:, None] - seats[None], axis=2).argmin(axis=1)
    pairs = neighbouring(points, labels)
    colours = node_colours(pairs, range(60))
    assert len(pairs) > 100
    assert set(colours.values()) <= set(POOL)
    assert all(colours[a] != colours[b] for a, b in pairs)


def test_names_are_readable_on_every_colour() -> None:
    assert (ink("#FFFFFF"), ink("#000000"), ink("#F0E442"), ink("#332288")) == ("black", "white", "black", "white")


def test_neighbours_are_near_or_connected() -> None:
    xy = np.array([[0, 0], [0.5, 0], [9, 0], [20, 0], [0.2, 0.1]])
    assert neighbouring(xy, [0, 1, 2, 3, -1]) == {(0, 1)}
    assert neighbouring(xy, [0, 1, 2, 3, 4], [(3, 0)]) == {(0, 1), (0, 4), (1, 4), (0, 3)}
    assert neighbouring(np.empty((0, 2)), []) == set()


def test_dots_stand_side_by_side() -> None:
    rng = np.random.default_rng(0)
    crowd = rng.uniform(0, 3, (15, 2))
    crowd[1] = crowd[0]
    moved = spread_out(crowd, 0.5)
    distance = np.linalg.norm(moved[:, None] - moved[None], axis=2) + 9 * np.eye(15)
    assert distance.min() >= 0.5
    np.testing.assert_array_equal(spread_out(10 * np.eye(3)[:, :2], 0.5), 10 * np.eye(3)[:, :2])


def test_the_legend_counts_what_is_drawn() -> None:
    text = text_of(nodes_on_plan(plan([0] * 6)))
    assert "1 node, 6 frames" in text
    assert "0 ways between nodes" in text
    assert "loop closure" not in text
    assert "no node" not in text
    xy = np.array([[0, 0], [5, 5], [0.5, 0.5], [9, 0]])
    shown = plan([0, 0, 0, -1], xy, closures=((2, 0), (2, 1)))
    assert shown.right.tolist() == [True, False]
    text = text_of(nodes_on_plan(shown))
    for words in ("1 loop closure within 1 m", "1 loop closure beyond 1 m", "1 frame in no node (25.0 %)"):
        assert words in text


@pytest.mark.parametrize("extent", [(2, 40), (40, 2)])
def test_the_legend_fits_tall_and_wide_plans(extent: tuple[float, float]) -> None:
    xy = np.random.default_rng(0).uniform(0, 1, (90, 2)) * extent
    far = [(np.linalg.norm(xy - xy[i], axis=1).argmax(), i) for i in range(20)]
    figure = nodes_on_plan(plan([0] * 60 + [-1] * 30, xy, closures=((3, 3), *far)))
    figure.canvas.draw()
    assert len(figure.legends[0].get_texts()) == 5
    box = figure.legends[0].get_window_extent()
    assert 0 < box.x0 < box.x1 < figure.bbox.width


@pytest.mark.parametrize("axis", [0, 1])
def test_a_corridor_is_drawn_along_its_line(axis: int) -> None:
    xy = np.zeros((12, 2))
    xy[:, axis] = np.arange(12)
    figure = nodes_on_plan(plan([0] * 4 + [-1] * 4 + [1] * 4, xy, edges=((0, 1),)))
    axes = figure.axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == (f"{'xy'[axis]} [m]", "node")
    np.testing.assert_array_equal(axes.collections[1].get_offsets()[:, 1], [0] * 4 + [1] * 4)


def test_the_animation_is_short_and_ends_with_the_map(
    runs: dict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(film, "PICTURES", 8)
    story = told(runs[2])
    path = growth.animate(story, tmp_path / "growth.gif")
    assert path.stat().st_size < 3e6 * 8 / 80
    with Image.open(path) as picture:
        assert picture.n_frames == 8
        held = []
        for number in range(picture.n_frames):
            picture.seek(number)
            held.append(picture.info["duration"])
        last = {tuple(colour) for colour in np.unique(np.asarray(picture.convert("RGB")).reshape(-1, 3), axis=0)}
    assert held[-1] >= 2000 > 10 * max(held[:-1])
    wanted = {story.plan.colours[number] for number in range(len(story.ids))}
    assert {tuple(int(colour[i : i + 2], 16) for i in (1, 3, 5)) for colour in wanted} <= last
    assert list(tmp_path.iterdir()) == [path]


def test_pictures_are_60_to_100_whatever_the_length() -> None:
    for events in (100, 633, 20_000):
        taken = film.moments(events)
        assert 60 <= len(taken) <= 100
        assert (taken[0], taken[-1]) == (1, events)
    assert film.moments(3) == [1, 2, 3]


def test_errors(runs: dict, tmp_path: Path) -> None:
    target, layer = runs[2]
    measures = json.loads((target / "results.json").read_text())["measures"]["mapping"]
    frames = read_rows(target, "frames")
    with pytest.raises(FormatError, match=r"a whole evaluation of a compact map \(x is missing\)"):
        node_plan(measures, frames, {})
    lines = (layer / "events.jsonl").read_text().splitlines(keepends=True)
    (tmp_path / "short.jsonl").write_text("".join(lines[:-1]))
    with pytest.raises(FormatError, match="another map"):
        growth.read_story(tmp_path / "short.jsonl", read_plan(target))
    (tmp_path / "cut.jsonl").write_text("".join(lines)[:-20])
    with pytest.raises(FormatError, match="not the whole log"):
        growth.read_story(tmp_path / "cut.jsonl", read_plan(target))


def test_heat_maps() -> None:
    rows = [
        {"version": version, "y": y, "omega": omega, "nodes": 10 * version, "silhouette": y / omega}
        for version in (1, 2)
        for y in (0.75, 1.5)
        for omega in (1.7, 2.0, 2.3)
    ]
    rows[0]["silhouette"] = None
    figure = sweeps.heat_maps(rows, ("nodes", "silhouette"))
    panels = [axes for axes in figure.axes if axes.images and axes.get_label() != "<colorbar>"]
    assert len(panels) == 4
    np.testing.assert_array_equal(panels[0].images[0].get_array(), np.full((2, 3), 10))
    grid = panels[1].images[0].get_array()
    assert grid.mask.tolist() == [[True, False, False], [False] * 3]
    assert grid[1, 0] == 1.5 / 1.7
    (frame,) = [patch for patch in panels[1].patches if not patch.get_fill()]
    assert frame.get_xy() == (-0.5, 0.5)
    assert "0.88" in text_of(figure)


def test_silhouette_against_clusters() -> None:
    rows = [
        {"method": method, "nodes": nodes, "silhouette": nodes / 100, "nearest": -nodes / 100, "pooled": 1}
        for method in ("spectral", "som")
        for nodes in (20, 5, 10)
    ]
    point = {"version": 2, "nodes": 12, "silhouette": 0.5, "nearest": 0.1, "pooled": 1, "unassigned": 3.4}
    figure = sweeps.silhouette_against_clusters(rows, [point])
    lines = lines_of(figure)
    assert lines["spectral"] == [[5, 0.05], [10, 0.1], [20, 0.2]]
    assert lines["incremental, version 2 (3 % of frames left out)"] == [[12, 0.5]]
    np.testing.assert_array_equal(figure.axes[1].lines[1].get_xydata()[:, 1], [-0.05, -0.1, -0.2])
