import unicodedata

import pytest

from siamloc.jobs.sweep import Sweep, sweep_suffix


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
