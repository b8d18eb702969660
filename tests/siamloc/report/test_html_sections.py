"""The parts about further estimates, nodes, disturbances, rooms by lighting and pairs agree with the result files."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from siamloc.files import read_json, write_json
from siamloc.report.html import write_report
from siamloc.results import read_results, read_rows
from tests.siamloc.report import pages, rich
from tests.siamloc.report.pages import Element, notes, report


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return rich.write_run(tmp_path_factory.mktemp("run") / "vgg16")


@pytest.fixture(scope="module")
def page(run: Path) -> Element:
    return pages.read_page(write_report([run], run / "report.html"))


def measures(run: Path, folder: str) -> dict:
    return read_results(run / "evaluation" / folder)["measures"]


def part(page: Element, name: str) -> Element:
    (found,) = [section for section in page.all("section") if section.attributes["class"].split()[-1] == name]
    return found


def rows(section: Element, table: str) -> dict[str, list[str]]:
    """Return the cells of a grid by the label of their row."""
    body = section.one("table", class_=table).one("tbody")
    return {row.one("th").text: [cell.text for cell in row.all("td")] for row in body.all("tr")}


def corners(path: Element) -> np.ndarray:
    return np.array([[float(v) for v in pair.split()] for pair in re.split("[ML]", path.attributes["d"])[1:]])


def test_each_kind_of_result_has_its_part(page: Element) -> None:
    articles = [article for article in page.all("article") if "data-evaluation" in article.attributes]
    names = [[section.attributes["class"] for section in article.all("section")] for article in articles]
    first = ["summary", "plan", "curves", "estimate filtered", "estimate interpolated", "expected", "worst", "rooms"]
    assert names == [
        [*first, "pair-curves"],
        ["summary", "hierarchical", "plan", "curves", "worst"],
        ["robustness"],
    ]
    titles = [article.one("h2").text for article in articles]
    assert titles == ["network", "network, hierarchical over spectral nodes of hog", "network, robustness"]
    compared = page.one("table", class_="comparison").one("tbody").all("tr")
    assert [row.one("a").text for row in compared] == titles[:2]
    assert not page.all("section", class_="further")


def test_a_plain_run_has_none_of_these_parts(tmp_path: Path) -> None:
    page = report(tmp_path, pages.write_run(tmp_path / "run"))
    found = {section.attributes["class"].split()[-1] for section in page.all("section")}
    assert found.isdisjoint({"filtered", "interpolated", "expected", "pair-curves", "hierarchical", "robustness"})


@pytest.mark.parametrize("name", ["filtered", "interpolated"])
def test_another_estimate_stands_beside_the_single_frame_one(run: Path, page: Element, name: str) -> None:
    found, section = measures(run, "network"), part(page, name)
    shown = rows(section, "estimate")
    for label, cells in shown.items():
        before, after = (
            found[key]["overall"] if label == "all" else found[key]["lighting"][label]
            for key in ("absolute", f"absolute_{name}")
        )
        expected = [f"{group['error'][k]:.3f}" for k in ("mean", "median", "p95") for group in (before, after)]
        assert cells[:6] == expected
        change = 100 * (after["error"]["mean"] / before["error"]["mean"] - 1)
        assert float(cells[6].removesuffix(" %").replace("−", "-")) == pytest.approx(change, abs=0.051)
        assert cells[-1] == str(before["queries"])
    assert list(shown) == ["cloudy", "night", "sunny", "all"]
    figures = section.all("figure")
    assert [figure.one("figcaption").text for figure in figures] == ["cloudy", "night", "sunny"]
    night = found[f"absolute_{name}"]["lighting"]["night"]
    assert f"{name} {night['error']['mean']:.3f} m, n = {night['queries']}" in figures[1].one("ul").text
    methods = [body.attributes["data-method"] for body in page.all("table", class_="by-lighting")[0].all("tbody")]
    assert methods == ["network", "network + filter", "network + interpolation"]


def test_the_filter_says_what_it_was_made_with(page: Element) -> None:
    text = part(page, "filtered").text
    assert "Temperature 0.02 (learned from the map), probability of being anywhere 0.001, 0.50 m driven" in text
    assert "3 map frames" in part(page, "interpolated").text


def test_the_calibration_curve_lies_where_expected_and_true_errors_say(run: Path, page: Element) -> None:
    found, section = measures(run, "network")["calibration"], part(page, "expected")
    svg = section.one("svg", class_="chart")
    ticks = [(float(t.attributes["x"]), float(t.text)) for t in svg.all("text", class_="tick")]
    across = [tick for tick in ticks if tick[0] != ticks[-1][0]]
    (x0, v0), (x1, v1) = across[0], across[-1]
    points = corners(svg.one("path", class_="ink"))
    expected = np.exp(np.log(v0) + (points[:, 0] - x0) / (x1 - x0) * np.log(v1 / v0))
    curve = found["overall"]["curve"]
    np.testing.assert_allclose(expected, [point["predicted"] for point in curve], rtol=0.01)
    marks = svg.all("circle") + svg.all("polygon")
    assert len(marks) == len(curve) + sum(len(group["curve"]) for group in found["lighting"].values())
    lost = found["overall"]["lost"]
    cells = rows(section, "calibration")["all"]
    assert cells[3:5] == [str(lost["called"]), str(lost["lost"])]
    assert cells[5] == (f"{100 * lost['precision']:.1f} %" if lost["precision"] is not None else "–")
    assert "learned on run3" in section.text


def test_the_nodes_table_and_picture(run: Path, page: Element) -> None:
    found, section = measures(run, "hierarchical-network-rooms")["hierarchical"], part(page, "hierarchical")
    shown = rows(section, "hierarchical")
    assert list(shown) == ["cloudy", "night", "sunny", "all"]
    for label, cells in shown.items():
        group = found["overall"] if label == "all" else found["lighting"][label]
        assert cells[0] == f"{group['error']['mean']:.3f}"
        assert cells[2] == f"{group['absolute']['error']['mean']:.3f}"
        assert cells[4] == f"{100 * group['coarse']['accuracy']:.1f} %"
        for cell, name in zip(cells[5:7], ("given_right", "given_wrong"), strict=True):
            assert cell.endswith(f"n = {group[name]['queries']}")
        assert cells[7] == f"{group['perfect_coarse']['error']['mean']:.3f}"
        assert cells[9:11] == [
            f"{group['comparisons']['mean']:.1f}",
            f"{100 * group['comparisons']['share']:.1f} %",
        ]
    titles = [title.text for title in section.one("svg", class_="dots").all("title")]
    wrong = found["overall"]["given_wrong"]["error"]["mean"]
    assert f"all, wrong node: {wrong:.3f}" in titles
    assert len(titles) >= 20
    article = page.all("article", **{"data-evaluation": "1"})[0]
    assert f"{100 * found['overall']['comparisons']['share']:.1f} %" in article.one("ul", class_="figures").text
    methods = [caption.text for caption in article.one("section", class_="curves").all("figcaption")]
    assert methods[1] == "methods, cloudy"
    assert "perfect nodes" in article.one("section", class_="curves").text


def test_an_error_that_no_query_has_is_a_dash(tmp_path: Path) -> None:
    run = rich.write_run(tmp_path / "run")
    path = run / "evaluation" / "hierarchical-network-rooms" / "results.json"
    results = read_json(path)
    for group in results["measures"]["hierarchical"]["lighting"].values():
        group["given_wrong"] = {"queries": 0, "error": dict.fromkeys(group["given_wrong"]["error"])}
    write_json(path, results)
    section = part(report(tmp_path, run), "hierarchical")
    assert rows(section, "hierarchical")["night"][6] == "– n = 0"
    assert not [t for t in section.all("title") if t.text.startswith("night, wrong")]


def test_the_robustness_tables_and_curves(run: Path, page: Element) -> None:
    found, section = measures(run, "robustness-network")["robustness"], part(page, "robustness")
    blocks = section.all("div", class_="disturbance")
    assert [block.one("h4").text for block in blocks] == ["Noise", "Occlusion", "Turn on the spot", "Effect: bulb"]
    labels = [list(rows(block, "levels")) for block in blocks]
    assert labels == [["0", "0.01", "0.05"], ["0 %", "5 %", "40 %"], ["0°", "45°", "180°"], ["0", "0.5", "1"]]
    for block, kind in zip(blocks, found["disturbances"], strict=True):
        for i, cells in enumerate(rows(block, "levels").values()):
            entries = [found["methods"][method][kind["name"]][i] for method in found["methods"]]
            assert cells == [f"{entry['mean']:.2f} {100 * entry['share']:.1f} %" for entry in entries]
        assert len(block.all("svg", class_="chart")) == 2
    error, share = blocks[1].all("svg", class_="chart")
    path = share.one("path", class_="ink")
    expected = [100 * entry["share"] for entry in found["methods"]["network"]["occlusion"]]
    top, bottom = (float(line.attributes["y1"]) for line in (share.all("line")[-1], share.all("line")[-6]))
    np.testing.assert_allclose(100 * (bottom - corners(path)[:, 1]) / (bottom - top), expected, atol=0.1)
    left, right = (float(share.all("text", class_="tick")[i].attributes["x"]) for i in (0, 4))
    np.testing.assert_allclose((corners(path)[:, 0] - left) / (right - left), [0, 0.125, 1], atol=0.002)
    assert len(error.all("path", class_="line")) == 5, "mean and median of two methods, and the floor"
    assert "60 queries, one in 5 of all" in section.text
    assert "thumb nail" in section.all("ul", class_="legend")[0].text


def test_noise_levels_stand_at_their_deviations(page: Element) -> None:
    svg = part(page, "robustness").all("svg", class_="chart")[1]
    ticks = {t.text: float(t.attributes["x"]) for t in svg.all("text", class_="tick")[:4]}
    assert list(ticks) == ["0", "0.005", "0.02", "0.05"]
    at = corners(svg.one("path", class_="ink"))[:, 0]
    share = (at - ticks["0"]) / (ticks["0.05"] - ticks["0"])
    np.testing.assert_allclose(share, np.sqrt([0, 0.2, 1]), atol=0.002)


def test_robustness_of_several_runs_is_compared(run: Path, tmp_path: Path) -> None:
    other = shutil.copytree(run, tmp_path / "other")
    page = report(tmp_path, run, other)
    section = page.all("section", class_="robustness")[0]
    assert section.one("h3").text == "Robustness compared"
    names = section.all("ul", class_="legend")[0].text
    assert "vgg16 · network" in names
    assert "other · network" in names
    path = other / "evaluation" / "robustness-network" / "results.json"
    results = read_json(path)
    results["measures"]["robustness"]["radius"] = 1.0
    write_json(path, results)
    assert "measured on different queries, maps or levels in these evaluations" in notes(report(tmp_path, run, other))
    strangers = rich.scenes.frames(9, 60), rich.scenes.frames(8, 40)
    rich.write_robustness(other / "evaluation" / "robustness-network", *strangers)
    assert "and is not compared" in notes(report(tmp_path, run, other)), "as many queries and frames, but others"


def test_confusion_matrices_by_lighting(run: Path, page: Element) -> None:
    found, section = measures(run, "network")["room_retrieval"]["confusion"], part(page, "rooms")
    shown = {block.attributes["data-under"]: block for block in section.all("div") if "data-under" in block.attributes}
    assert list(shown) == ["all", "cloudy", "night", "sunny"]
    for label, block in shown.items():
        counts = found["counts"] if label == "all" else found["lighting"][label]
        cells = [
            [int(cell.one("small").text) if cell.children else 0 for cell in row.all("td")]
            for row in block.one("table", class_="confusion").one("tbody").all("tr")
        ]
        assert cells == counts
        assert f"{np.trace(counts)} of {np.sum(counts)} queries" in block.text
    radios = section.all("input", type="radio")
    assert [radio.attributes["value"] for radio in radios] == list(shown)
    plan = page.all("section", class_="plan")[0].all("input", type="radio")
    assert {radio.attributes["name"] for radio in radios}.isdisjoint({radio.attributes["name"] for radio in plan})


def test_results_without_matrices_by_lighting_show_that_of_all(run: Path, tmp_path: Path) -> None:
    older = shutil.copytree(run, tmp_path / "older")
    path = older / "evaluation" / "network" / "results.json"
    results = read_json(path)
    del results["measures"]["room_retrieval"]["confusion"]["lighting"]
    for group in results["measures"]["room_pairs"]["lighting"].values():
        del group["curve"]
    write_json(path, results)
    page = report(tmp_path, older)
    assert len(page.all("table", class_="confusion")) == 1
    assert not part(page, "rooms").all("input", type="radio")
    assert [c.text for c in part(page, "pair-curves").all("figcaption")] == ["all pairs"]


def test_pairs_by_lighting(run: Path, page: Element) -> None:
    found, section = measures(run, "network")["room_pairs"], part(page, "pair-curves")
    shown = rows(section, "pair-shares")
    assert list(shown) == ["cloudy", "cloudy and night", "night", "all"]
    for label, cells in shown.items():
        group = found["overall"] if label == "all" else found["lighting"][label]
        shares = [f"{100 * group[name]:.1f} %" for name in ("same", "different", "overall")]
        assert cells == [*shares, f"{group['auc']:.3f}", str(group["n_same"]), str(group["n_different"])]
    figures = section.all("figure")
    assert [figure.one("figcaption").text for figure in figures] == ["all pairs", *list(shown)[:-1]]
    points = corners(figures[3].one("path", class_="ink"))
    overall = np.array([point["overall"] for point in found["lighting"]["night"]["curve"]])
    heights = points[:, 1]
    expected = heights.max() - (overall - overall.min()) / np.ptp(overall) * np.ptp(heights)
    np.testing.assert_allclose(heights, expected, atol=0.11)


def test_without_any_pose_the_page_says_so_in_one_sentence(tmp_path: Path) -> None:
    rich.write_located(tmp_path / "run" / "evaluation" / "hog")
    page = report(tmp_path, tmp_path / "run")
    assert notes(page) == (
        "No query has a true position to compare with: 7 queries were located, in located.csv, and none is scored."
    )
    assert [section.attributes["class"] for section in page.all("section")] == ["configuration"]
    assert not page.all("table", class_="summary")
    assert not page.all("ul", class_="figures")


def test_poses_of_some_queries_and_runs_without_any(run: Path, tmp_path: Path) -> None:
    folder = run / "evaluation" / "network"
    some = shutil.copytree(folder, tmp_path / "some")
    results = read_json(some / "results.json")
    results["tables"]["located"] = {"file": "located.csv", "rows": 1, "columns": {}}
    write_json(some / "results.json", results)
    rich.write_located(tmp_path / "none")
    page = report(tmp_path, some, tmp_path / "none")
    assert "Of 1 query the true position is unknown: located.csv says where they were found." in notes(page)
    assert "7 queries were located" in notes(page)
    assert len(page.all("table", class_="comparison")) == 0, "one of the two has nothing to compare"
    assert read_rows(some)["error"].size == 60
