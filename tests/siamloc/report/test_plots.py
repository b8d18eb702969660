from __future__ import annotations

import sys
from pathlib import Path

import cv2
import matplotlib
import numpy as np
import pytest

from siamloc.data.frames import FrameTable
from siamloc.errors import DataError, FormatError
from siamloc.evaluation.absolute import evaluate_absolute
from siamloc.evaluation.room_retrieval import evaluate_rooms
from siamloc.maps import VisualMap
from siamloc.report import plots
from siamloc.report.floor_plan import is_line
from siamloc.results import write_results
from tests.siamloc.evaluation import scenes

ALL = ["floor_plan.png", "error_curve.png", "confusion.png", "confusion_by_lighting.png"]


def write(folder: Path, known: VisualMap, queries: FrameTable, descriptors: np.ndarray, rooms: bool = True) -> None:
    result = evaluate_absolute(known, descriptors, queries)
    result = result.with_baseline("thumb_nail", evaluate_absolute(known, descriptors[::-1], queries))
    measures = {"absolute": result.measures()}
    if rooms:
        measures["room_retrieval"] = evaluate_rooms(known, descriptors, queries).measures()
    write_results(
        folder,
        {"config": {}, "measures": measures, "denominators": result.denominators()},
        result.columns,
        {"map": result.map_columns},
    )


def building(folder: Path, **columns: object) -> None:
    queries = scenes.frames(2, 60, **columns)
    write(folder, scenes.visual_map(), queries, scenes.describe(queries, noise=1))


def corridor(axis: str = "x", n: int = 111) -> FrameTable:
    along = {"x": np.zeros(n), "y": np.zeros(n), axis: np.arange(float(n))}
    return FrameTable(path=np.array([f"{i}.jpg" for i in range(n)]), **along)


def whole_png(path: Path) -> bool:
    contents = path.read_bytes()
    picture = cv2.imdecode(np.frombuffer(contents, np.uint8), cv2.IMREAD_COLOR)
    ends_well = contents.startswith(b"\x89PNG") and contents.endswith(b"IEND\xaeB`\x82")
    return ends_well and picture is not None and picture.std() > 10


def text_of(figure) -> str:
    """Return all the words in a figure."""
    return "\n".join(text.get_text() for text in figure.findobj(matplotlib.text.Text))


def test_all_pictures_are_made_from_the_files_alone(tmp_path: Path) -> None:
    building(tmp_path / "run")
    drawn = plots.draw_all(tmp_path / "run")
    assert [path.name for path in drawn] == ALL
    assert all(whole_png(path) for path in drawn)
    again = plots.draw_all(tmp_path / "run", tmp_path / "again")
    for first, second in zip(drawn, again, strict=True):
        assert second.parent == tmp_path / "again"
        assert first.read_bytes() == second.read_bytes()


def test_a_picture_has_150_dots_per_inch(tmp_path: Path) -> None:
    figure = plots.confusion_matrix(["a"], np.array([[1]]))
    picture = cv2.imread(str(plots.save(figure, tmp_path / "a.png")))
    np.testing.assert_allclose(picture.shape[1::-1], 150 * figure.get_size_inches(), atol=1)


def test_no_room_labels_and_one_lighting(tmp_path: Path) -> None:
    queries = scenes.frames(2, 30, lighting=np.array([""] * 30))
    write(tmp_path, scenes.visual_map(), queries, scenes.describe(queries), rooms=False)
    assert [path.name for path in plots.draw_all(tmp_path)] == ALL[:2]


def test_rooms_alone(tmp_path: Path) -> None:
    queries = scenes.frames(2, 30)
    measures = {"room_retrieval": evaluate_rooms(scenes.visual_map(), scenes.describe(queries), queries).measures()}
    write_results(tmp_path, {"config": {}, "measures": measures, "denominators": {}})
    assert [path.name for path in plots.draw_all(tmp_path)] == ALL[2:]


def test_a_panel_per_lighting() -> None:
    queries = scenes.frames(2, 60)
    result = evaluate_absolute(scenes.visual_map(), scenes.describe(queries), queries)
    figure = plots.floor_plan(result.columns, result.map_columns, "m")
    panels = [axes for axes in figure.axes if axes.get_aspect() == 1.0]
    mean = result.measures()["lighting"]["night"]["error"]["mean"]
    count = int((queries.lighting == "night").sum())
    assert [axes.get_title().split(":")[0] for axes in panels] == ["cloudy", "night", "sunny"]
    assert panels[1].get_title() == f"night: {count} queries, mean error {mean:.2f} m"
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
    result = evaluate_absolute(VisualMap(descriptors, frames, unit="frames"), descriptors[::-1], frames)
    assert is_line(result.columns, result.map_columns)
    figure = plots.floor_plan(result.columns, result.map_columns, "frames")
    assert {axes.get_ylabel() for axes in figure.axes} == {f"estimated {axis} [frames]", "error [frames]"}
    np.testing.assert_array_equal(figure.axes[0].collections[0].get_offsets(), [[i, 110 - i] for i in range(111)])


def test_a_building_is_no_line() -> None:
    queries = scenes.frames(2, 60)
    result = evaluate_absolute(scenes.visual_map(), scenes.describe(queries), queries)
    assert not is_line(result.columns, result.map_columns)


def test_the_curve_rises_to_all_queries() -> None:
    columns = {
        "error": np.array([0.5, 0.1, 0.9, 0.1]),
        "floor": np.full(4, 0.1),
        "lighting": np.array(["night", "dusk", "night", "dusk"]),
        "baseline_hog": np.array([2.0, 2, 2, 2]),
    }
    figure = plots.error_curve(columns, "m")
    lines = {line.get_label().split(":")[0]: line for line in figure.axes[0].lines}
    assert list(lines) == ["all queries", "dusk", "night", "hog", "floor"]
    assert lines["all queries"].get_label() == "all queries: 0.40 m, 4"
    np.testing.assert_array_equal(
        lines["all queries"].get_xydata()[:-1], [[0, 0], [0.1, 25], [0.1, 50], [0.5, 75], [0.9, 100]]
    )
    assert figure.axes[0].get_xlim() == (0, 1)
    assert lines["floor"].get_linestyle() == "--"


def test_a_query_set_without_any_error() -> None:
    columns = {"error": np.zeros(3), "floor": np.zeros(3), "lighting": np.array([""] * 3)}
    figure = plots.error_curve(columns)
    assert figure.axes[0].get_xlim()[1] > 0
    place = {name: np.zeros(3) for name in ("x", "y", "est_x", "est_y")}
    plan = plots.floor_plan({**columns, **place}, {"x": np.zeros(1), "y": np.zeros(1), "room": np.array([""])})
    assert "3 queries, mean error 0.00 m" in text_of(plan)


def test_a_confusion_matrix_shows_shares_and_counts() -> None:
    figure = plots.confusion_matrix(["KT-A", "LO-A", "TL-A"], np.array([[3, 1, 0], [0, 0, 0], [0, 400, 1]]), ["LO-A"])
    text = text_of(figure)
    for words in ("75 %\n3", "25 %\n1", "99.8 %\n400", "0.2 %\n1", "KT-A  (n = 4)", "LO-A  (n = 0)\n(not in map)"):
        assert words in text


def test_a_crowded_confusion_matrix_shows_shares_only() -> None:
    text = text_of(plots.confusion_matrix([f"room {i}" for i in range(20)], 7 * np.eye(20, dtype=int)))
    assert "100" in text
    assert "%\n" not in text


def test_colours_belong_to_lightings() -> None:
    assert plots.lighting_colours(["sunny", "dusk"])[0] == plots.lighting_colours(["cloudy", "sunny"])[1]
    colours = plots.lighting_colours(["cloudy", "night", "sunny", "dusk", "dawn"])
    assert len(set(colours)) == 5


def test_drawing_leaves_the_users_settings_alone() -> None:
    before = dict(matplotlib.rcParams)
    plots.confusion_matrix(["a"], np.array([[1]]))
    assert dict(matplotlib.rcParams) == before
    assert "matplotlib.pyplot" not in sys.modules or not matplotlib.pyplot.get_fignums()


def test_errors(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="does not exist"):
        plots.draw_all(tmp_path)
    with pytest.raises(DataError, match="nothing to draw"):
        plots.error_curve({"error": np.empty(0)})
    with pytest.raises(DataError, match=r"2 rooms needs counts of shape \(2, 2\), got \(1, 1\)"):
        plots.confusion_matrix(["a", "b"], np.array([[1]]))
    with pytest.raises(DataError, match="of 0 rooms"):
        plots.confusion_matrix([], np.empty((0, 0)))
