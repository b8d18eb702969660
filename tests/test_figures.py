"""Every figure of a page follows its record, the file of a benchmark ("Figures" in CONTRIBUTING.md).

A figure is a number in a table, outside of its first column and its heading, or a number in a sentence that has
decimals or a unit. Code is not read.
"""

import json
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
COMMENT = re.compile(r"<!-- ?(?=record|columns|settings|unmet)(.*?)-->", re.DOTALL)
WAYS = {"mean": fmean, "min": min, "max": max, "median": median}


def blocks(page):
    """Yield (text, comments) of each paragraph, list and table of a page; a comment belongs to the block before it."""
    text = re.sub(r"^ *```.*?^ *```$|^#.*?$", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    block = ""
    comments = []
    for part in re.split(r"(<!--.*?-->)|\n\s*\n", text, flags=re.DOTALL):
        if part and (comment := COMMENT.fullmatch(part)):
            comments.append(comment[1])
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
    return json.loads(text) if name.endswith(".json") else yaml.safe_load(text)


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
    """Compute what a key of a record says: the mean or another way of what it matches, or a sum, product ... of two."""
    first, *rest = re.split(r" ([-+*/]) ", key)
    if rest:
        operator, second = rest
        a, b = (measured(name, term) for term in (first, second))
        return {"*": a * b, "/": a / b if b else float("nan"), "+": a + b, "-": a - b}[operator]
    if NUMBER.fullmatch(key):
        return float(key)
    path, _, way = key.partition(":")
    values = [record(name)]
    for part in path.split("."):
        values = [below for value in values for below in step(value, part)]
    if not values:
        raise KeyError(f"{name} has no {key}")
    if way == "count":
        return float(sum(len(value) for value in values))
    return WAYS[way or "mean"]([float(value) for value in values if value is not None])


def as_written(number, value):
    """Whether a number is a value, rounded as the number is; thousands may end in zeros."""
    digits = number.replace(",", "")
    mantissa, _, exponent = digits.partition("e")
    decimals = len(mantissa.partition(".")[2]) - int(exponent or 0)
    if decimals == 0 and abs(float(digits)) >= 1000:
        decimals = len(digits.rstrip("0")) - len(digits)
    return abs(float(digits) - value) <= 0.5 * 10.0**-decimals * (1 + 1e-9)


def wrong(block, comments):
    """List what is wrong with a block: figures that differ from their record, or have none."""
    keys, phrases, name = [], [], ""
    for kind, _, body in (comment.partition(":") for comment in comments):
        for line in body.strip().splitlines():
            if kind == "settings":
                phrases += [phrase.strip() for phrase in line.split(";")]
            elif kind in ("record", "columns"):
                file = re.match(r"\S+\.(?:json|yaml)\s+", line)
                name = file[0].strip() if file else name
                keys += [(name, key) for key in expanded(line[file.end() :] if file else line.strip())]
    unused = set(phrases)
    shown = []
    cells = pieces(block)
    if any(comment.startswith("columns") for comment in comments):
        cells = sorted(cells, key=lambda cell: cell[0])
    for _, heading, text, every in cells:
        spans = [(at.start(), at.end(), phrase) for phrase in phrases for at in re.finditer(re.escape(phrase), text)]
        for number in figures(text, every):
            said = {phrase for start, end, phrase in spans if start <= number.start() < end}
            said |= {f"column {heading}"} & set(phrases)
            unused -= said
            shown += [] if said else [number[0]]
    errors = [f"{phrase!r} is not in the text, or has no figure" for phrase in sorted(unused)]
    if len(shown) != len(keys):
        missing = "have no record" if not keys else f"have {len(keys)} keys"
        return [*errors, f"{len(shown)} figures {missing}: {' '.join(shown)}"]
    for number, (name, key) in zip(shown, keys, strict=True):
        try:
            value = measured(name, key)
        except (KeyError, IndexError, ValueError, FileNotFoundError) as error:
            errors.append(f"{number}: {name} {key}: {error!r}")
        else:
            errors += [] if as_written(number, value) else [f"{number} is {value:.6g}: {name} {key}"]
    return errors


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_figure_follows_its_record(page):
    errors = [f"{block[:60]!r}: {error}" for block, comments in blocks(page) for error in wrong(block, comments)]
    assert not errors, "\n".join(errors)


def test_every_target_that_is_not_met_is_told():
    told = {}
    for page in PAGES:
        for block, comments in blocks(page):
            for comment in comments:
                if unmet := re.fullmatch(r"unmet: (\S+) (\d+) of (\d+)\s*", comment):
                    assert "target" in block, f"{page.name}: {comment} follows a text without the word target"
                    told[unmet[1]] = (int(unmet[2]), int(unmet[3]))
    missed = {}
    for path in sorted(RESULTS.glob("*.json")):
        targets = [target["met"] for target in record(path.name).get("targets", [])]
        if not all(targets):
            missed[path.name] = (targets.count(False), len(targets))
    assert told == missed


def test_the_readme_counts_what_the_report_of_published_figures_counts():
    report = (ROOT / "docs/results/reproduced/report.md").read_text(encoding="utf-8")
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    studies = re.search(r"^# Reproduced: (\d+)", report)[1]
    beside = re.findall(r"\| (\d+) of (\d+) \|$", report, flags=re.MULTILINE)
    ours, published = (sum(int(pair[column]) for pair in beside) for column in (0, 1))
    claims, *verdicts = re.search(r"Of (\d+) claims (\d+) hold, (\d+) do not, and (\d+) cannot", report).groups()
    assert f"measures {studies} tables and figures" in readme
    assert f"Of {published} published numbers, {ours} have one of ours next to them." in readme
    assert (
        f"Of {claims} claims in the texts, {verdicts[0]} hold here, {verdicts[1]} do not, and {verdicts[2]}" in readme
    )
