"""Runs that are unusual: pictures gone, parts missing, very many queries, several at once, damaged files."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from foundation.files import read_json, write_json
from siamloc.cli import main
from siamloc.errors import ConfigError, FormatError, SiamlocError
from siamloc.maps import VisualMap
from siamloc.report.page import compared, parts, sections
from siamloc.report.page.markup import Markup, grid, tag
from siamloc.report.page.write import write_report
from siamloc.results import read_results, read_rows, write_results
from siamloc.runs import Run
from siamloc.tables import Column, Table
from tests.siamloc.cli.commands import refused
from tests.siamloc.evaluation import scenes
from tests.siamloc.report import pages
from tests.siamloc.report.pages import columns_of, notes, report, rows_of


@pytest.fixture(autouse=True)
def figures_in_outline(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the figures empty: other tests check them, and drawing takes long."""

    def outline(figure: object, name: str, title: str) -> Markup:
        return tag("figure.picture", tag("svg", id=name))

    for module in (compared, parts, sections):
        monkeypatch.setattr(module, "inline", outline)


def test_images_that_are_gone_leave_placeholders_and_a_count(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    run = pages.write_run(tmp_path / "run", tmp_path)
    queries = columns_of(run)
    gone = queries["path"][[3, 8, int(np.argmax(queries["error"]))]]
    for path in set(gone):
        Path(path).unlink()
    page = report(tmp_path, run)
    picture = pages.data_of(page, "data-0")["query"]["picture"]
    assert [i for i, number in enumerate(picture) if number == -1] == sorted(
        np.flatnonzero(np.isin(queries["path"], gone))
    )
    assert f"{len(set(gone))} pictures of " in notes(page)
    assert f"{len(set(gone))} of 97 pictures could not be read, the first: " in caplog.text
    assert "the file does not exist" in notes(page)
    assert page.all("div", class_="missing")[0].attributes["title"] in gone


def test_without_any_image_the_numbers_stand(tmp_path: Path) -> None:
    page = report(tmp_path, pages.write_run(tmp_path / "run"))
    assert set(pages.data_of(page, "data-0")["query"]["picture"]) == {-1}
    assert not page.all("img")
    assert "could not be read" in notes(page)
    names = {section.attributes["class"].split()[-1] for section in page.all("section")}
    assert names == {"summary", "plan", "curves", "worst", "rooms", "training", "configuration"}


def test_the_page_says_that_it_left_pictures_out(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parts, "_MOST_SMALL", 20)
    page = report(tmp_path, run)
    assert "Some pictures are left out" in notes(page)
    data = pages.data_of(page, "data-0")
    assert data["query"]["picture"].count(-2) > 0
    assert data["query"]["picture"][int(np.argmax(data["query"]["error"]))] >= 0


def test_thousands_of_queries_stay_under_five_megabytes(tmp_path: Path) -> None:
    run = pages.write_run(tmp_path / "run", n=20_000, m=300, rooms=False, baselines=())
    page = report(tmp_path, run)
    assert (tmp_path / "report.html").stat().st_size < 5_000_000
    data, error = pages.data_of(page, "data-0"), columns_of(run)["error"]
    assert len(data["query"]["x"]) <= 12_000
    assert set(np.argsort(-error, kind="stable")[:20]) <= set(data["query"]["row"])
    assert "of 20,000 queries, the worst among them" in notes(page)
    assert rows_of(page.all("table", class_="errors")[0])[-1][-1] == "20,000"


@pytest.mark.parametrize("lighting", ["night", ""], ids=["one lighting", "no lighting"])
def test_without_rooms_headings_baselines_or_lightings(tmp_path: Path, lighting: str) -> None:
    bare = {"room": np.array([""] * 30), "theta": np.full(30, np.nan), "lighting": np.array([lighting] * 30)}
    queries, known = scenes.frames(2, 30, **bare), scenes.frames(1, 30, **bare)
    visual_map = VisualMap(scenes.describe(known), replace(known, unit="frame"), {"name": "positions"})
    folder = pages.write_evaluation(tmp_path / "night", visual_map, queries, rooms=False, headings=False, baselines=())
    page = report(tmp_path, folder)
    names = [section.attributes["class"] for section in page.all("section")]
    assert names == ["summary", "plan", "curves", "worst", "configuration"]
    (row,) = rows_of(page.all("table", class_="errors")[0])
    assert row[:2] == ["network", lighting or "all"]
    assert not page.all("input", type="radio")
    assert "mean\u00a0[frame]" in page.all("table", class_="errors")[0].text
    assert len(page.one("section", class_="curves").all("figure")) == 1


def test_frames_on_a_line_are_drawn_along_it(tmp_path: Path) -> None:
    line = {"x": np.zeros(30), "y": np.arange(30.0)}
    queries, known = scenes.frames(2, 30, **line), scenes.frames(1, 30, **line)
    visual_map = VisualMap(scenes.describe(known), known, {"name": "positions"})
    page = report(tmp_path, pages.write_evaluation(tmp_path / "corridor", visual_map, queries))
    assert pages.data_of(page, "data-0")["along"] == "y"
    assert "lie on a line along y" in page.one("section", class_="plan").text


def test_several_runs_are_compared_first(run: Path, tmp_path: Path) -> None:
    twin = shutil.copytree(run, tmp_path / "other" / "vgg16")
    page = report(tmp_path, run, twin, run)
    table = page.one("table", class_="comparison")
    titles = [link.text for link in table.all("a")]
    assert len(titles) == 2, "a run that is named twice counts once"
    assert titles[1] == "other/vgg16 · network"
    first, second = ([cell.text for cell in row.all("td")] for row in table.one("tbody").all("tr"))
    assert first == second
    results = read_results(run / "evaluation" / "network")["measures"]["absolute"]
    assert first[:3] == ["40", "60", f"{results['overall']['error']['mean']:.3f}"]
    for link, article in zip(table.all("a"), page.all("article", **{"data-evaluation": "0"}), strict=False):
        assert link.attributes["href"] == f"#{article.attributes['id']}"
    assert page.all("section")[0].attributes["class"] == "compared"
    assert not notes(page)
    (sheets,) = pages.data_of(page, "sheets")
    pictures = [pages.data_of(page, f"data-{i}")["query"]["picture"] for i in (0, 1)]
    assert pictures[0] == pictures[1], "both show the same files, which are in the page once"
    assert len(sheets["images"]) == 2


def test_a_folder_of_evaluations_stands_for_them(run: Path, tmp_path: Path) -> None:
    for name in ("night10", "night2"):
        shutil.copytree(run / "evaluation" / "network", tmp_path / "results" / name)
    links = report(tmp_path, tmp_path / "results").one("table", class_="comparison").all("a")
    assert [link.text for link in links] == ["night2 · network", "night10 · network"]
    shutil.copytree(run, tmp_path / "results" / "run")
    Run(tmp_path / "results" / "run").start({"training": {"epochs": 3}}, [])
    shutil.copytree(run, tmp_path / "results" / "deep" / "untrained")
    links = report(tmp_path, tmp_path / "results").one("table", class_="comparison").all("a")
    assert [link.text for link in links] == [
        "untrained · network",
        "night2 · network",
        "night10 · network",
        "run · network",
    ]


def test_of_many_runs_the_title_names_the_folder(tmp_path: Path) -> None:
    run, sweep = pages.write_run(tmp_path / "run", n=5), tmp_path / "sweep"
    for count, title in ((4, "seed-0, seed-1, seed-2, seed-3"), (5, "sweep")):
        for number in range(count):
            shutil.copytree(run, sweep / f"seed-{number}", dirs_exist_ok=True)
        assert report(tmp_path, sweep).one("h1").text == title


def test_of_a_sweep_that_is_not_all_measured_the_report_advises_to_measure_the_sweep(tmp_path: Path) -> None:
    pages.write_run(tmp_path / "sweep" / "seed-0")
    for number in (0, 1):
        Run(tmp_path / "sweep" / f"seed-{number}").start({}, [])
    with pytest.raises(ConfigError, match=r"seed-1 holds no evaluation: .* run=\S+sweep`"):
        write_report(tmp_path / "sweep", tmp_path / "report.html")
    Run(tmp_path / "own").start({"model": {"class": "my.Network"}}, [])
    with pytest.raises(ConfigError, match=r"measure it first in Python, and save the result in run"):
        write_report(tmp_path / "own", tmp_path / "report.html")


def test_runs_that_cannot_be_compared_are_marked(tmp_path: Path) -> None:
    runs = [pages.write_run(tmp_path / name, n=n) for name, n in (("a", 20), ("b", 21))]
    assert notes(report(tmp_path, *runs).one("section", class_="compared")) == (
        "Take care when comparing b · network with a · network: they differ in their queries (21 and 20, 0 of them in "
        "common)."
    )
    days, changes = ("2026-12-02", "2026-11-25"), ({}, {"protocol": "same_run"})
    for run, day, changed in zip(runs, days, changes, strict=True):
        path = run / "evaluation" / "network" / "results.json"
        write_json(path, {**read_json(path), "created": f"{day}T10:00:00+00:00", **changed})
    page = report(tmp_path, *runs)
    dates = "measured 25 November 2026, 10:00 UTC to 02 December 2026, 10:00 UTC"
    assert dates in page.one("header").text, "the earliest first"
    assert "must not be compared" in notes(page)
    assert "differ in their queries" in notes(page), "that the protocols differ does not hide it"
    assert "same run" in page.one("table", class_="comparison").text


def test_a_sweep_is_in_the_order_of_its_numbers(tmp_path: Path) -> None:
    names = [f"descriptor.bins-{bins}" for bins in (4, 8, 16)]
    for name in reversed(names):
        folder = tmp_path / "run" / "evaluation" / "hog" / name
        pages.write_evaluation(folder, scenes.visual_map(), scenes.frames(2, 10), name=name, rooms=False)
    page = report(tmp_path, tmp_path / "run")
    table = page.one("table", class_="comparison")
    assert [link.text for link in table.all("a")] == names
    headings = [cell.text.replace("\u00a0", " ") for cell in table.one("thead").all("th")]
    assert {"mean [m]", "mean, night [m]"} <= set(headings)


@pytest.mark.parametrize(("mean", "widths"), [(0.5, ["12.5%", "12.5%"]), (0.1, ["5.0%", "0.0%"])])
def test_bars_are_as_long_as_the_mean(mean: float, widths: list[str]) -> None:
    columns = (Column("method"), Column("mean", "m", 3, part="floor"), Column("floor", "m", 3))
    page = pages.parse(grid(Table("errors", columns, (("tracked", mean, 0.25), ("hog", 2.0, 0.25)))))
    bits = page.all("span", class_="bar")[0].all("i")
    assert [bit.attributes["style"] for bit in bits] == [f"width:{width}" for width in widths]


def test_names_are_never_markup(tmp_path: Path) -> None:
    evil = '</script><b onmouseover="x">&'
    queries = scenes.frames(2, 30, room=np.array([evil] * 30), lighting=np.array([evil] * 15 + ["night"] * 15))
    folder = pages.write_evaluation(tmp_path / "evil", scenes.visual_map(), queries, name=evil)
    page = report(tmp_path, folder)
    assert not [e for e in page.all("b") if "onmouseover" in e.attributes]
    assert evil in pages.data_of(page, "data-0")["rooms"]
    assert page.all("input", type="radio")[1].attributes["value"] == evil


def write(path: Path, text: str) -> None:
    path.write_text(text)


def shorten_the_map(run: Path) -> None:
    """Write the results again with one map frame, whereas queries match others."""
    folder = run / "evaluation" / "network"
    known = {name: column[:1] for name, column in read_rows(folder, "map").items()}
    write_results(folder, read_results(folder), {"queries": read_rows(folder), "map": known})


@pytest.mark.parametrize(
    ("spoil", "error", "message"),
    [
        (lambda run: (run / "evaluation/network/results.json").unlink(), ConfigError, "`siamloc evaluate run="),
        (lambda run: write(run / "metrics.csv", "epoch\nx\n"), FormatError, "training curves"),
        (lambda run: write(run / "evaluation/network/queries.csv", "x\n1\n"), FormatError, "evaluate again"),
        (lambda run: write(run / "evaluation/network/results.json", "{"), FormatError, "invalid JSON.*evaluate again"),
        (shorten_the_map, FormatError, "names map frames that map.csv lacks"),
    ],
    ids=["no evaluation", "damaged curves", "damaged table", "damaged results", "matches outside the map"],
)
def test_folders_that_give_no_report(tmp_path: Path, spoil, error: type[SiamlocError], message: str) -> None:
    run = pages.write_run(tmp_path / "run", n=5)
    spoil(run)
    with pytest.raises(error, match=message):
        write_report([run], tmp_path / "report.html")
    assert not (tmp_path / "report.html").exists()


def test_the_command(tmp_path: Path, capsys, monkeypatch) -> None:
    run = pages.write_run(tmp_path / "runs" / "vgg16", n=5)
    Run(run).start({"training": {"epochs": 3}}, [])
    monkeypatch.chdir(tmp_path)
    assert main(["report"]) == 0
    assert f"report: {Path('runs/vgg16/report.html')}, 0." in capsys.readouterr().out
    assert "training: {epochs: 3}" in (run / "report.html").read_text()
    assert main(["report", f"runs=[{run},{run / 'evaluation' / 'network'}]"]) == 0
    assert (tmp_path / "report.html").exists()
    assert main(["report", f"run={run}", "out=deep/page.html"]) == 0
    assert (tmp_path / "deep" / "page.html").exists()
    for wrong, says in (
        (["run=a", "runs=[b]"], "not both"),
        ([f"run={run}", "out=page.pdf"], "ending in .html"),
        (["run=absent"], "there is no folder"),
    ):
        assert says in refused(capsys, "report", *wrong)
