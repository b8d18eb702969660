from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
import pytest

from siamloc.errors import DataError
from siamloc.report import plots, room_plots
from siamloc.results import read_results
from tests.siamloc.report import rich


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = rich.write_run(tmp_path_factory.mktemp("run"))
    return run / "evaluation" / "network"


def test_pictures_of_rooms_are_made_from_the_files(folder: Path) -> None:
    drawn = [path.name for path in plots.draw_all(folder)]
    assert drawn[2:] == ["confusion.png", "confusion_by_lighting.png", "pairs.png"]
    assert all((folder / name).read_bytes().startswith(b"\x89PNG") for name in drawn)


def test_a_matrix_for_each_lighting_with_its_accuracy(folder: Path) -> None:
    rooms = read_results(folder)["measures"]["room_retrieval"]
    counts = {label: np.array(part) for label, part in rooms["confusion"]["lighting"].items()}
    figure = room_plots.confusion_by_lighting(rooms["confusion"]["labels"], counts)
    panels = [axes for axes in figure.axes if axes.get_title()]
    for axes, (label, group) in zip(panels, rooms["lighting"].items(), strict=True):
        assert axes.get_title() == f"{label}: {100 * group['accuracy']:.1f} % of {group['queries']}"
        shares = axes.images[0].get_array()
        expected = 100 * counts[label] / counts[label].sum(axis=1, keepdims=True)
        np.testing.assert_allclose(shares, expected)


def test_pair_curves_by_lighting_pass_the_measured_accuracy(folder: Path) -> None:
    pairs = read_results(folder)["measures"]["room_pairs"]
    figure = room_plots.pair_curves(pairs)
    panels = [axes for axes in figure.axes if axes.get_title()]
    assert [axes.get_title().split(",")[0] for axes in panels] == ["all pairs", "cloudy", "cloudy and night", "night"]
    for axes, group in zip(panels, (pairs["overall"], *pairs["lighting"].values()), strict=True):
        assert axes.get_title().endswith(f"AUC {group['auc']:.3f}")
        lines = {line.get_label(): line for line in axes.lines}
        for name, label in (("same", "pairs of one room"), ("overall", "all pairs")):
            thresholds, shares = lines[label].get_data()
            assert shares[np.flatnonzero(thresholds == 0.5)[0]] == pytest.approx(100 * group[name])
    text = [words.get_text() for words in figure.findobj(matplotlib.text.Text)]
    assert "threshold of the dissimilarity" in text


def test_one_lighting_is_drawn_once(folder: Path) -> None:
    pairs = read_results(folder)["measures"]["room_pairs"]
    one = {**pairs, "lighting": {"night": pairs["lighting"]["night"]}}
    assert [axes.get_title().split(",")[0] for axes in room_plots.pair_curves(one).axes] == ["all pairs"]


def test_errors() -> None:
    with pytest.raises(DataError, match=r"2 rooms need counts of shape \(2, 2\) by lighting, got \[\(1, 1\)\]"):
        room_plots.confusion_by_lighting(["a", "b"], {"night": np.array([[1]])})
    with pytest.raises(DataError, match="of 0 rooms"):
        room_plots.confusion_by_lighting([], {})
