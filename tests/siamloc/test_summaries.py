"""The tables of results: what they hold, and how they are shown."""

import csv
import io

import pytest

from siamloc.evaluation import Result
from siamloc.tables import WIDTH, Column, Table


@pytest.fixture
def wide():
    columns = (Column("method"), Column("lighting"), *(Column(f"figure {i}", "m", 3, part="") for i in range(30)))
    return Table("wide", columns, tuple((name, "all", *range(30)) for name in ("hog", "x" * 40)), "title", ("note",))


def test_a_table_is_never_wider_than_the_console_and_repeats_its_labels(wide):
    lines = wide.text().splitlines()
    assert max(map(len, lines)) <= WIDTH
    assert (lines[0], lines[-1]) == ("title", "note")
    rows = [line.split() for line in lines if line.startswith("hog")]
    assert len(rows) > 1
    assert all(row[1] == "all" for row in rows)
    assert [cell for row in rows for cell in row[2:]] == [f"{i}.000" for i in range(30)]


def test_one_table_is_the_same_as_text_markdown_and_csv():
    columns = (Column("method"), Column("mean", "m", 2), Column("right", form="share"), Column("time", "ms", "short"))
    table = Table("t", columns, (("hog", 1 / 3, (3, 4), 0.001234), ("fs", None, (0, 0), float("nan"))))
    assert [line.split() for line in table.text().splitlines()[-2:]] == [
        ["hog", "0.33", "75.0", "%", "(3/4)", "0.001234"],
        ["fs", "–", "–", "(0/0)", "–"],
    ]
    assert table.markdown().splitlines() == [
        "| method | mean [m] | right | time [ms] |",
        "| --- | ---: | ---: | ---: |",
        "| hog | 0.33 | 75.0 % (3/4) | 0.001234 |",
        "| fs | – | – (0/0) | – |",
    ]
    rows = list(csv.DictReader(io.StringIO(table.csv())))
    assert rows[0] == {"method": "hog", "mean [m]": repr(1 / 3), "right": "0.75", "time [ms]": "0.001234"}
    assert (rows[1]["mean [m]"], rows[1]["time [ms]"]) == ("", "")


def test_wide_letters_count_twice_in_the_alignment():
    table = Table("t", (Column("room"), Column("mean", "m", 2)), (("厨房", 0.5), ("kitchen", 12.25)))
    assert table.text().splitlines()[-2:] == ["厨房      0.50", "kitchen  12.25"]


def test_a_cell_of_a_markdown_table_stays_one_cell():
    table = Table("t", (Column("A|B"), Column("mean", form=2)), (("hall|\nlab", 0.5),))
    assert table.markdown().splitlines() == [r"| A\|B | mean |", "| --- | ---: |", r"| hall\| lab | 0.50 |"]


def measured(told):
    error = {"mean": 0.5, "median": 0.4, "p95": 0.9}
    group = {"queries": 32, "error": error, "floor": {"mean": 0.2}, "excess": {"mean": 0.3}, "recall": []}
    if told:
        group["heading_error"] = {"count": told, "mean": 2.125}
    return {"absolute": {"unit": "m", "radii": [], "map_frames": 8, "overall": group, "lighting": {"night": group}}}


def said(first, **others):
    baselines = {name: Result(name, parts, {}) for name, parts in others.items()}
    return Result("hog", first, {}, baselines=baselines).table().splitlines()


def test_headings_of_some_queries_say_how_many():
    lines = said(measured(10), fs=measured(32), thumbnail=measured(0))
    ends = [line.split()[-2:] for line in lines if line.startswith(("hog", "fs", "thumbnail"))]
    assert ends == [["2.1", "32"], ["2.1", "32"], ["–", "32"]]
    notes = [line for line in lines if line.startswith("heading,")]
    assert notes == ["heading, hog: 10 of 32 queries, where theta is known on both sides"]
