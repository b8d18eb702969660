"""The parts beyond plain localization in a browser: filled, drawn, readable, printed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from siamloc.report.page.write import write_report
from tests.siamloc.report import rich
from tests.siamloc.report.browser import CHROMIUM, DRIVER, Browser

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not CHROMIUM or not DRIVER, reason="chromium and chromium-driver are not installed"),
]

_READY = "[...document.querySelectorAll('.stage canvas')].every((canvas) => canvas.dataset.ready)"
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
    asked = {address for address in page.requests() if not address.startswith(("data:", "chrome"))}
    assert asked == {(run / "report.html").resolve().as_uri()}


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


def test_figures_follow_the_colours_of_the_page(page: Browser) -> None:
    script = "return getComputedStyle(document.querySelector('.curves svg text')).fill"
    light = page.run(script)
    page.devtools("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": "dark"}])
    assert page.run(script) != light


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_is_dark_enough_to_read(page: Browser, scheme: str) -> None:
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    page.devtools("Emulation.setEmulatedMedia", features=features)
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
