from __future__ import annotations

import logging
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
import pytest

from siamloc.data.frames import FrameTable
from siamloc.evaluation import Result
from siamloc.maps import VisualMap
from siamloc.report.draw import pictures, save_all, suitable
from siamloc.report.draw.errors import compared_curves, error_curve, estimate_curve
from siamloc.report.draw.floor_plan import along, floor_plan
from siamloc.report.draw.look import Picture, style
from siamloc.report.draw.rooms import confusion
from siamloc.report.draw.training import training_curves
from siamloc.results import read_results, read_rows
from tests.siamloc.evaluation import scenes
from tests.siamloc.evaluation.scenes import evaluate_absolute, evaluate_rooms
from tests.siamloc.report import pages
from tests.siamloc.report.draw.looking import lines_of, text_of, whole_png

QUERIES = {
    "error": np.array([0.5, 0.1, 0.9, 0.1]),
    "floor": np.full(4, 0.1),
    "lighting": np.array(["night", "dusk", "night", "dusk"]),
}


def corridor(axis: str = "x", n: int = 111) -> FrameTable:
    along = {"x": np.zeros(n), "y": np.zeros(n), axis: np.arange(float(n))}
    return FrameTable(path=np.array([f"{i}.jpg" for i in range(n)]), **along)


def test_each_kind_of_result_has_its_pictures(full: Path) -> None:
    drawn = {folder: save_all(folder) for folder in (full / "evaluation").iterdir()}
    names = {folder.name: [path.stem for path in paths] for folder, paths in drawn.items()}
    estimates = ["filtered_curve", "interpolated_curve", "calibration"]
    assert names == {
        "network": ["floor_plan", "error_curve", *estimates, "confusion", "confusion_by_lighting", "pairs"],
        "hierarchical-network-rooms": ["floor_plan", "error_curve", "node_errors"],
        "robustness-network": ["robustness"],
    }
    assert all(whole_png(path) for paths in drawn.values() for path in paths)
    folder = full / "evaluation" / "robustness-network"
    first = drawn[folder][0].read_bytes()
    assert save_all(folder)[0].read_bytes() == first, "the same files give the same pictures"


def test_nothing_is_drawn_before_it_is_asked_for(full: Path) -> None:
    run = full / "evaluation" / "network"
    measures = read_results(run)["measures"]
    tables = {name: read_rows(run, name) for name in ("queries", "map")}
    made = pictures(measures, tables)
    assert next(iter(pictures(measures, {}))) == "calibration", "without tables there is less to draw"
    figure = made["calibration"]()
    assert isinstance(figure, Picture)
    assert figure._repr_png_().startswith(b"\x89PNG"), "notebooks show it"
    assert not made.keys() & {"nodes", "robustness"}


def test_no_room_labels_and_one_lighting_or_rooms_alone(tmp_path: Path) -> None:
    queries = scenes.frames(2, 30, lighting=np.array([""] * 30))
    dark = pages.write_evaluation(tmp_path / "dark", scenes.visual_map(), queries, rooms=False)
    assert [path.stem for path in save_all(dark)] == ["floor_plan", "error_curve"]
    queries = scenes.frames(2, 30)
    evaluate_rooms(scenes.visual_map(), scenes.describe(queries), queries).save(tmp_path, pictures=False)
    assert [path.stem for path in save_all(tmp_path)] == ["confusion", "confusion_by_lighting"]


def test_results_that_are_replaced_take_only_their_own_pictures_with_them(tmp_path: Path) -> None:
    queries = scenes.frames(2, 30)
    both = pages.write_evaluation(tmp_path / "both", scenes.visual_map(), queries)
    drawn = save_all(both)
    (both / "mine.png").write_bytes(b"")
    assert read_results(both)["pictures"] == sorted(path.name for path in drawn)
    rooms = evaluate_rooms(scenes.visual_map(), scenes.describe(queries), queries)
    rooms.save(both)
    assert {path.stem for path in both.glob("*.png")} == {"confusion", "confusion_by_lighting", "mine"}
    rooms.save(both, pictures=False)
    assert [path.stem for path in both.glob("*.png")] == ["mine"]
    for name in ("confusion.png", "growth.gif"):
        (both / name).write_bytes(b"")
    Result.load(both).save(both, pictures=False)
    assert {path.name for path in both.iterdir()} >= {"confusion.png", "growth.gif"}, "not drawn by siamloc"
    (both / "results.json").write_text("{")
    assert [path.stem for path in rooms.save(both)] == ["confusion", "confusion_by_lighting"]
    Result.load(both).save(both, pictures=False)
    assert {path.name for path in both.iterdir() if path.suffix in (".png", ".gif")} == {"mine.png", "growth.gif"}


@pytest.mark.parametrize("name", ["Lab $1_$", r"\$2", "_alt", "走廊"])
def test_names_are_drawn_as_they_are(name: str) -> None:
    figure = confusion([name], {name: [[1]]})
    assert figure.rendered("svg").decode().count(f">{name}") == 3  # the title and the label of both axes
    assert figure.rendered("png"), "without a warning, even if no font has the letters"
    figure = error_curve({**QUERIES, "lighting": np.array([name] * 4)})
    assert figure.axes[0].get_legend().get_texts()[0].get_text() == f"{name}: 0.40 m"


def test_a_picture_that_fails_costs_neither_the_measures_nor_other_pictures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise ValueError("cannot be drawn")

    queries = scenes.frames(2, 30)
    result = evaluate_absolute(scenes.visual_map(), scenes.describe(queries), queries)
    monkeypatch.setattr(suitable, "error_curve", fail)
    with pytest.raises(ValueError, match="cannot be drawn"):
        result.save(tmp_path)
    assert [path.name for path in tmp_path.glob("*.png")] == ["floor_plan.png"]
    assert Result.load(tmp_path).parts == result.parts
    result.save(tmp_path, pictures=False)
    assert not list(tmp_path.glob("*.png")), "also a picture that was drawn before the failing one is removed"


def test_a_panel_per_lighting() -> None:
    queries = scenes.frames(2, 60)
    result = evaluate_absolute(scenes.visual_map(), scenes.describe(queries), queries)
    assert along(result.columns, result.tables["map"]) is None
    figure = floor_plan(result.columns, result.tables["map"], "m")
    panels = [axes for axes in figure.axes if axes.get_aspect() == 1.0]
    mean = result.measures["lighting"]["night"]["error"]["mean"]
    count = int((queries.lighting == "night").sum())
    assert [axes.get_title("left").split(":")[0] for axes in panels] == ["cloudy", "night", "sunny"]
    assert panels[1].get_title("left") == f"night: {count} queries, mean error {mean:.2f} m"
    assert "error [m]" in text_of(figure)
    segments = panels[1].collections[1].get_segments()
    assert len(segments) == count
    rows = queries.lighting == "night"
    expected = {tuple(row) for row in np.column_stack([result.columns[n][rows] for n in ("x", "y", "est_x", "est_y")])}
    assert {tuple(segment.ravel()) for segment in segments} == expected


@pytest.mark.parametrize("axis", ["x", "y"])
def test_a_corridor_is_drawn_along_its_line(axis: str) -> None:
    frames = corridor(axis)
    descriptors = np.column_stack([frames.xy, np.ones(111)])
    result = evaluate_absolute(VisualMap(descriptors, replace(frames, unit="frames")), descriptors[::-1], frames)
    assert along(result.columns, result.tables["map"]) == axis
    figure = floor_plan(result.columns, result.tables["map"], "frames")
    assert {axes.get_ylabel() for axes in figure.axes} == {f"estimated {axis} [frames]", "error [frames]"}
    np.testing.assert_array_equal(figure.axes[0].collections[0].get_offsets(), [[i, 110 - i] for i in range(111)])


def test_the_curves_rise_to_all_queries() -> None:
    figure = error_curve({**QUERIES, "baseline_thumb_nail": np.full(4, 2.0)}, "m", "hog")
    titles = [axes.get_title("left") for axes in figure.axes]
    assert titles == ["hog by lighting", "methods, dusk, n = 2", "methods, night, n = 2"]
    lines = lines_of(figure)
    assert list(lines) == [
        "all queries: 0.40 m, n = 4",
        *(f"{name}, n = 2" for name in ("dusk: 0.10 m", "night: 0.70 m")),
        "floor: 0.10 m, n = 4",
    ]
    corners = [[0.1, 0], [0.1, 25], [0.1, 25], [0.1, 50], [0.5, 50], [0.5, 75], [0.9, 75], [0.9, 100]]
    assert lines["all queries: 0.40 m, n = 4"][:-1] == corners
    assert figure.axes[0].get_xlim()[1] == 1
    assert list(lines_of(figure, 2)) == ["hog: 0.70 m", "thumb nail: 2.00 m", "floor: 0.10 m"]


def test_every_corner_of_a_long_curve_lies_where_its_share_says() -> None:
    error = np.random.default_rng(0).gamma(2, 0.3, 2000)
    columns = {"error": error, "floor": 0 * error, "lighting": np.array(["night"] * 2000)}
    corners = error_curve(columns).axes[0].lines[0].get_xydata()[1:-1]
    assert len(corners) <= 120
    for at, share in corners:
        assert share == pytest.approx(100 * (error <= at).mean())


def test_another_estimate_and_several_evaluations() -> None:
    figure = estimate_curve({**QUERIES, "filtered_error": np.array([0.2, 0.1, 0.3, 0.1])}, "filtered")
    assert [axes.get_title("left") for axes in figure.axes] == ["dusk, n = 2", "night, n = 2"]
    assert next(iter(lines_of(figure, 1))) == "filtered: 0.25 m"
    assert figure.axes[0].get_xlim() == figure.axes[1].get_xlim()
    long = "network-hog-spectral, hierarchical over spectral nodes of hog"
    figure = compared_curves({"a": QUERIES, long: {**QUERIES, "error": QUERIES["error"] / 2, "floor": np.full(4, 0.2)}})
    assert [axes.get_title("left").split(",")[0] for axes in figure.axes] == ["all queries", "dusk", "night"]
    assert list(lines_of(figure)) == ["0.40 m", "0.20 m"], "floors that differ are not drawn"
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["a", long]
    figure.rendered("png")
    assert all(axes.get_position().width > 0.25 for axes in figure.axes), "long names leave the panels their width"


@pytest.mark.parametrize("count", [2, 24, 72])
def test_the_panels_keep_their_height_whatever_the_number_of_evaluations(count: int) -> None:
    figure = compared_curves({f"run {i}": QUERIES for i in range(count)})
    figure.draw_without_rendering()
    assert all(1.7 < axes.get_window_extent().height / figure.dpi < 3.3 for axes in figure.axes)


def test_a_query_set_without_any_error() -> None:
    columns = {"error": np.zeros(3), "floor": np.zeros(3), "lighting": np.array([""] * 3)}
    assert error_curve(columns).axes[0].get_xlim() == (0, 1)
    place = {name: np.zeros(3) for name in ("x", "y", "est_x", "est_y")}
    plan = floor_plan({**columns, **place}, {"x": np.zeros(1), "y": np.zeros(1), "room": np.array([""])})
    assert "3 queries, mean error 0.00 m" in text_of(plan)


def test_training_curves_leave_gaps() -> None:
    columns = {"epoch": np.arange(3.0), "val/loss": np.array([1.1, np.nan, 0.4]), "train/accuracy": np.full(3, 0.5)}
    figure = training_curves({**columns, "train/loss": np.array([0.9, 0.5, 0.25]), "train/empty": np.full(3, np.nan)})
    assert [axes.get_title("left") for axes in figure.axes] == ["loss", "accuracy"]
    labels = [line.get_label() for line in figure.axes[0].lines]
    assert labels == ["training, last 0.25", "validation, last 0.4"]
    assert np.isnan(figure.axes[0].lines[1].get_ydata()[1])
    assert figure.axes[1].get_ylim()[1] >= 1


def test_drawing_leaves_the_users_settings_alone() -> None:
    before = dict(matplotlib.rcParams)
    confusion(["a"], {"night": [[1]]}).rendered("png")
    assert dict(matplotlib.rcParams) == before
    assert "matplotlib.pyplot" not in sys.modules or not matplotlib.pyplot.get_fignums()
    log = logging.getLogger("matplotlib.font_manager")
    level, filters = log.level, [*log.filters]
    with matplotlib.rc_context(), warnings.catch_warnings():
        first, second = style(), style()
        for step in (first.__enter__, second.__enter__):
            step()
        for one in (first, second):  # as in two threads
            one.__exit__(None, None, None)
    assert (log.level, log.filters) == (level, filters)
