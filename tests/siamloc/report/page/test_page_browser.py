"""The page in a browser: the plan is drawn, answers to mouse and keyboard, and nothing is fetched."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from siamloc.report.page.write import write_report
from siamloc.results import read_rows
from tests.siamloc.evaluation import scenes
from tests.siamloc.report import pages, rich
from tests.siamloc.report.browser import CHROMIUM, DRIVER, Browser

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not CHROMIUM or not DRIVER, reason="chromium and chromium-driver are not installed"),
]

_READY = "[...document.querySelectorAll('.stage canvas')].every((canvas) => canvas.dataset.ready)"
_SHOWN = "[...document.querySelectorAll('[data-picture]')].every((figure) => figure.dataset.state === 'shown')"
_COLOURS = """
    const canvas = document.querySelector(".stage canvas");
    const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    const found = new Set();
    for (let i = 0; i < data.length; i += 4) if (data[i + 3] === 255) found.add(data.slice(i, i + 3).join());
    return [...found];
"""
_LIGHT, _DARK = ({"name": "prefers-color-scheme", "value": value} for value in ("light", "dark"))
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
    const words = ".picture text:not(.rooms text), .grid td, .grid th, .caption, .grid small";
    document.querySelectorAll(words).forEach((element) => {
        const style = getComputedStyle(element);
        const ink = element.closest("svg") ? style.fill : style.color;
        const [low, high] = [light(ink), paper].sort((a, b) => a - b);
        found[ink] = (high + 0.05) / (low + 0.05);
    });
    return Object.values(found);
"""
_CALM = {"name": "prefers-reduced-motion", "value": "reduce"}
RIGHT, UP, DOWN, ESCAPE = "\ue014", "\ue013", "\ue015", "\ue00c"


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with Browser(tmp_path_factory.mktemp("profile"), 1200) as opened:
        yield opened


@pytest.fixture
def page(full: Path, browser: Browser) -> Browser:
    """Return the browser with the page of a run in light colours, and nothing in its logs."""
    path = full / "report.html"
    if not path.exists():
        write_report([full], path)
    browser.complaints(), browser.requests()
    browser.devtools("Emulation.setEmulatedMedia", media="", features=[_LIGHT, _CALM])
    browser.open(path)
    browser.wait(f"{_READY} && {_SHOWN}")
    return browser


def state(browser: Browser) -> dict[str, str]:
    """Return what the plan reports about itself."""
    return browser.run("return {...document.querySelector('.stage canvas').dataset}")


def queries(run: Path) -> dict[str, np.ndarray]:
    return read_rows(run / "evaluation" / "network")


def test_all_parts_are_there_and_nothing_complains_or_is_fetched(full: Path, page: Browser) -> None:
    for name in ("filtered", "interpolated", "expected", "pair-curves", "hierarchical", "robustness"):
        box = page.run("return document.querySelector(arguments[0]).getBoundingClientRect().toJSON()", f".{name}")
        assert box["width"] > 800, name
        assert box["height"] > 200, name
    page.key(".stage canvas", RIGHT, UP)
    page.run("document.querySelector('.switch input[value=night]').click()")
    page.wait(_SHOWN)
    page.run("document.querySelectorAll('details').forEach((details) => { details.open = true; })")
    assert base64.b64decode(page.devtools("Page.printToPDF")["data"]).startswith(b"%PDF")
    assert page.complaints() == []
    asked = {address for address in page.requests() if not address.startswith(("data:", "chrome"))}
    assert asked == {(full / "report.html").resolve().as_uri()}


def test_the_page_itself_forbids_requests(page: Browser) -> None:
    """The policy in the page holds: what tries to load something is stopped, and is seen by the test above."""
    page.run("const image = new Image(); image.src = 'http://127.0.0.1:9/x.png'; document.body.append(image)")
    page.wait("document.body.lastElementChild.complete")
    assert any("Content Security Policy" in line for line in page.complaints())


def test_the_lighting_switch(full: Path, page: Browser) -> None:
    lighting = queries(full)["lighting"]
    pictures = set()
    for label in ("cloudy", "night", "sunny", "all"):
        page.run("document.querySelector(`.switch input[value=${arguments[0]}]`).click()", label)
        said = state(page)
        members = np.ones(60, bool) if label == "all" else lighting == label
        assert (said["lighting"], int(said["drawn"])) == (label, int(members.sum()))
        assert members[int(said["selected"])]
        counts = page.run(
            "return [...document.querySelector('.classes').querySelectorAll('small')].map((s) => Number(s.textContent))"
        )
        assert sum(counts) == members.sum()
        pictures.add(page.run("return document.querySelector('.stage canvas').toDataURL()"))
    assert len(pictures) == 4


def test_classes_of_errors_can_be_hidden(page: Browser) -> None:
    before = int(state(page)["drawn"])
    hidden = page.run("""
        const label = document.querySelector(".classes label");
        label.querySelector("input").click();
        return Number(label.querySelector("small").textContent);
    """)
    assert hidden > 0
    assert int(state(page)["drawn"]) == before - hidden
    page.run("document.querySelectorAll('.classes input:checked').forEach((box) => box.click())")
    assert page.run("return document.querySelector('.facts').innerText") == "no query is shown"
    pictures = "return getComputedStyle(document.querySelector('.details .triple')).visibility"
    assert page.run(pictures) == "hidden"
    page.run("document.querySelector('.classes input').click()")
    assert page.run(pictures) == "visible"


def test_the_worst_query_is_shown_first_with_its_pictures(full: Path, page: Browser) -> None:
    columns = queries(full)
    worst = int(np.argmax(columns["error"]))
    assert int(state(page)["selected"]) == worst
    assert f"{columns['error'][worst]:.2f} m off" in page.run("return document.querySelector('.facts').innerText")
    shown = page.run("""
        return [...document.querySelectorAll("[data-picture] canvas")].map((c) => c.toDataURL().split(",")[1]);
    """)
    for path, data in zip((columns["path"][worst], columns["match_path"][worst]), shown, strict=False):
        picture = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR)
        source = cv2.resize(cv2.imread(path), picture.shape[1::-1], interpolation=cv2.INTER_AREA)
        assert np.abs(picture.astype(int) - source).mean() < 10


def test_pointing_and_clicking(page: Browser) -> None:
    def select(row: int) -> dict[str, str]:
        page.run("document.querySelector(`[data-query]`).dataset.query = arguments[0]", row)
        page.run("document.querySelector(`[data-query]`).click()")
        return state(page)

    first, second = select(7), select(31)
    page.key(".stage canvas", ESCAPE)
    assert first["at"] != second["at"]
    left, top = page.run("""
        const canvas = document.querySelector(".stage canvas");
        canvas.scrollIntoView({ block: "center", behavior: "instant" });
        const { left, top } = canvas.getBoundingClientRect();
        return [left, top];
    """)
    x, y = (float(value) for value in first["at"].split())
    page.point(left + x, top + y)
    page.wait("document.querySelector('.stage canvas').dataset.selected !== '31'")
    said = state(page)
    assert said["at"] == first["at"]
    assert said["pinned"] == "false"
    page.point(left + x, top + y, click=True)
    assert state(page)["pinned"] == "true"
    x, y = (float(value) for value in second["at"].split())
    page.point(left + x, top + y)
    assert state(page)["at"] == first["at"], "a query that was clicked is kept"


def test_the_keyboard_moves_along_the_drive_and_by_error_and_a_button_shows_a_query(full: Path, page: Browser) -> None:
    order = np.argsort(queries(full)["error"], kind="stable")
    page.run("document.querySelectorAll('[data-query]')[2].click()")
    assert int(state(page)["selected"]) == order[-3]
    assert page.run("return document.activeElement === document.querySelector('.stage canvas')")
    page.key(".stage canvas", UP)
    assert int(state(page)["selected"]) == order[-2]
    page.key(".stage canvas", DOWN, DOWN)
    assert int(state(page)["selected"]) == order[-4]
    page.key(".stage canvas", RIGHT)
    assert int(state(page)["selected"]) == min(order[-4] + 1, 59)


def test_zooming(page: Browser) -> None:
    whole = state(page)["at"]
    page.key(".stage canvas", "+", "+")
    assert state(page)["zoom"] == "2.25"
    assert state(page)["at"] != whole
    page.run("document.querySelector('[data-zoom=out]').click()")
    assert state(page)["zoom"] == "1.50"
    page.run("document.querySelector('[data-zoom=reset]').click()")
    assert (state(page)["zoom"], state(page)["at"]) == ("1.00", whole)


def test_dark_and_light(page: Browser) -> None:
    def paper() -> str:
        return page.run("return getComputedStyle(document.body).backgroundColor")

    words = "return getComputedStyle(document.querySelector('.curves svg text')).fill"
    light, plan, ink = paper(), set(page.run(_COLOURS)), page.run(words)
    page.run("window.before = document.querySelector('.stage canvas').toDataURL()")
    page.devtools("Emulation.setEmulatedMedia", features=[_DARK])
    assert (light, paper()) == ("rgb(255, 255, 255)", "rgb(19, 23, 27)")
    assert page.run(words) != ink, "figures follow the colours of the page"
    page.wait("document.querySelector('.stage canvas').toDataURL() !== window.before")
    assert len(plan & set(page.run(_COLOURS))) < len(plan) / 2, "the plan is drawn again in other colours"
    page.devtools("Emulation.setEmulatedMedia", media="print")
    assert paper() == "rgb(255, 255, 255)"


def test_several_runs_and_frames_on_a_line(run: Path, browser: Browser, tmp_path: Path) -> None:
    line = {"x": np.arange(30.0), "y": np.zeros(30), "lighting": np.array([""] * 30), "room": np.array([""] * 30)}
    known, others = scenes.frames(1, 30, **line), scenes.frames(2, 30, **line)
    from siamloc.maps import VisualMap

    visual_map = VisualMap(scenes.describe(known), replace(known, unit="frame"), {"name": "positions"})
    corridor = pages.write_evaluation(tmp_path / "corridor", visual_map, others, rooms=False, baselines=())
    browser.complaints()
    browser.open(write_report([run, corridor], tmp_path / "both.html"))
    browser.wait(_READY)
    drawn = browser.run("return [...document.querySelectorAll('.stage canvas')].map((c) => c.dataset.drawn)")
    assert drawn == ["60", "30"]
    states = browser.run("return [...document.querySelectorAll('[data-picture]')].map((f) => f.dataset.state)")
    assert states[3:] == ["missing"] * 3
    browser.run("document.querySelector('.switch input[value=night]').click()")
    both = browser.run("return [...document.querySelectorAll('.stage canvas')].map((c) => c.dataset.lighting)")
    assert both == ["night", "all"], "each plan has its own switch"
    assert browser.complaints() == []


def test_a_refined_pose_is_the_estimate_and_its_map_frame_the_match(browser: Browser, tmp_path: Path) -> None:
    run = rich.write_refined(tmp_path / "run")
    browser.open(write_report([run], tmp_path / "refined.html"))
    browser.wait(_READY)
    browser.run("""
        window.words = {};
        const prototype = CanvasRenderingContext2D.prototype, write = prototype.fillText;
        prototype.fillText = function (words, x, y) { window.words[words] = [x, y]; write.call(this, words, x, y); };
    """)
    browser.key(".stage canvas", "0")
    estimate, match = (browser.run(f"return window.words.{word}[0]") for word in ("estimate", "match"))
    columns, at = queries(run), float(state(browser)["at"].split()[0]) + 11
    share = (columns["est_x"][0] - columns["x"][0]) / (columns["refined_est_x"][0] - columns["x"][0])
    assert (match - at) / (estimate - at) == pytest.approx(share, rel=0.01)


def test_figures_keep_their_text_inside_and_apart(page: Browser) -> None:
    """Words are laid out for matplotlib's font and shown in the browser's: they have to fit all the same."""
    outside = page.run("""
        return [...document.querySelectorAll(".picture svg")].flatMap((svg) => {
            const frame = svg.getBoundingClientRect();
            return [...svg.querySelectorAll("text")].filter((element) => {
                const box = element.getBoundingClientRect();
                return box.left < frame.left - 2 || box.right > frame.right + 2
                    || box.top < frame.top - 2 || box.bottom > frame.bottom + 2;
            }).map((element) => `${svg.getAttribute("aria-label")}: ${element.textContent}`);
        });
    """)
    assert outside == []
    overlapping = page.run("""
        return [...document.querySelectorAll(".picture svg")].flatMap((svg) => {
            const words = [...svg.querySelectorAll("text")].map((text) => [text, text.getBoundingClientRect()]);
            return words.flatMap(([one, a], i) => words.slice(i + 1).filter(([other, b]) =>
                !(one.getAttribute("transform") ?? "").includes("rotate(-45")
                && a.left < b.right - 2 && b.left < a.right - 2 && a.top < b.bottom - 5 && b.top < a.bottom - 5
            ).map(([other]) => `${svg.getAttribute("aria-label")}: ${one.textContent} / ${other.textContent}`));
        });
    """)
    assert overlapping == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_is_dark_enough_to_read(page: Browser, scheme: str) -> None:
    page.devtools("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
    contrasts = page.run(_CONTRASTS)
    assert len(contrasts) >= 3
    assert min(contrasts) >= 4.5, "the ratio that the accessibility guidelines ask for"


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
