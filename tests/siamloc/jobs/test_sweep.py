import unicodedata

import pytest

from siamloc.jobs.sweep import Sweep, run_folder, sweep_suffix
from siamloc.runs import Run


def folder(**words):
    return Sweep(words=words).run(sweep_suffix)


def test_usual_settings_name_a_folder_by_themselves():
    assert folder(seed="1", **{"model/branch": "vgg11"}) == "model-branch-vgg11_seed-1"
    words = {"data.root": "data/läufe", "data.image_size": "[64,256]", "query": """['cloudy1',"night2"]"""}
    assert folder(**words) == "data.image_size--64-256-_data.root-data-läufe_query--cloudy1-night2-"
    assert folder(key="a" * 200) == f"key-{'a' * 146}-e32af2fa"


@pytest.mark.parametrize(
    "values",
    [
        ("['Tag (1)']", "['Tag 1']", "['Tag [1]']", "['Tag-1']"),
        ("['night']", "['night*']", "['night:']"),
        ("🤖", "👋", "-"),
        ("é", unicodedata.normalize("NFD", "é")),
    ],
)
def test_values_that_differ_in_symbols_have_folders_of_their_own(values):
    assert len({folder(key=value) for value in values}) == len(values)
    assert folder(key="['a (1)']") == folder(key='["a (1)"]'), "quotes say nothing"


def test_a_folder_can_be_made_for_long_names_in_any_script():
    first, second = (folder(key=f"['{'가' * 97}{end}']") for end in "ab")
    assert first != second
    assert len(first.encode()) < 255


@pytest.mark.parametrize(
    ("words", "shared", "name"),
    [
        ({"seed": "1"}, {"pairs.places": "8", "pairs": "in_batch"}, "pairs.places-8_seed-1"),
        ({}, {"pairs.places": "8", "seed": "1"}, "pairs.places-8_seed-1"),
        ({"seed": "1"}, {"pairs.places": "9"}, "seed-1"),
        ({"pairs.places": "8", "seed": "1"}, {}, "pairs.places-8_seed-1"),
        ({"seed": "2"}, {"pairs.places": "8"}, "seed-2"),
        ({"pairs.radius": "1"}, {"seed": "0"}, "pairs.radius-1.0"),
        ({"pairs.radius": "2.0"}, {"seed": "0"}, "pairs.radius-2.0"),
    ],
)
def test_a_training_has_the_folder_that_an_earlier_sweep_gave_it(tmp_path, words, shared, name):
    for folder in ("pairs.places-8_seed-1", "pairs.radius-1.0"):
        Run(tmp_path / folder).start({}, [])
    assert Sweep(words=words, number=0, shared=shared).run(run_folder, tmp_path) == tmp_path / name


def test_a_folder_with_a_checksum_is_found_again(tmp_path):
    first = Sweep(words={"query": "['a (1)']", "seed": "1"}).run(run_folder, tmp_path)
    Run(first).start({}, [])
    assert Sweep(words={"seed": "1"}, shared={"query": "['a (1)']"}).run(run_folder, tmp_path) == first
