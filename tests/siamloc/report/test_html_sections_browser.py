"""The parts beyond plain localization in a browser: filled, drawn, switched together, readable, printed."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from siamloc.report.html import write_report
from siamloc.results import read_results
from tests.siamloc.report import rich
from tests.siamloc.report.browser import CHROMIUM, DRIVER, Browser

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not CHROMIUM or not DRIVER, reason="chromium and chromium-driver are not installed"),
]

_READY = "[...document.querySelectorAll('.stage canvas')].every((canvas) => canvas.dataset.ready)"
_MATRICES = """
    return [...document.querySelectorAll(".rooms [data-under]")].filter((part) => part.checkVisibility())
        .map((part) => part.dataset.under);
"""
_CHECKED = """
    return [...document.querySelectorAll("[data-evaluation='0'] .switch input:checked")].map((radio) => radio.value);
"""
# Ratio of the contrast of each visible text of the charts and tables with the page, by its colour.
_CONTRASTS = """
    const part = (value) => {
        const v = value / 255;
        return v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
    };
    const light = (text) => {
        const [r, g, b] = text.match(/[\\d.]+/g).map(Number);
        return 0.2126 * part(r) + 0.7152 * part(g) + 0.0722 * part(b);
    };
    const paper = light(getComputedStyle(document.body).backgroundColor);
    const found = {};
    document.querySelectorAll(".chart text, .grid td, .grid th, .caption, .legend, .grid small").forEach((element) => {
        const style = getComputedStyle(element);
        const ink = element.closest("svg") ? style.fill : style.color;
        const [low, high] = [light(ink), paper].sort((a, b) => a - b);
        found[ink] = (high + 0.05) / (low + 0.05);
    });
    return Object.values(found);
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    run = rich.write_run(folder / "vgg16", folder)
    write_report([run], run / "report.html")
    return run


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with Browser(tmp_path_factory.mktemp("profile"), 1200) as opened:
        yield opened


@pytest.fixture
def page(run: Path, browser: Browser) -> Browser:
    browser.complaints(), browser.requests()
    features = [{"name": "prefers-color-scheme", "value": "light"}]
    browser.devtools("Emulation.setEmulatedMedia", media="", features=features)
    browser.open(run / "report.html")
    browser.wait(_READY)
    return browser


def test_all_parts_are_there_and_nothing_complains_or_is_fetched(run: Path, page: Browser) -> None:
    for name in ("filtered", "interpolated", "expected", "pair-curves", "hierarchical", "robustness"):
        box = page.run("return document.querySelector(arguments[0]).getBoundingClientRect().toJSON()", f".{name}")
        assert box["width"] > 800, name
        assert box["height"] > 200, name
    assert (run / "report.html").stat().st_size < 5_000_000
    assert page.complaints() == []
    asked = {address for address in page.requests() if not address.startswith(("data:", "chrome:"))}
    assert asked == {(run / "report.html").resolve().as_uri()}


def test_one_switch_turns_the_plan_and_the_matrix(run: Path, page: Browser) -> None:
    assert page.run(_MATRICES) == ["all"]
    page.run("document.querySelector('.plan .switch input[value=night]').click()")
    assert page.run(_MATRICES) == ["night"]
    assert page.run(_CHECKED) == ["night", "night"]
    page.run("document.querySelector('.rooms .switch input[value=sunny]').click()")
    assert page.run(_MATRICES) == ["sunny"]
    assert page.run("return document.querySelector('.stage canvas').dataset.lighting") == "sunny"
    counts = read_results(run / "evaluation" / "network")["measures"]["room_retrieval"]["confusion"]["lighting"]
    shown = page.run("""
        const [part] = [...document.querySelectorAll(".rooms [data-under]")].filter((one) => one.checkVisibility());
        return [...part.querySelectorAll("tbody tr")].map((row) =>
            [...row.querySelectorAll("td")].map((cell) => Number(cell.querySelector("small")?.textContent ?? 0)));
    """)
    assert shown == counts["sunny"]
    others = page.run("return [...document.querySelectorAll('.stage canvas')].map((c) => c.dataset.lighting)")
    assert others == ["sunny", "all"], "each evaluation has its own lighting"


def test_a_worst_query_is_shown_under_all_lightings(page: Browser) -> None:
    page.run("document.querySelector('.plan .switch input[value=night]').click()")
    page.run("document.querySelector('[data-query]').click()")
    assert page.run(_CHECKED) == ["all", "all"]
    assert page.run(_MATRICES) == ["all"]


def test_charts_keep_their_text_and_lines_inside(page: Browser) -> None:
    outside = page.run("""
        return [...document.querySelectorAll("svg.chart")].flatMap((svg) => {
            const frame = svg.getBoundingClientRect();
            return [...svg.querySelectorAll("text, path, circle, polygon")].filter((element) => {
                const box = element.getBoundingClientRect();
                return box.left < frame.left - 1 || box.right > frame.right + 1
                    || box.top < frame.top - 1 || box.bottom > frame.bottom + 1;
            }).map((element) => `${svg.getAttribute("aria-label")}: ${element.outerHTML}`);
        });
    """)
    assert outside == []
    overlapping = page.run("""
        return [...document.querySelectorAll("svg.chart")].flatMap((svg) => {
            const ticks = [...svg.querySelectorAll(".tick")].map((tick) => tick.getBoundingClientRect());
            return ticks.flatMap((a, i) => ticks.slice(i + 1).filter((b) =>
                a.left < b.right - 1 && b.left < a.right - 1 && a.top < b.bottom - 4 && b.top < a.bottom - 4
            ).map(() => svg.getAttribute("aria-label")));
        });
    """)
    assert overlapping == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_is_dark_enough_to_read(page: Browser, scheme: str) -> None:
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    page.devtools("Emulation.setEmulatedMedia", features=features)
    contrasts = page.run(_CONTRASTS)
    assert len(contrasts) >= 3
    assert min(contrasts) >= 4.5, "the ratio that the accessibility guidelines ask for"


def test_lines_of_a_chart_differ_in_more_than_colour(page: Browser) -> None:
    """Curves are told apart without colour: by their dashes, marks or width."""
    alike = page.run("""
        return [...document.querySelectorAll(".filtered svg.chart, .pair-curves svg.chart, .robustness .legend")]
            .filter((chart) => {
                const looks = [...chart.querySelectorAll("path.line")].map((line) => [
                    line.getAttribute("stroke-dasharray"), getComputedStyle(line).strokeWidth,
                    line.parentElement.querySelector("circle, polygon")?.getAttribute("points") && line.parentElement
                        .classList.contains("sample") ? line.parentElement.querySelector("polygon").outerHTML : "",
                ].join());
                return new Set(looks).size < looks.length;
            }).length;
    """)
    assert alike == 0


@pytest.mark.parametrize("width", [500, 1200])
def test_nothing_is_wider_than_the_window(page: Browser, width: int) -> None:
    page.devtools("Emulation.setDeviceMetricsOverride", width=width, height=1000, deviceScaleFactor=1, mobile=False)
    try:
        assert page.run("return document.documentElement.scrollWidth - innerWidth") <= 0
        cut = page.run("""
            return [...document.querySelectorAll("section table")].filter((table) =>
                table.checkVisibility() && !table.closest(".scroll") && table.getBoundingClientRect().right > innerWidth
            ).length;
        """)
        assert cut == 0
    finally:
        page.devtools("Emulation.clearDeviceMetricsOverride")


def test_it_prints_with_the_chosen_lighting(page: Browser) -> None:
    page.run("document.querySelector('.rooms .switch input[value=night]').click()")
    pdf = base64.b64decode(page.devtools("Page.printToPDF", printBackground=True)["data"])
    assert pdf.startswith(b"%PDF")
    assert page.run(_MATRICES) == ["night"]
    assert page.complaints() == []


def test_without_scripts_every_matrix_is_shown(run: Path, browser: Browser) -> None:
    browser.devtools("Emulation.setScriptExecutionDisabled", value=True)
    try:
        browser.open(run / "report.html")
        tree = browser.devtools("DOM.getDocument", depth=-1, pierce=True)["root"]
        found = browser.devtools("DOM.querySelectorAll", nodeId=tree["nodeId"], selector=".rooms [data-under]")
        heights = [browser.devtools("DOM.getBoxModel", nodeId=node)["model"]["height"] for node in found["nodeIds"]]
        assert len(heights) == 4
        assert np.min(heights) > 100
    finally:
        browser.devtools("Emulation.setScriptExecutionDisabled", value=False)
