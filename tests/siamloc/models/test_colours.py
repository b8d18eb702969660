"""Colours beside what a network learns: against the analytic descriptor, and in maps, files and trainings."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import analytic
import siamloc
from siamloc.errors import ConfigError
from siamloc.models import build
from siamloc.models.colours import WEIGHT, Colours
from siamloc.models.describing import learned
from siamloc.models.registry import COLOURS

SIZE = (16, 32)


def pixels(count: int = 6) -> np.ndarray:
    """Return images (B, 3, H, W), uint8: noise, and few levels, which lie on the edges of bins and have grey pixels."""
    rng = np.random.default_rng(7)
    return np.concatenate([rng.integers(0, 256, (count, 3, *SIZE)), rng.integers(0, 4, (count, 3, *SIZE)) * 85]).astype(
        np.uint8
    )


def as_tensor(images: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(images).float() / 255


def test_colours_are_those_of_hsv_in_four_bands() -> None:
    images = pixels()
    expected = analytic.descriptor("hsv", rows=4).describe(images).position
    found = Colours(SIZE)(as_tensor(images)).numpy()
    assert found.shape == (len(images), COLOURS)
    np.testing.assert_allclose(found, expected * np.sqrt(WEIGHT / 5), atol=1e-6)  # 4 bands of 1 + 1 / 4
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), np.sqrt(WEIGHT), atol=1e-5)


def test_turns_change_no_bit() -> None:
    images, colours = as_tensor(pixels()), Colours(SIZE)
    assert torch.equal(colours(images), colours(images.roll(5, dims=3)))


def test_bands_must_divide_the_rows() -> None:
    with pytest.raises(ConfigError, match="the images have 18 rows: take a multiple of 4"):
        build("simple1", "gem", (18, 32), colours=True)


def test_descriptions_end_with_colours_and_trainings_do_not_see_them() -> None:
    plain, coloured = (build("simple1", "gem", SIZE, seed=3, colours=given).eval() for given in (False, True))
    images = as_tensor(pixels())
    with torch.no_grad():
        assert torch.equal(plain(images), coloured(images))
        (whole,) = coloured.description(images)
    assert whole.shape[1] == coloured.outputs + COLOURS
    assert torch.equal(whole[:, coloured.outputs :], Colours(SIZE)(images))
    described = siamloc.models.as_descriptor(coloured, device="cpu").describe(pixels())
    np.testing.assert_allclose(described.position, whole.numpy(), atol=1e-6)
    assert plain.identity != coloured.identity


def test_a_class_layer_reads_what_is_learned_alone() -> None:
    rooms = siamloc.models.room_classifier.RoomClassifier(["a", "b"], np.eye(2), [0.0, 0.0])
    learned = np.array([[0.0, 1.0]])
    np.testing.assert_array_equal(rooms.scores(np.pad(learned, ((0, 0), (0, COLOURS)))), rooms.scores(learned))


def test_what_is_learned_is_cut_from_a_description() -> None:
    plain, coloured = (build("simple1", "gem", SIZE, seed=3, colours=given).eval() for given in (False, True))
    images = pixels()
    positions = [siamloc.models.as_descriptor(one, device="cpu").describe(images).position for one in (plain, coloured)]
    np.testing.assert_array_equal(learned(coloured, positions[1]), positions[0])
    assert learned(plain, positions[0]) is positions[0]


def test_int8_keeps_the_learned_numbers_of_a_map_as_without_colours(tmp_path) -> None:
    rng = np.random.default_rng(1)
    numbers = rng.normal(size=(4, 32)).astype(np.float32) / 32**0.5
    colours = Colours(SIZE)(as_tensor(pixels(2))).numpy()
    frames = siamloc.data.FrameTable(path=[f"{n}.png" for n in range(4)])
    maps = [
        siamloc.maps.VisualMap(numbers, frames),
        siamloc.maps.VisualMap(np.hstack([numbers, colours]), frames, {"colours": True}),
    ]
    for number, known in enumerate(maps):
        known.save(tmp_path / f"{number}.npz", "int8")
    plain, coloured = (siamloc.maps.VisualMap.load(tmp_path / f"{number}.npz") for number in range(2))
    np.testing.assert_array_equal(coloured.learned, plain.descriptors)
    np.testing.assert_allclose(coloured.descriptors[:, 32:], colours, atol=colours.max() / 254 + 1e-6)
