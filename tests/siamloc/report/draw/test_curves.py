"""What is drawn from measures alone: confusion matrices, and curves against a setting."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from matplotlib.colors import to_rgb

from siamloc.errors import ConfigError, DataError
from siamloc.report.draw.curves import compact_curves, pair_curves, robustness_curves, swept_curves
from siamloc.report.draw.errors import calibration_curve, node_errors
from siamloc.report.draw.look import save
from siamloc.report.draw.rooms import confusion
from siamloc.results import read_results
from tests.siamloc.report.draw.looking import lines_of, text_of


def measures(full: Path, folder: str = "network") -> dict:
    return read_results(full / "evaluation" / folder)["measures"]


def test_a_confusion_matrix_shows_shares_and_counts() -> None:
    counts = np.array([[3, 1, 0], [0, 0, 0], [0, 400, 1]])
    figure = confusion(["KT-A", "LO-A", "TL-A"], {"all queries": counts}, ["LO-A"])
    text = text_of(figure)
    for words in ("75 %\n3", "25 %\n1", "99.8 %\n400", "0.2 %\n1", "KT-A  (n = 4)", "LO-A\n(not in map)  (n = 0)"):
        assert words in text
    assert "1.0 % of 405 right" in text


@pytest.mark.parametrize("titles", [["all queries"], ["cloudy", "night"]])
@pytest.mark.parametrize("name", ["lab", "\N{HANGUL SYLLABLE GA}" * 28, "long" * 38])
def test_long_names_leave_a_confusion_matrix_its_size(name: str, titles: list[str], tmp_path: Path) -> None:
    figure = confusion([name, "kitchen", "hall"], dict.fromkeys(titles, np.eye(3, dtype=int)))
    save(figure, tmp_path / "confusion.png")
    for axes in figure.axes:
        assert axes.get_window_extent().width / figure.dpi > 1.2
    assert figure.axes[0].yaxis.label.get_window_extent().x0 >= 0


def test_a_crowded_confusion_matrix_shows_shares_only() -> None:
    text = text_of(confusion([f"room {i}" for i in range(30)], {"night": 7 * np.eye(30, dtype=int)}))
    assert "100" in text
    assert "%\n" not in text


def test_a_matrix_for_each_lighting_with_its_accuracy(full: Path) -> None:
    rooms = measures(full)["room_retrieval"]
    labels, counts = rooms["confusion"]["labels"], rooms["confusion"]["lighting"]
    figure = confusion(labels, counts)
    for axes, (label, group) in zip(figure.axes, rooms["lighting"].items(), strict=True):
        assert axes.get_title("left") == f"{label}\n{100 * group['accuracy']:.1f} % of {group['queries']} right"
        drawn = np.zeros((len(labels), len(labels)))
        for patch in axes.patches:
            if patch.get_fill():
                drawn[round(patch.get_y() + 0.5), round(patch.get_x() + 0.5)] = patch.get_alpha()
        part = np.array(counts[label])
        shares = part / part.sum(axis=1, keepdims=True)
        np.testing.assert_allclose(drawn, np.where(part, np.maximum(shares, 0.02), 0))


def test_pair_curves_by_lighting_pass_the_measured_accuracy(full: Path) -> None:
    pairs = measures(full)["room_pairs"]
    figure = pair_curves(pairs)
    titles = [axes.get_title("left").split(",")[0] for axes in figure.axes]
    assert titles == ["all pairs", "cloudy", "cloudy and night", "night"]
    for axes, group in zip(figure.axes, (pairs["overall"], *pairs["lighting"].values()), strict=True):
        assert axes.get_title("left").endswith(f"AUC {group['auc']:.3f}")
        lines = {line.get_label(): dict(line.get_xydata().tolist()) for line in axes.lines}
        for name, label in (("same", "pairs of one room"), ("overall", "all pairs")):
            assert lines[label][0.5] == pytest.approx(100 * group[name])
    one = {**pairs, "lighting": {"night": pairs["lighting"]["night"]}}
    single = pair_curves(one)
    assert len(single.axes) == 1, "one lighting is drawn once"
    single.rendered("png")
    legend = single.legends[0].get_window_extent()
    assert single.bbox.x0 <= legend.x0 < legend.x1 <= single.bbox.x1, "the legend is whole"


def test_the_calibration_curve_holds_every_point(full: Path) -> None:
    found = measures(full)["calibration"]
    lines = lines_of(calibration_curve(found))
    assert list(lines) == ["cloudy", "night", "sunny", "all queries", "equal"]
    expected = [[point["predicted"], point["observed"]] for point in found["overall"]["curve"]]
    np.testing.assert_allclose(lines["all queries"], expected)


def test_the_errors_of_a_hierarchy(full: Path) -> None:
    found = measures(full, "hierarchical-network-rooms")["hierarchical"]
    figure = node_errors(found)
    assert lines_of(figure)["wrong node"][-1] == [found["overall"]["given_wrong"]["error"]["mean"], 3]
    labels = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    assert labels == ["cloudy", "night", "sunny", "all queries"]
    for group in (found["overall"], *found["lighting"].values()):
        group["given_wrong"]["error"] = {"mean": None}
    assert "wrong node" not in text_of(node_errors(found)), "what no query has is not in the legend"


def test_errors_of_a_hierarchy_that_coincide_are_all_visible() -> None:
    one = {"mean": 0.3}
    within = {key: {"error": one} for key in ("absolute", "perfect_coarse", "given_right", "given_wrong")}
    figure = node_errors({"unit": "m", "lighting": {}, "overall": {**within, "floor": one, "error": one}})
    (axes,) = figure.axes
    colours = {line.get_label(): to_rgb(line.get_color()) for line in axes.lines[1:]}
    figure.legends[0].remove()
    picture = cv2.imdecode(np.frombuffer(figure.rendered("png", dpi=150), np.uint8), cv2.IMREAD_COLOR)[:, :, ::-1]
    for label, colour in colours.items():
        shown = np.abs(picture - 255 * np.array(colour)).max(axis=2) < 8
        assert shown.sum() > 12, label
    assert len(colours) == 6


def test_each_way_of_a_compact_map_has_its_own_floor() -> None:
    curves = [
        {"way": way, "nodes": nodes, "floor": 1 / nodes, "silhouette": 0, "descriptor_silhouette": 0, "search_ms": 1}
        | {"error": {"mean": 1.0}, "error_frames": {"mean": 0.9}}
        for way in ("spectral", "sample")
        for nodes in (5, 10, 20)
    ]
    figure = compact_curves({"curves": curves, "unit": "m"})
    floors = [line for line in figure.axes[0].lines if "floor" in str(line.get_label())]
    assert len({line.get_color() for line in floors}) == len({line.get_label() for line in floors}) == 2
    for axes in figure.axes:
        assert {5, 10, 15, 20} <= set(axes.get_xticks())


def test_robustness_curves_hold_every_level(full: Path) -> None:
    found = measures(full, "robustness-network")["robustness"]
    figure = robustness_curves(found)
    titles = [axes.get_title("left") for axes in figure.axes if axes.get_title("left")]
    assert titles == ["noise", "occlusion", "turn", "effect: bulb"]
    lines = lines_of(figure, 1)
    assert list(lines)[:2] == ["network, mean", "network, median"]
    assert "thumb nail, mean" in lines
    entries = found["methods"]["network"]["occlusion"]
    expected = [[100 * entry["level"], entry["mean"]] for entry in entries]
    np.testing.assert_allclose(lines["network, mean"], expected)
    highest = max(height for line in lines.values() for _, height in line)
    assert figure.axes[1].get_ylim()[1] > highest, "medians above all means are in the picture, too"
    noise = figure.axes[0]
    places = noise.transData.transform([(0, 0), (0.01, 0), (0.05, 0)])[:, 0]
    assert (places[1] - places[0]) / (places[2] - places[0]) == pytest.approx(0.2**0.5), "levels by their deviations"


ROWS = [
    {"distance": distance, "seed": seed, "bins": bins, "error": bins / 10 + seed + len(distance)}
    for distance in ("cosine", "correlation")
    for seed in (0, 1)
    for bins in (32, 8, 4)
]


def test_a_line_for_each_combination_against_the_first_setting_with_numbers_that_is_no_seed():
    figure = swept_curves(ROWS, ["distance", "seed", "bins"], "error")
    assert figure.axes[0].get_xlabel() == "bins"
    assert figure.axes[0].get_xscale() == "log"
    found = lines_of(figure)
    assert set(found) == {f"distance={d}, seed={s}" for d in ("cosine", "correlation") for s in (0, 1)} | {"best: 6.4"}
    assert found["distance=cosine, seed=1"] == [[4, 7.4], [8, 7.8], [32, 10.2]]
    assert found["best: 6.4"] == [[4, 6.4]]


def test_the_highest_may_be_the_best_and_another_setting_may_be_chosen():
    found = lines_of(swept_curves(ROWS, ["distance", "seed", "bins"], "error", "seed", highest=True))
    assert found["best: 15.2"] == [[1, 15.2]]
    equal = [{"bins": bins, "error": error} for bins, error in ((4, 0.3), (8, 0.4), (16, 0.3))]
    assert lines_of(swept_curves(equal, ["bins"], "error"))["best: 0.3"] == [[4, 0.3], [16, 0.3]]
    assert len(found) == 7


def test_texts_and_lists_are_put_side_by_side():
    rows = [{"ways": ["b"], "error": 1.0}, {"ways": None, "error": 2.0}, {"ways": ["a"], "error": float("nan")}]
    figure = swept_curves(rows, ["ways"], "error")
    assert [label.get_text() for label in figure.axes[0].get_xticklabels()] == ["['b']", "none"]


def test_names_are_points_without_lines_and_what_follows_from_them_is_left_out():
    rows = [
        {"descriptor": name, "distance": distance, "error": error}
        for name, distance, error in (("hog", "cosine", 0.5), ("hsv", "manhattan", 0.7), ("gist", "cosine", 0.9))
    ]
    figure = swept_curves(rows, ["descriptor", "distance"], "error", unit="m")
    (points, best) = figure.axes[0].lines
    assert points.get_xydata().tolist() == [[0, 0.9], [1, 0.5], [2, 0.7]]
    assert points.get_linestyle() == "None"
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [best.get_label()]
    assert figure.axes[0].get_ylabel() == "error [m] (lower is better)"
    rows += [{**row, "distance": "euclidean"} for row in rows]
    assert set(lines_of(swept_curves(rows, ["descriptor", "distance"], "error"))) > {"distance=euclidean"}


def test_many_long_names_are_turned_and_in_the_order_of_their_numbers():
    rows = [{"run": f"a-network-with-margin-{i}", "k": f"{i % 2 + 9} of them", "error": i} for i in range(30)]
    figure = swept_curves(rows, ["run", "k"], "error")
    (axes,), names = figure.axes, [row["run"] for row in rows]
    figure.draw_without_rendering()
    assert [label.get_text() for label in axes.get_xticklabels()] == names
    assert {label.get_rotation() for label in axes.get_xticklabels()} == {45}
    assert all(figure.bbox.x0 <= label.get_window_extent().x0 for label in axes.get_xticklabels())
    assert axes.get_window_extent().height > 200
    figure = swept_curves([{**row, "run": f"{row['k']}, {row['run']}", "k": 0} for row in rows[:4]], ["run"], "error")
    assert [label.get_text()[:3] for label in figure.axes[0].get_xticklabels()] == ["9 o", "9 o", "10 ", "10 "]


def test_names_of_many_settings_are_wrapped_without_those_that_are_not_known():
    long = {f"a.setting.with.a.long.name.{i}": i for i in range(8)}
    rows = [{**long, "m": m, "seed": seed, "error": 1.0} for m in (None, 2) for seed in (0, 1)]
    figure = swept_curves(rows, [*long, "m", "seed"], "error", "seed")
    figure.draw_without_rendering()
    legend, (axes,) = figure.legends[0], figure.axes
    assert ["m=" in text.get_text() for text in legend.get_texts()] == [True, False, False]
    assert figure.bbox.x0 <= legend.get_window_extent().x0 < legend.get_window_extent().x1 <= figure.bbox.x1
    assert axes.get_window_extent().height > 200
    assert set(lines_of(swept_curves(rows, ["m", "seed"], "error", "seed"))) == {"m=2", "m=none", "best: 1"}


def test_a_long_logarithmic_axis_has_plain_numbers():
    rows = [{"bins": 2**i, "error": 1.0} for i in range(14)]
    figure = swept_curves(rows, ["bins"], "error")
    figure.rendered("png")  # the ticks are chosen when they are drawn
    assert "1000" in text_of(figure)
    assert "$" not in text_of(figure)


def test_there_has_to_be_something_to_draw():
    for rows, settings in ((ROWS, []), ([{"bins": 1, "error": float("nan")}], ["bins"])):
        with pytest.raises(DataError, match="nothing to draw"):
            swept_curves(rows, settings, "error")
    with pytest.raises(ConfigError, match="did you mean 'bins'"):
        swept_curves(ROWS, ["bins", "seed"], "error", "bin")
