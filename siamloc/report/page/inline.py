"""Figures as part of a page: SVG with real text, the page's colours, and ids unique on the page."""

from __future__ import annotations

import re
from itertools import count

from siamloc.report.draw import look
from siamloc.report.draw.look import Picture
from siamloc.report.page.markup import Markup, tag

# Colours of the plots that the page's style sheet names, and replaces in dark mode.
_NAMED = {
    look.INK: "ink",
    look.TEXT: "text",
    look.SOFT: "soft",
    look.GRID: "grid",
    look.PALE: "map",
    look.PAPER: "paper",
    **{colour: f"k{i}" for i, colour in enumerate(look.SERIES)},
}
_COLOUR = re.compile("|".join(_NAMED), re.IGNORECASE)
_REFERENCE = re.compile(r'(?:url\(#|href="#)([^)"]+)')
_STYLE = re.compile(r'style="([^"]*)"')
_PLACE = re.compile(r' (?:d|x|y|transform)="[^"]*"')
_LONG_NUMBER = re.compile(r"-?\d+\.\d{2,}")


def inline(figure: Picture, name: str, title: str) -> Markup:
    """Return a figure as SVG for the page, with its title.

    Args:
        figure: the figure; equal figures give equal text.
        name: name of the figure, unique on the page.
        title: description for screen readers.

    Example:
        >>> figure = Picture(figsize=(2, 1))
        >>> text = inline(figure, "empty", "nothing")
        >>> text.startswith('<figure class="picture"><div class="scroll" tabindex="0"><svg'), "http" in text
        (True, False)
    """
    text = figure.rendered("svg", transparent=True).decode()
    text = text[text.index("<svg") :]
    width, height = (float(part) for part in re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', text).groups())  # type: ignore[union-attr]
    body = text[text.index(">") + 1 : text.rindex("</svg>")]
    body = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", "", body, flags=re.DOTALL)
    body = _own_names(body.replace("xlink:href", "href"), name)
    body = _STYLE.sub(lambda found: f'style="{_restyled(found[1])}"', body)
    body = _PLACE.sub(lambda found: _LONG_NUMBER.sub(_rounded, found[0]), body)
    body = re.sub(r">\s+<", "><", body).strip()
    svg = tag(
        "svg",
        Markup(body),
        viewBox=f"0 0 {width:g} {height:g}",
        role="img",
        aria_label=title,
        # Drawn at its own size, smaller on a narrower page; below two thirds it scrolls.
        style=f"width:{width:g}pt;min-width:{min(width, 0.67 * width + 60):.0f}pt",
    )
    return tag("figure.picture", tag("div.scroll", svg, tabindex=0))


def _own_names(body: str, name: str) -> str:
    """Return the elements with ids unique to this figure, keeping only those that are referred to."""
    numbers = count()
    names = {found: f"{name}-{next(numbers)}" for found in dict.fromkeys(_REFERENCE.findall(body))}
    body = re.sub(r' id="([^"]*)"', lambda found: f' id="{names[found[1]]}"' if found[1] in names else "", body)
    return _REFERENCE.sub(lambda found: found[0].replace(found[1], names[found[1]]), body)


def _restyled(style: str) -> str:
    """Return a style with the page's font and colours."""
    style = re.sub(r"font-family: [^;]*;?", "", style)
    style = re.sub(r"(font: [^;]*?[\d.]+px) [^;]*", r"\1 var(--font)", style)
    style = re.sub(r"\s*([:;,])\s*", r"\1", style)
    return _COLOUR.sub(lambda found: f"var(--{_NAMED[found[0].lower()]})", style)


def _rounded(number: re.Match[str]) -> str:
    return f"{float(number[0]):.1f}".removesuffix(".0")
