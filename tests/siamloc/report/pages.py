"""Result folders with pictures, and pages read back, for the tests of the report."""

from __future__ import annotations

import base64
import json
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from siamloc.data.frames import FrameTable
from siamloc.evaluation.absolute import with_baseline
from siamloc.maps import VisualMap
from siamloc.report.page.write import write_report
from siamloc.results import read_rows
from tests.siamloc.evaluation import scenes
from tests.siamloc.evaluation.scenes import evaluate_absolute, evaluate_rooms

SIZE = (32, 128)
SETTINGS = {"data": {"image_size": list(SIZE), "unwrap": {"kind": "none"}}}
_VOID = {"meta", "link", "img", "input", "br"}


class Element:
    """An element of a page."""

    def __init__(self, name: str, attributes: dict[str, str]) -> None:
        self.name = name
        self.attributes = attributes
        self.children: list[Element | str] = []

    @property
    def text(self) -> str:
        return "".join(child if isinstance(child, str) else child.text for child in self.children)

    def all(self, name: str | None = None, **wanted: str) -> list[Element]:
        """Return the descendants of a name whose attributes hold these words."""
        found = []
        for child in self.children:
            if isinstance(child, Element):
                fits = all(word in child.attributes.get(k.rstrip("_"), "").split() for k, word in wanted.items())
                found += [child] if name in (None, child.name) and fits else []
                found += child.all(name, **wanted)
        return found

    def one(self, name: str | None = None, **wanted: str) -> Element:
        (found,) = self.all(name, **wanted)
        return found


class _Reader(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.root = Element("", {})
        self.open = [self.root]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        element = Element(tag, {name: value or "" for name, value in attrs})
        self.open[-1].children.append(element)
        if tag not in _VOID:
            self.open.append(element)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop().name == tag, f"</{tag}> closes another element"

    def handle_data(self, data: str) -> None:
        self.open[-1].children.append(data)


def parse(text: str) -> Element:
    """Return a page as elements; elements that are not closed in their order are an error."""
    reader = _Reader()
    reader.feed(text)
    reader.close()
    assert len(reader.open) == 1, f"<{reader.open[-1].name}> is not closed"
    return reader.root


def read_page(path: Path) -> Element:
    return parse(path.read_text(encoding="utf-8"))


def data_of(page: Element, identifier: str) -> Any:
    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is not JSON that browsers read")

    return json.loads(page.one("script", id=identifier).text, parse_constant=refuse)


def sheet_picture(sheets: dict[str, Any], number: int) -> np.ndarray:
    """Cut one picture out of its sheet."""
    sheet = decoded(sheets["images"][number // 64])
    rows, columns, at = sheets["rows"], sheets["columns"], number % 64
    top, left = at // sheets["across"] * rows, at % sheets["across"] * columns
    return sheet[top : top + rows, left : left + columns]


def decoded(text: str) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(base64.b64decode(text), np.uint8), cv2.IMREAD_COLOR)


def draw(path: str, seed: int, size: tuple[int, int] = SIZE) -> np.ndarray:
    """Write a picture of coarse random blocks, which survive being made small, and return it."""
    rng = np.random.default_rng(seed)
    blocks = rng.integers(0, 255, (4, 8, 3), dtype=np.uint8)
    picture = cv2.resize(blocks, size[::-1], interpolation=cv2.INTER_CUBIC)
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(path, picture, [cv2.IMWRITE_JPEG_QUALITY, 95])
    return picture


def drawn(folder: Path, table: FrameTable, seed: int) -> FrameTable:
    """Return the table with a picture for every frame."""
    paths = [str(folder / f"pictures {seed}" / f"{i:04d}.jpg") for i in range(len(table))]
    for i, path in enumerate(paths):
        draw(path, 10_000 * seed + i)
    return table.with_columns(path=paths)


def write_occupancy(folder: Path, corner: np.ndarray, size: int = 40) -> Path:
    """Write the map of a map server, of empty squares with walls around, from a lower left corner in m."""
    picture = np.zeros((size, size), np.uint8)
    picture[1:-1, 1:-1] = 254
    cv2.imwrite(str(folder / "map.pgm"), picture)
    keys = {"image": "map.pgm", "resolution": 0.5, "origin": [*corner.tolist(), 0.0], "negate": 0}
    keys |= {"occupied_thresh": 0.65, "free_thresh": 0.196}
    (folder / "map.yaml").write_text("\n".join(f"{key}: {value}" for key, value in keys.items()), encoding="utf-8")
    return folder / "map.yaml"


def write_evaluation(
    folder: Path,
    known: VisualMap,
    queries: FrameTable,
    *,
    rooms: bool = True,
    headings: bool = True,
    baselines: tuple[str, ...] = ("thumbnail",),
    name: str = "network",
    noise: float = 0.6,
) -> Path:
    """Measure made-up descriptors as an evaluation would, and write the result folder."""
    descriptors = scenes.describe(queries, noise=noise)
    turned = queries.theta + 0.1 if headings else None
    result = evaluate_absolute(known, descriptors, queries, headings=turned)
    for i, other in enumerate(baselines):
        vectors = scenes.describe(queries, seed=9 + i, noise=2.0 + i)
        result = with_baseline(result, other, evaluate_absolute(known, vectors, queries))
    if rooms:
        result = result.joined(evaluate_rooms(known, descriptors, queries))
    result = replace(result, name=name, about={"protocol": "cross_run"}, settings=SETTINGS)
    result.save(folder, pictures=False)
    return folder


def write_run(folder: Path, pictures: Path | None = None, n: int = 60, m: int = 40, **options: Any) -> Path:
    """Write a run with an evaluation and training curves; without a folder of pictures its images do not exist."""
    queries, known = scenes.frames(2, n), scenes.frames(1, m)
    if pictures is not None:
        queries, known = drawn(pictures, queries, 2), drawn(pictures, known, 1)
    visual_map = VisualMap(scenes.describe(known, seed=1), known, {"name": "positions"})
    write_evaluation(folder / "evaluation" / "network", visual_map, queries, **options)
    curves = "epoch,step,train/accuracy,train/loss,val/loss\n0,10,0.5,0.9,1.1\n1,20,0.75,0.5,\n2,30,1.0,0.25,0.4\n"
    (folder / "metrics.csv").write_text(curves)
    return folder


def report(folder: Path, *runs: Path, **options: int) -> Element:
    return read_page(write_report(runs or [folder], folder / "report.html", **options))


def columns_of(run: Path, table: str = "queries") -> dict:
    return read_rows(run / "evaluation" / "network", table)


def rows_of(table: Element) -> list[list[str]]:
    """Return the texts of a table's rows, with the method in front of each."""
    found = []
    for body in table.all("tbody"):
        method = body.all("th", scope="rowgroup")[0].text
        for row in body.all("tr"):
            cells = [
                cell for cell in row.all() if cell.name in ("th", "td") and cell.attributes.get("scope") != "rowgroup"
            ]
            found.append([method, *(cell.text for cell in cells)])
    return found


def notes(page: Element) -> str:
    return " ".join(note.text for note in page.all("p", class_="note"))
