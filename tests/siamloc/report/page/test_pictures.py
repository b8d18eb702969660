"""Small and large pictures, and what the plan chooses to show."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from siamloc.data.decoding import Preprocessing
from siamloc.report.page import pictures as module
from siamloc.report.page.markup import tag
from siamloc.report.page.pictures import Decoder, read_large
from siamloc.report.page.plan import error_classes, spread
from tests.siamloc.report import pages


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    folder = tmp_path_factory.mktemp("files")
    paths = [str(folder / f"{i}.jpg") for i in range(150)]
    for i, path in enumerate(paths):
        pages.draw(path, i)
    return paths


@pytest.mark.parametrize("most", [0, 1, 70, 150, 1000])
def test_sheets_keep_to_the_order_and_to_their_number(files: list[str], most: int) -> None:
    decoder = Decoder(pages.SETTINGS)
    decoder.fill_sheets(files, most)
    assert decoder.place == {path: number for number, path in enumerate(files[:most])}, "the first files come first"


def test_large_pictures_are_the_first_that_can_be_read(files: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    decoder = Decoder(pages.SETTINGS)
    wanted = [(decoder, path) for path in ["absent.jpg", *files[:20], files[0]]]
    read_large(wanted)
    assert list(decoder.large) == files[:20]
    assert decoder.missing == {"absent.jpg": "the file does not exist"}
    monkeypatch.setattr(module, "_MOST_LARGE", 5)
    decoder.large.clear()
    read_large(wanted)
    assert list(decoder.large) == files[:5]


def test_omnidirectional_images_are_unwrapped_as_the_run_did(tmp_path: Path) -> None:
    path = str(tmp_path / "ring.jpg")
    pages.draw(path, 5, (240, 320))
    options = {"kind": "polar", "inner": 20, "outer": 110}
    decoder = Decoder({"data": {"image_size": [64, 256], "unwrap": options}})
    expected = Preprocessing.checked((64, 256), options).panorama(path).transpose(1, 2, 0)[..., ::-1]
    picture = decoder.read(path, 10**6)
    assert picture is not None
    np.testing.assert_array_equal(picture, expected)


def test_images_of_a_camera_of_ones_own_are_shown_as_they_are(files: list[str]) -> None:
    own = Decoder({"data": {"image_size": list(pages.SIZE), "unwrap": {"kind": "FishEye", "focal": 3.0}}})
    picture, expected = own.read(files[0], 10**6), Decoder(pages.SETTINGS).read(files[0], 10**6)
    assert picture is not None
    np.testing.assert_array_equal(picture, expected)


@given(st.integers(0, 500), st.integers(1, 60))
def test_every_beginning_of_the_order_is_spread_evenly(n: int, part: int) -> None:
    order = spread(n)
    assert sorted(order.tolist()) == list(range(n))
    first = np.sort(order[:part])
    if len(first) > 1:
        gaps = np.diff([*first, n])
        assert gaps.max() <= 4 * n / len(first) + 1


@given(st.lists(st.floats(0, 1e4), min_size=1, max_size=50))
def test_classes_of_errors_are_round_and_rise(errors: list[float]) -> None:
    limits = error_classes(np.array(errors))
    assert 1 <= len(limits) <= 5
    assert limits == sorted(set(limits))
    assert all(f"{limit:e}"[0] in "125" for limit in limits)
    assert limits[-1] <= max(*errors, 0) * (1 + 1e-6) or len(limits) == 1 or max(errors) == 0


@given(st.text())
def test_text_and_attributes_come_back_as_they_went_in(text: str) -> None:
    text = text.replace("\r", "").replace("\0", "")
    page = pages.parse(tag("p", text, title=text))
    assert page.one("p").text == text
    assert page.one("p").attributes["title"] == text
