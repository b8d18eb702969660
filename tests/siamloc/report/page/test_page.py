"""The page as a file: what it contains, and that it agrees with the result files."""

from __future__ import annotations

import base64
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from foundation.files import write_json
from siamloc.data import read_occupancy
from siamloc.errors import DataError, FormatError
from siamloc.maps import VisualMap
from siamloc.report.draw.floor_plan import floor_plan
from siamloc.report.page.write import write_report
from siamloc.results import read_results, read_rows
from tests.siamloc.evaluation import scenes
from tests.siamloc.report import pages
from tests.siamloc.report.pages import columns_of, notes, rows_of


@pytest.fixture(scope="module")
def page(run: Path) -> pages.Element:
    return pages.read_page(write_report([run], run / "report.html"))


def test_the_parts_stand_in_their_order(page: pages.Element) -> None:
    assert page.one("h1").text == "vgg16"
    assert re.search(r"measured \d\d \w+ \d{4}, \d\d:\d\d UTC", page.one("header").text)
    names = [section.attributes["class"] for section in page.all("section")]
    assert names == ["summary", "plan", "curves", "worst", "rooms", "training", "configuration"]


def test_nothing_is_loaded_from_elsewhere(run: Path, page: pages.Element) -> None:
    text = (run / "report.html").read_text(encoding="utf-8")
    assert not re.search(r"https?:|//[a-z]+\.|@import|url\((?!#)", text)
    for element in page.all():
        for name in ("src", "href", "srcset", "data", "action", "poster"):
            value = element.attributes.get(name, "#")
            assert value.startswith(("#", "data:")), f"{element.name} {name}={value}"
    policy = page.one("meta", **{"http-equiv": "Content-Security-Policy"}).attributes["content"]
    assert policy.startswith("default-src 'none'")


def test_the_summary_says_what_the_results_say(run: Path, page: pages.Element) -> None:
    results = read_results(run / "evaluation" / "network")
    methods = {"network": results["measures"], **results["baselines"]}
    expected, found = [], []
    for method, measures in methods.items():
        for label in ("cloudy", "night", "sunny", "all"):
            absolute, rooms = measures["absolute"], measures.get("room_retrieval")
            group = absolute["overall"] if label == "all" else absolute["lighting"][label]
            row = [method, label]
            row += [f"{group['error'][key]:.3f}" for key in ("mean", "median", "p95")]
            row += [f"{group[key]['mean']:.3f}" for key in ("floor", "excess")]
            row.append(f"{100 * group['hit_rate'][0]['rate']:.1f} %")
            row += [f"{100 * item['recall']:.1f} %" for item in group["recall"] if item["k"] == 1]
            row.append(f"{group['heading_error']['mean']:.1f}" if "heading_error" in group else "–")
            expected.append([*row, str(group["queries"])])
            if rooms is not None:
                right = rooms["overall"] if label == "all" else rooms["lighting"][label]
                shares = (right["accuracy"], right["top"]["5"], right["mean_average_precision"], right["chance"])
                found.append([method, label, *(f"{100 * share:.1f} %" for share in shares), str(right["queries"])])
    errors, by_room = page.all("table", class_="errors")
    assert rows_of(errors) == expected
    assert rows_of(page.all("table", class_="rooms")[0]) == found
    assert {row[1] for row in rows_of(by_room)} == {"CR-A", "KT-A", "ST-A", "all"}


def test_the_plan_holds_every_query_and_its_right_answer(run: Path, page: pages.Element) -> None:
    data, queries, known = pages.data_of(page, "data-0"), columns_of(run), columns_of(run, "map")
    for name, column in {"x": "x", "y": "y", "ex": "est_x", "ey": "est_y", "error": "error", "floor": "floor"}.items():
        np.testing.assert_allclose(data["query"][name], queries[column], atol=0.0006)
    lighting = [data["lightings"][i] for i in data["query"]["lighting"]]
    assert lighting == queries["lighting"].tolist()
    heading = [np.nan if value is None else value for value in data["query"]["heading"]]
    np.testing.assert_allclose(heading, queries["heading_error"], atol=0.06)
    distance = np.hypot(*(queries[name][:, None] - known[name][None] for name in ("x", "y")))
    assert data["query"]["nearest"] == distance.argmin(axis=1).tolist()
    np.testing.assert_allclose(known["x"], data["map"]["x"], atol=0.0006)
    radios = page.one("section", class_="plan").all("input", type="radio")
    assert [radio.attributes["value"] for radio in radios] == ["all", "cloudy", "night", "sunny"]


def test_every_hover_picture_is_that_of_its_frame(run: Path, page: pages.Element) -> None:
    data, (sheets,) = pages.data_of(page, "data-0"), pages.data_of(page, "sheets")
    assert not notes(page)
    shown = 0
    for part, table in (("query", "queries"), ("map", "map")):
        for path, number in zip(columns_of(run, table)["path"], data[part]["picture"], strict=True):
            if part == "map" and number == -2:
                continue  # neither a match nor the right answer of any query
            tile = pages.sheet_picture(sheets, number).astype(int)
            source = cv2.resize(cv2.imread(path), tile.shape[1::-1], interpolation=cv2.INTER_AREA)
            assert np.abs(tile - source).mean() < 8, path
            shown += 1
    assert shown >= 60 + len(set(data["query"]["match"]) | set(data["query"]["nearest"]))


def test_the_worst_queries_are_those_with_the_largest_errors(run: Path, page: pages.Element) -> None:
    queries = columns_of(run)
    items = page.one("ol", class_="triples").all("li")
    worst = np.argsort(-queries["error"], kind="stable")[:20]
    assert [int(item.one("button").attributes["data-query"]) for item in items] == worst.tolist()
    for item, row in zip(items, worst, strict=True):
        assert item.one("div", class_="head").all("b")[0].text == f"{queries['error'][row]:.2f} m"
        titles = [image.attributes["title"] for image in item.all("img")]
        assert titles[:2] == [queries["path"][row], queries["match_path"][row]]
        for image in item.all("img"):
            rows, columns = pages.decoded(image.attributes["src"].partition(",")[2]).shape[:2]
            assert columns >= 256
            assert columns == 4 * rows


def test_no_name_is_given_twice(run: Path, page: pages.Element) -> None:
    names = [element.attributes["id"] for element in page.all() if "id" in element.attributes]
    assert len(names) == len(set(names))
    text = (run / "report.html").read_text(encoding="utf-8")
    references = set(re.findall(r'(?:url\(#|href="#)([^)"]+)', text))
    assert len(references) > 20
    assert references <= set(names)


def test_training_curves_configuration_and_versions(page: pages.Element) -> None:
    training = page.one("section", class_="training")
    assert training.one("h3").text == "Training, 3 epochs"
    words = [text.text.strip() for text in training.one("svg").all("text")]
    assert {"loss", "accuracy", "training, last 0.25", "validation, last 0.4"} <= set(words)
    settings = page.one("section", class_="configuration").text
    assert "image_size: [32, 128]" in settings
    assert np.__version__ in settings


def test_the_page_repeats_itself(run: Path, page: pages.Element, tmp_path: Path) -> None:
    assert write_report([run], tmp_path / "again.html").read_bytes() == (run / "report.html").read_bytes()


def test_the_building_lies_behind_the_plan(run: Path, tmp_path: Path) -> None:
    table = columns_of(run, "map")
    low = np.array([table["x"].min(), table["y"].min()]) - 1
    file = pages.write_occupancy(tmp_path, low)
    page = pages.read_page(write_report([run], tmp_path / "report.html", plan=file))
    told = pages.data_of(page, "occupancy")
    known = read_occupancy(file)
    assert {key: told[key] for key in known.placed()} == known.placed()
    picture = cv2.imdecode(np.frombuffer(base64.b64decode(told["png"]), np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(picture[..., 3], known.picture()[..., 3])
    around = pages.data_of(page, "data-0")["around"]
    np.testing.assert_allclose(np.array(around).T[0], low, atol=1e-3)
    with pytest.raises(DataError, match="no position lies on the occupancy map"):
        write_report([run], tmp_path / "wrong.html", plan=pages.write_occupancy(tmp_path, low - 1e4))
    assert not (tmp_path / "wrong.html").exists()


def test_the_page_of_a_surveyed_run_says_so(tmp_path: Path) -> None:
    folder = pages.write_run(tmp_path / "walk", tmp_path)
    about = {"notes": ["no loops"], "summary": "60 frames; do not rely on it: torn in 2 places", "torn": 2}
    write_json(folder / "survey.json", about)
    picture = pages.draw(str(folder / "survey.png"), 7)
    page = pages.report(folder)
    survey = page.one("section", class_="survey")
    shown = survey.one("img").attributes["src"].removeprefix("data:image/png;base64,")
    np.testing.assert_array_equal(pages.decoded(shown), picture)
    assert [line.text for line in survey.all("p")] == ["no loops", about["summary"]]
    assert "mean error in the surveyed map" in page.one("ul", class_="figures").text
    assert "Do not rely on these figures: the survey is torn in 2 places." in page.one("header").text
    assert "errors in the surveyed map" in page.one("section", class_="summary").text
    assert "coloured dots the surveyed positions of queries" in page.one("section", class_="plan").text
    assert pages.data_of(page, "data-0")["truth"] == "surveyed"
    write_json(folder / "survey.json", {**about, "walk": ["camera: unwrap=none", "note: look"]})
    lines = pages.report(folder).one("section", class_="survey").all("p")
    assert [(line.text, line.attributes["class"]) for line in lines] == [
        ("camera: unwrap=none", "caption"),
        ("look", "note"),
    ]
    write_json(folder / "survey.json", {"notes": 1})
    with pytest.raises(FormatError, match=r"survey.json was altered in notes: survey again"):
        pages.report(folder)


def test_a_survey_is_found_with_the_manifest_of_its_frames(tmp_path: Path) -> None:
    run, survey = pages.write_run(tmp_path / "run"), tmp_path / "survey"
    results = read_results(run / "evaluation" / "network")
    for manifest, shown in ((survey / "surveyed.csv", 1), (survey / "other.csv", 0)):
        config = {**results["config"], "data": {"manifest": str(manifest)}}
        write_json(run / "evaluation" / "network" / "results.json", {**results, "config": config})
        write_json(survey / "survey.json", {"notes": [], "summary": None, "torn": 2})
        pages.draw(str(survey / "survey.png"), 7)
        page = pages.report(run)
        assert len(page.all("section", class_="survey")) == shown
        assert page.one("header").text.count("the survey is torn in 2 places") == shown


def test_poses_with_deviations_are_called_surveyed(tmp_path: Path) -> None:
    known, queries = (scenes.frames(seed, 20) for seed in (1, 2))
    queries = queries.with_columns(deviation=np.full(20, 0.1))
    visual_map = VisualMap(scenes.describe(known, seed=1), known, {"name": "positions"})
    folder = pages.write_evaluation(tmp_path / "evaluation" / "network", visual_map, queries)
    columns = read_rows(folder)
    assert columns["deviation"].tolist() == [0.1] * 20
    page = pages.report(tmp_path)
    assert "coloured dots the surveyed positions of queries" in page.one("section", class_="plan").text
    assert not page.all("section", class_="survey")
    legend = floor_plan(columns, read_rows(folder, "map")).legends[0]
    assert "query, surveyed position" in [text.get_text() for text in legend.get_texts()]
