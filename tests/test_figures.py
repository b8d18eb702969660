"""Every figure of a page follows its record, the file of a benchmark ("Figures" in CONTRIBUTING.md).

A figure is a number in a table, outside of its first column and its heading, or a number in a sentence that has
decimals or a unit. Code is not read.
"""

import json
import operator
import re
from fnmatch import fnmatchcase
from functools import cache
from itertools import product
from pathlib import Path
from statistics import fmean, median

import pytest
import yaml

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks/results"
PAGES = [
    ROOT / "README.md",
    ROOT / "siamloc/models/shipped/README.md",
    *sorted(page for page in (ROOT / "docs").rglob("*.md") if page.parent.name not in ("reference", "reproduced")),
]
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:,\d{3})*(?:\.\d+)?(?:e-?\d+)?(?![\w^]|\.\d)")
UNIT = re.compile(
    r"\s?(?:%|/s|(?:[mck]?m|m?s|[kMG]B|bytes|seconds|minutes|hours|degrees|points?|times|images?/s|frames/s"
    r"|panoramas/s|GFLOP|TFLOP/s)(?!\w)|(?: [a-z]+)? (?:a|per) second)"
)
NEXT = re.compile(r"\s*(?:/|,|→|,? ?(?:to|and|or)\b|\(|,? against)\s*")  # between numbers that share a unit
NAMED = re.compile(r"(?:[Tt]ables?|[Ss]ections?|[Cc]hapters?|Python|eq\.|\[[TIC]\])(?: [\d.]+(?:,| to| and))* $")
COMMENT = re.compile(r"<!-- (record|columns|settings|unmet):\s*(.*?)\s*-->", re.DOTALL)
WAYS = {"mean": fmean, "min": min, "max": max, "median": median}
SIGNS = {"+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv}


def blocks(page):
    """Yield (text, [(kind, words) of its comments]) of each paragraph, list and table of a page."""
    text = re.sub(r"^ *```.*?^ *```$|^#.*?$", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    block, comments = "", []
    for part in re.split(r"(<!--.*?-->)|\n\s*\n", text, flags=re.DOTALL):
        if part and (comment := COMMENT.fullmatch(part)):
            comments.append(comment.groups())
        elif part and part.strip() and not part.startswith("<!--"):
            yield block, comments
            block, comments = part.strip(), []
    yield block, comments


def pieces(block):
    """Split a block into (column, heading, text, whether all numbers are figures) of its cells, or its one text."""
    plain = re.sub(r"\]\([^)]*\)|`[^`]*`|\*", lambda part: "`" if part[0].startswith("`") else "", block)
    if not plain.startswith("|"):
        return [(0, "", " ".join(plain.split()), False)]
    headings, _, *lines = ([cell.strip() for cell in line.strip()[1:-1].split("|")] for line in plain.splitlines())
    return [
        (column, heading, cell, bool(re.match(r"[-+]?\d", cell)))
        for line in lines
        for column, (heading, cell) in enumerate(zip(headings, line, strict=True))
        if column > 0
    ]


def figures(text, every):
    """Find the numbers of a piece of text that are figures: every number, or those with decimals or a unit."""
    found = []
    following = None  # the next number, if it is a figure
    for number in reversed([number for number in NUMBER.finditer(text) if not NAMED.search(text[: number.start()])]):
        chained = following and NEXT.fullmatch(text[number.end() : following.start()])
        is_figure = every or re.search(r"[.e]", number[0]) or UNIT.match(text, number.end()) or chained
        following = number if is_figure else None
        found += [number] if is_figure else []
    return found[::-1]


def expanded(line):
    """Expand {a|b} as a shell does, the last choice first."""
    parts = re.split(r"\{([^{}]*)\}", line)
    choices = [part.split("|") if index % 2 else [part] for index, part in enumerate(parts)]
    return ["".join(chosen) for chosen in product(*choices)]


@cache
def record(name):
    """Read a record: a file in benchmarks/results, or one with its path in the repository."""
    text = (ROOT / name if "/" in name else RESULTS / name).read_text(encoding="utf-8")
    return yaml.safe_load(text) if name.endswith(".yaml") else json.loads(text)


def step(value, name):
    """List what a value of a record has under a name: * and ? as in a shell; NAME=VALUE selects entries of a list."""
    setting, equals, wanted = name.partition("=")
    if equals:
        entries = value if isinstance(value, list) else [value]
        return [entry for entry in entries if str(entry.get(setting)) == wanted]
    if isinstance(value, dict):
        return [value[name]] if name in value else [value[key] for key in value if fnmatchcase(key, name)]
    if isinstance(value, list):
        return value if name == "*" else [value[int(name)]]
    return []


def measured(name, key):
    """Compute what a key of a record says: the mean of what it matches, or its :min and so on, or A / B of two keys."""
    if sign := re.search(r" ([-+*/]) ", key):
        return SIGNS[sign[1]](measured(name, key[: sign.start()]), measured(name, key[sign.end() :]))
    if NUMBER.fullmatch(key):
        return float(key)
    path, _, way = key.partition(":")
    values = [record(name)]
    for part in path.split("."):
        values = [below for value in values for below in step(value, part)]
    assert values, f"{name} has no {key}"
    if way == "count":
        return sum(len(value) for value in values)
    return WAYS[way or "mean"]([float(value) for value in values if value is not None])


def as_written(number, value):
    """Whether a number is a value, rounded as the number is; thousands may end in zeros."""
    digits = number.replace(",", "")
    mantissa, _, exponent = digits.partition("e")
    decimals = len(mantissa.partition(".")[2]) - int(exponent or 0)
    if decimals == 0 and abs(float(digits)) >= 1000:
        decimals = len(digits.rstrip("0")) - len(digits)
    return abs(float(digits) - value) <= 0.5 * 10.0**-decimals * (1 + 1e-9)


def keys(comments):
    """List (record, key) of the comments of a block, in the order of the figures."""
    name, found = "", []
    for line in "\n".join(words for kind, words in comments if kind in ("record", "columns")).splitlines():
        file, key = re.fullmatch(r"(?:(\S+\.(?:json|yaml)) )?(.*)", line.strip()).groups()
        name = file or name
        found += [(name, key) for key in expanded(key)]
    return found


def sorted_figures(block, comments):
    """Split the figures of a block into (measured ones, settings); a setting stands in a phrase, or in a column."""
    phrases = [phrase.strip() for kind, words in comments if kind == "settings" for phrase in words.split(";")]
    for phrase in phrases:
        assert re.search("[A-Za-z]{2}", phrase), f"settings: {phrase} needs a word that says what it is"
    unused, shown, settings = set(phrases), [], []
    cells = pieces(block)
    if any(kind == "columns" for kind, _ in comments):
        cells = sorted(cells, key=lambda cell: cell[0])
    for column, heading, text, every in cells:
        spans = [at for phrase in phrases if not column for at in re.finditer(re.escape(phrase), text)]
        for number in figures(text, every):
            said = {at[0] for at in spans if at.start() <= number.start() < at.end()} | {f"column {heading}"}
            (settings if said & set(phrases) else shown).append(number[0])
            unused -= said
    assert not unused, f"settings: {'; '.join(unused)}: no figure of the text, and no column with figures"
    return shown, settings


def wrong(block, comments):
    """List the figures of a block that differ from their record, or have none."""
    shown, _ = sorted_figures(block, comments)
    wanted = keys(comments)
    if len(shown) != len(wanted):
        return [f"{len(shown)} figures without a setting ({' '.join(shown)}), and {len(wanted)} keys of records"]
    found = [(number, measured(*key), key) for number, key in zip(shown, wanted, strict=True)]
    return [f"{number} is {value:.6g} in {key}" for number, value, key in found if not as_written(number, value)]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_figure_follows_its_record(page):
    errors = [f"{block[:60]!r}: {error}" for block, comments in blocks(page) for error in wrong(block, comments)]
    assert not errors, "\n".join(errors)


def test_most_figures_are_measured():
    counts = [[len(kind) for kind in sorted_figures(*block)] for page in PAGES for block in blocks(page)]
    measured_ones, settings = (sum(kind) for kind in zip(*counts, strict=True))
    assert settings < measured_ones / 10


TABLE = "| | a | b |\n|---|---|---|\n| time [ms] | {} | {} |\n\n<!-- record: RECORD rows.{{a|b}}.*.ms -->"


@pytest.mark.parametrize(
    ("page", "says"),
    [
        ("It takes 2.4 ms.", "and 0 keys"),
        ("It takes 2.5 ms.\n\n<!-- record: RECORD rows.a.*.ms -->", "2.5 is 2.4 "),
        ("It takes 2 ms at least.\n\n<!-- record: RECORD rows.a.*.ms:max -->", "2 is 2.6 "),
        (TABLE.format("3.0", "2.4"), "3.0 is 2.4 "),
        (TABLE.format("2.4", ""), "and 2 keys"),
        (TABLE.format("2.4", "3.0"), ""),
        ("It takes 2.2 to 2.6 ms.\n\n<!-- record: RECORD rows.a.*.ms{:min|:max} -->", ""),
        ("The limit is 5 ms in step 3, see table 5.7.\n\n<!-- settings: limit is 5 ms -->", ""),
    ],
)
def test_a_figure_that_its_record_does_not_have_is_found(page, says, tmp_path):
    rows = {"a": [{"ms": 2.2}, {"ms": 2.6}], "b": [{"ms": 3.04}]}
    (tmp_path / "record.json").write_text(json.dumps({"rows": rows}))
    (tmp_path / "page.md").write_text(page.replace("RECORD", str(tmp_path / "record.json")))
    errors = [error for block in blocks(tmp_path / "page.md") for error in wrong(*block)]
    assert bool(errors) == bool(says)
    assert says in "".join(errors)


def test_every_target_that_is_not_met_is_told():
    told, missed = {}, {}
    for block, comments in (block for page in PAGES for block in blocks(page)):
        for words in (words for kind, words in comments if kind == "unmet"):
            assert "target" in block, f"unmet: {words}: the text before it does not say target"
            name, unmet, _, every = words.split()
            told[name] = (int(unmet), int(every))
    for path in RESULTS.glob("*.json"):
        met = [target["met"] for target in record(path.name).get("targets", [])]
        if not all(met):
            missed[path.name] = (met.count(False), len(met))
    assert told == missed


def test_the_readme_counts_what_the_report_of_published_figures_counts():
    report = (ROOT / "docs/results/reproduced/report.md").read_text(encoding="utf-8")
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    beside = re.findall(r"\| (\d+) of (\d+) \|$", report, flags=re.MULTILINE)
    ours, published = (sum(int(numbers[column]) for numbers in beside) for column in (0, 1))
    assert f"measures {re.search('Reproduced: ([0-9]+)', report)[1]} tables and figures" in readme
    assert f"Of {published} published numbers, {ours} have one of ours next to them." in readme
