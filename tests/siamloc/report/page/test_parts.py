"""The parts about further estimates, nodes, disturbances, rooms by lighting and pairs agree with the result files."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from foundation.files import read_json, write_json
from siamloc.data.frames import FrameTable
from siamloc.evaluation.building_choice import evaluate_buildings
from siamloc.report.page.write import write_report
from siamloc.results import read_results
from tests.siamloc.report import pages, rich
from tests.siamloc.report.draw.test_mapping import mapped
from tests.siamloc.report.pages import Element, report


@pytest.fixture(scope="module")
def page(full: Path) -> Element:
    return pages.read_page(write_report([full], full / "report.html"))


def measures(run: Path, folder: str) -> dict:
    return read_results(run / "evaluation" / folder)["measures"]


def part(page: Element, name: str) -> Element:
    (found,) = [section for section in page.all("section") if section.attributes["class"].split()[-1] == name]
    return found


def rows(section: Element, table: str) -> dict[str, list[str]]:
    """Return the cells of a grid by the label of their row."""
    body = section.one("table", class_=table).one("tbody")
    return {row.one("th").text: [cell.text for cell in row.all("td")] for row in body.all("tr")}


def words(section: Element) -> set[str]:
    """Return the texts in the figures of a part."""
    return {text.text.strip() for svg in section.all("svg") for text in svg.all("text")}


def test_each_kind_of_result_has_its_part(page: Element) -> None:
    articles = [article for article in page.all("article") if "data-evaluation" in article.attributes]
    names = [[section.attributes["class"] for section in article.all("section")] for article in articles]
    first = ["summary", "plan", "curves", "estimate filtered", "estimate interpolated", "expected", "worst", "rooms"]
    assert names == [[*first, "pair-curves"], ["summary", "hierarchical", "plan", "curves", "worst"], ["robustness"]]
    titles = [article.one("h2").text for article in articles]
    assert titles == ["network", "network, hierarchical over spectral nodes of hog", "network, robustness"]
    compared = page.one("table", class_="comparison").one("tbody").all("tr")
    assert [row.one("a").text for row in compared] == titles[:2]


@pytest.mark.parametrize("name", ["filtered", "interpolated"])
def test_another_estimate_stands_beside_the_single_frame_one(full: Path, page: Element, name: str) -> None:
    found, section = measures(full, "network"), part(page, name)
    night = found[f"absolute_{name}"]["lighting"]["night"]
    drawn = words(section)
    assert f"{name}: {night['error']['mean']:.2f} m" in drawn
    assert f"night, n = {night['queries']}" in drawn
    methods = [body.attributes["data-method"] for body in page.all("table", class_="errors")[0].all("tbody")]
    assert methods == ["network", "network + filter", "network + interpolation"]
    made = "Temperature 0.02 (learned from the map), probability of being anywhere 0.001, 0.50 m driven"
    assert {"filtered": made, "interpolated": "3 map frames"}[name] in section.text


def test_refined_errors_are_those_of_the_headline_the_worst_queries_and_the_comparison(
    full: Path, tmp_path: Path
) -> None:
    run = rich.write_refined(tmp_path / "run")
    page = report(tmp_path, run / "evaluation" / "network", full / "evaluation" / "network")
    figures = page.all("ul", class_="figures")[0]
    assert {"0.06 m", "mean error, refined"} <= {part.text for part in (*figures.all("b"), *figures.all("span"))}
    (first, second) = page.all("ol", class_="triples")[0].all("div", class_="head")[:2]
    assert (first.one("b").text, second.one("b").text) == ("0.50 m", "0.05 m")
    (refined, single) = rows(page.all("section", class_="compared")[0], "comparison").values()
    mean = measures(full, "network")["absolute"]["overall"]["error"]["mean"]
    assert {"refined", "0.057"} <= set(refined)
    assert {"single frame", f"{mean:.3f}"} <= set(single)


def test_expected_errors_are_those_of_the_results(full: Path, page: Element) -> None:
    found, section = measures(full, "network")["calibration"], part(page, "expected")
    assert {"cloudy", "night", "sunny", "all queries", "equal"} <= words(section)
    lost = found["overall"]["lost"]
    cells = rows(section, "calibration")["all"]
    assert cells[3:5] == [str(lost["called"]), str(lost["lost"])]
    assert cells[5] == (f"{100 * lost['precision']:.1f} %" if lost["precision"] is not None else "–")
    assert "learned on run3" in section.text


def test_the_nodes_table_and_picture(full: Path, page: Element) -> None:
    found, section = measures(full, "hierarchical-network-rooms")["hierarchical"], part(page, "hierarchical")
    shown = rows(section, "nodes")
    assert list(shown) == ["cloudy", "night", "sunny", "all"]
    for label, cells in shown.items():
        group = found["overall"] if label == "all" else found["lighting"][label]
        means = [group, *(group[key] for key in ("absolute", "perfect_coarse", "given_right", "given_wrong"))]
        coarse = group["coarse"]
        assert [cells[i] for i in (0, 1, 3, 4, 5)] == [f"{one['error']['mean']:.3f}" for one in means]
        assert cells[6] == f"{100 * coarse['accuracy']:.1f} % ({coarse['correct']}/{coarse['queries']})"
        assert cells[7] == f"{group['comparisons']['mean']:.1f}"
        assert cells[9] == f"{100 * group['comparisons']['share']:.1f} %"
    assert {"floor", "wrong node", "hierarchical", "all queries"} <= words(section)
    article = page.all("article", **{"data-evaluation": "1"})[0]
    assert f"{100 * found['overall']['comparisons']['share']:.1f} %" in article.one("ul", class_="figures").text
    assert any(text.startswith("perfect nodes: ") for text in words(article.one("section", class_="curves")))


def test_an_error_that_no_query_has_is_a_dash(full: Path, tmp_path: Path) -> None:
    nodes = shutil.copytree(full / "evaluation" / "hierarchical-network-rooms", tmp_path / "nodes")
    path = nodes / "results.json"
    results = read_json(path)
    for group in results["measures"]["hierarchical"]["lighting"].values():
        group["given_wrong"] = {"queries": 0, "error": dict.fromkeys(group["given_wrong"]["error"])}
    write_json(path, results)
    section = part(report(tmp_path, nodes), "hierarchical")
    assert rows(section, "nodes")["night"][5] == "–"


def test_the_robustness_tables_and_curves(full: Path, page: Element) -> None:
    found, section = measures(full, "robustness-network")["robustness"], part(page, "robustness")
    blocks = section.one("div", class_="disturbances").children
    assert [block.one("h4").text for block in blocks] == ["noise", "occlusion", "turn on the spot", "effect: bulb"]
    for block, kind in zip(blocks, found["disturbances"], strict=True):
        shown = iter(pages.rows_of(block.one("table", class_="robustness")))
        for method, curves in found["methods"].items():
            for entry in curves[kind["name"]]:
                cells = [f"{entry[key]:.3f}" for key in ("mean", "median", "floor")]
                shares = [f"{100 * entry[key]:.1f} %" for key in ("hit_rate", "share")]
                row = [method, f"{entry['level']:g}", *cells, *shares, str(entry["within"])]
                assert next(shown)[: len(row)] == row
    assert "queries: 60 (one in 5), map: 40 frames" in section.text
    assert {"noise", "thumb nail, mean"} <= words(section)


def test_confusion_matrices_of_all_and_by_lighting(full: Path, page: Element) -> None:
    found, section = measures(full, "network")["room_retrieval"]["confusion"], part(page, "rooms")
    every, by_lighting = section.all("svg")
    assert "all queries" in every.text
    assert all(label in by_lighting.text for label in ("cloudy", "night", "sunny"))
    assert f"{np.trace(found['counts'])} of {np.sum(found['counts'])} queries" in section.text


def test_pairs_by_lighting(full: Path, page: Element) -> None:
    found, section = measures(full, "network")["room_pairs"], part(page, "pair-curves")
    shown = pages.rows_of(section.one("table", class_="pairs"))
    assert [row[1] for row in shown] == ["cloudy", "cloudy and night", "night", "all"]
    for method, label, *cells in shown:
        group = found["overall"] if label == "all" else found["lighting"][label]
        shares = [f"{100 * group[name]:.1f} %" for name in ("same", "different", "overall")]
        assert method == "network"
        assert cells == [*shares, f"{group['auc']:.3f}", str(group["n_same"]), str(group["n_different"])]


def test_compact_maps_and_choices_of_buildings_have_parts_of_their_own(tmp_path: Path) -> None:
    run = tmp_path / "run"
    (run / "evaluation").mkdir(parents=True)
    mapped(tmp_path / "map", "sample", nodes=7)[0].rename(run / "evaluation" / "mapping-hog")
    found = evaluate_buildings(
        FrameTable(["0.png", "1.png"], building=["a", "b"], lighting=["night", "night"]),
        ["a", "b"],
        np.array([[1.0, 2.0], [1.0, 2.0]]),
        np.zeros((2, 2), dtype=int),
        (["p"], ["q"]),
    )
    found.parts["buildings"]["maps"] = {name: {"frames": 9, "representatives": 3} for name in ("a", "b")}
    found.save(run / "evaluation" / "buildings", pictures=False)
    page = report(tmp_path, run)
    names = [section.attributes["class"] for section in page.all("section")]
    assert names == ["mapping", "buildings", "configuration"]
    text = part(page, "mapping").text
    assert "frames in no node0.0 % (0/260)" in text
    assert "map by sample" in words(part(page, "mapping"))
    assert rows(part(page, "buildings"), "buildings") == {"night": ["50.0 % (1/2)", "100.0 % (1/1)", "0.0 % (0/1)"]}
    assert "a 9 frames" in part(page, "buildings").text
    assert {"50.0 % of 2 right", "true building of the query"} <= words(part(page, "buildings"))
