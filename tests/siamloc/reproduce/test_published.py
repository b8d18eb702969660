import math
import re
from pathlib import Path

import pytest
import yaml

import siamloc.reproduce
from analytic.distances import DISTANCES
from siamloc.jobs.options import choices
from siamloc.reproduce.published import as_printed, measures, published

ROOT = Path(__file__).parents[3]
DOCUMENTS = {
    "T": ROOT / "../shared/seeds/004_thesis_roman_2023_spanish.txt",
    "C": ROOT / "../shared/seeds/003_clustering_compression_2019.txt",
}
CONTENTS = yaml.safe_load(Path(siamloc.reproduce.__file__).with_name("published.yaml").read_text(encoding="utf-8"))
ENTRIES = [published(entry["id"]) for entry in CONTENTS["published"]]
HALVES_THAT_DO_NOT_FIT = {("table_5_7", "VGG16bn"), ("table_5_7", "Simple 2"), ("table_5_10", 14)}
entries = pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.id)


def test_every_id_is_there_once():
    listed = [entry["id"] for entry in CONTENTS["published"]]
    assert len(listed) == len(set(listed))
    assert published("table_5_7") is ENTRIES[listed.index("table_5_7")]


@entries
def test_an_entry_is_whole(entry):
    assert set(entry.protocol) == {"train", "map", "query"}
    assert entry.source.document in {"T", "I", "C", "none"}
    names = [column.name for column in entry.columns]
    assert len(names) == len(set(names))
    assert all(set(row) <= set(names) for row in entry.rows)
    for column in entry.columns:
        assert any(row.get(column.name) is not None for row in entry.rows)
        if column.measure is not None:
            assert CONTENTS["units"][column.unit]["as"] == measures()[column.measure]["unit"]
            assert column.decimals is not None
            assert set(column.at) <= set(CONTENTS["settings"])
        if column.name in ("branch", "head", "distance"):
            labels = {row[column.name] for row in entry.rows if column.name in row}
            assert labels <= {*column.names, *column.names.values()}


def test_rooms_are_those_of_the_data_set():
    rooms = {record.settings["room"] for id in ("table_5_5", "table_5_15") for record in published(id).records()}
    assert rooms == {"1PO-A", "2PO1-A", "2PO2-A", "CR-A", "KT-A", "LO-A", "PA-A", "ST-A", "TL-A"}


def test_names_are_those_of_the_configuration():
    settings = CONTENTS["settings"]
    for name in ("branch", "head", "descriptor"):
        assert set(settings[name]["names"].values()) <= set(choices(settings[name]["key"]))
    assert set(settings["distance"]["names"].values()) <= set(DISTANCES)


@entries
def test_records_are_finite_and_in_the_measures_own_unit(entry):
    records = entry.records()
    cells = [row.get(c.name) for row in entry.rows for c in entry.columns if c.measure is not None]
    assert len(records) == sum(cell is not None for cell in cells)
    keys = [(record.measure, tuple(sorted(record.settings.items(), key=str))) for record in records]
    assert len(keys) == len(set(keys)), "settings that do not tell two numbers apart"
    for record in records:
        assert math.isfinite(record.value)
        assert not [value for value in record.settings.values() if isinstance(value, float) and math.isnan(value)]
        if measures()[record.measure]["unit"] == "share":
            assert 0 <= record.value <= 1
        if record.measure == "silhouette":
            assert -1 <= record.value <= 1


def test_a_record_carries_all_that_it_depends_on():
    record = published("table_5_11").records()[0]
    assert record.measure == "accuracy"
    assert record.value == 0.9435
    network = {"branch": "vgg16", "head": "fc500_500_5", "batch_size": 256, "epochs": 7}
    pairs = {"same_share": 0.05, "different_share": 0.95, "phase": "test", "pairs": "overall"}
    assert record.settings == {"data": "freiburg", **network, **pairs}


def test_what_is_known_only_about_is_marked():
    kitchen = [record for record in published("table_5_15").records() if record.settings["room"] == "KT-A"]
    assert [(record.value, record.relation) for record in kitchen] == [(0, "~"), (0.2704, "="), (0.3027, "=")]
    assert published("c_section_5_4").records()[0].relation == "<"
    assert published("c_section_5_4").records()[0].value == 1


def test_a_misprint_is_kept_in_the_row_and_read_rightly_in_the_record():
    entry = published("table_5_18")
    assert entry.rows[2]["images"] == 4448
    assert {record.settings["images"] for record in entry.records()} == {8486, 44448, 122232, 355584, 358548, 684500}


@pytest.mark.parametrize("number", range(7, 15))
def test_the_overall_accuracy_is_the_mean_of_its_halves(number):
    entry = published(f"table_5_{number}")
    for row in entry.rows:
        fits = abs((row["same"] + row["different"]) / 2 - row["overall"]) < 0.0101
        known = {(entry.id, value) for value in row.values()} & HALVES_THAT_DO_NOT_FIT
        assert fits or known, row


@pytest.mark.parametrize("number", [8, 9, 10])
def test_pairs_come_to_the_same_number_for_each_epoch(number):
    for row in published(f"table_5_{number}").rows:
        pairs = row["same_pairs"] + row["different_pairs"]
        assert pairs == 8704 * row["epochs"]
        assert row["same_share"] + row["different_share"] == 100
        assert round(100 * row["same_pairs"] / pairs) == row["same_share"]


# The transcription against the documents' text: their numbers, never their words.

NUMBER = re.compile(r"(?<![\w%])[-−]?\d+(?:[.,]\d+)?")
TABLES = [entry for entry in ENTRIES if entry.source.table is not None]
SPANS = {
    "section_3_5_1": ("T", "3.5.1. ", "3.5.2. "),
    "section_3_5_1_times": ("T", "3.5.1. ", "3.5.2. "),
    "section_3_5_3": ("T", "3.5.3. ", "3.5.4. "),
    "section_3_5_4": ("T", "3.5.4. ", "3.6. "),
    "section_4_5_4_2": ("T", "4.5.4.2. ", "4.5.4.3. "),
    "figures_4_13_to_4_15": ("T", "4.5.4.3. ", "4.6. "),
    "section_4_6": ("T", "4.6.1. ", "4.8. "),
    "c_section_5_3": ("C", "5.3.1. ", "5.4. "),
    "c_section_5_4": ("C", "5.4. ", "5.5. "),
}
IN_ORDER = ("figures_4_13_to_4_15", "section_4_6")


def lines_of(document):
    path = DOCUMENTS[document]
    if not path.is_file():
        pytest.skip(f"needs {path.name}")
    return path.read_text(encoding="utf-8").splitlines()


def numbers(text):
    return [number.replace("−", "-").replace(",", ".") for number in NUMBER.findall(text)]


def numbers_of(entry, measures_only=False):
    found = []
    for row in entry.rows:
        for column in entry.columns:
            cell = row.get(column.name)
            if cell is not None and (column.measure is not None or not measures_only):
                cell = as_printed(cell, column) if column.measure is not None else str(cell)
                found += numbers(cell.lstrip("~<>").replace(",", " "))
    return found


def starting(lines, start):
    return next(index for index, line in enumerate(lines) if line.strip().startswith(start))


@pytest.mark.data
@pytest.mark.parametrize("entry", TABLES, ids=lambda entry: entry.id)
def test_a_table_has_the_numbers_of_its_document_row_by_row(entry):
    """[I] is checked where the thesis has it appended: its own text has lost a row of table 2."""
    document, number = entry.source.document, entry.source.table
    lines = lines_of("C" if document == "C" else "T")
    if document == "I":
        last = max(index for index, line in enumerate(lines) if line.startswith(f"Table {number}. "))
    else:
        last = starting(lines, f"Cuadro {number}:" if document == "T" else f"Table {number}. ")
    found, expected = numbers("\n".join(lines[last + 1 : last + 200])), numbers_of(entry)
    if entry.id == "table_5_6":  # its labels are fractions with both of their parts
        assert subsequence(expected, found)
    else:
        runs = [found[start : start + len(expected)] for start in range(20)]
        assert expected in runs, next(pair for pair in zip(expected, runs[0], strict=True) if pair[0] != pair[1])


@pytest.mark.data
@pytest.mark.parametrize("id", SPANS)
def test_a_section_names_the_numbers(id):
    document, start, end = SPANS[id]
    lines = lines_of(document)
    first = starting(lines, start)
    text = lines[first : first + starting(lines[first:], end)]
    found, expected = numbers("\n".join(text)), numbers_of(published(id), measures_only=True)
    assert expected
    assert set(expected) <= set(found), set(expected) - set(found)
    if id in IN_ORDER:
        assert subsequence(expected, found)


def subsequence(expected, found):
    rest = iter(found)
    return all(number in rest for number in expected)
