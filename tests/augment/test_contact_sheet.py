from itertools import pairwise

import numpy as np
import pytest
import torch

import augment
import augment.contact_sheet
from tests.augment.pictures import panoramas


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float32])
def test_a_sheet_shows_every_effect_at_three_strengths(dtype):
    sheet = augment.preview(panoramas(2, 32, 128, dtype=dtype), cell=64)
    assert sheet.dtype == np.uint8
    assert sheet.shape[2] == 3
    band = sheet[:, 36:100].reshape(len(sheet), -1)  # the first column of pictures, below 36 pixels of margin
    busy = (band.std(axis=1) > 20) & (band.mean(axis=1) < 225)
    starts = np.flatnonzero(busy & ~np.roll(busy, 1))
    rows = 1 + -(-(3 * len(augment.EFFECTS) + 3) // 6)
    assert len(starts) >= rows
    assert (sheet[:, :30] == 255).all(), "no caption is wider than its picture"
    assert (sheet[:, -30:] == 255).all(), "no title is wider than the sheet"


def test_an_effect_of_ones_own_is_shown_at_three_strengths_of_its_ranges(monkeypatch):
    monkeypatch.setattr("augment.contact_sheet.EFFECTS", ("gamma",))
    monkeypatch.setattr("augment.contact_sheet.POLICIES", ("none",))
    monkeypatch.delitem(augment.contact_sheet._SHOTS, "gamma")
    sheet = augment.preview(panoramas(1, 16, 48), cell=48)
    places = [sheet[-46 - 16 : -46 - 2, 36 + 58 * column : 84 + 58 * column] for column in range(4)]
    assert all((one != other).any() for one, other in pairwise(places))


def test_images_whose_columns_do_not_wrap_around_are_not_turned(monkeypatch):
    monkeypatch.setattr("augment.contact_sheet.EFFECTS", ("bulb", "rotate"))
    monkeypatch.setattr("augment.contact_sheet.POLICIES", ("none",))
    batch = panoramas(1, 16, 48)
    sheet = augment.preview(batch, cell=48, circular=False)
    row = sheet[-36 - 16 : -36]
    at_the_edge = row[:, 36 + 2 * 58 : 84 + 2 * 58]
    assert (at_the_edge[:, 24:] == batch[0, :, :, 24:].permute(1, 2, 0).numpy()).all(), "it is not moved"
    assert (at_the_edge[:, :24] != batch[0, :, :, :24].permute(1, 2, 0).numpy()).any(), "it has a spot"
    assert (row[:, 84 + 2 * 58 :] == 255).all(), "rotate is left out"


def test_what_cannot_be_shown():
    with pytest.raises(augment.AugmentError, match="a preview needs at least one panorama"):
        augment.preview(panoramas(0))
    with pytest.raises(augment.AugmentError, match="cell must be a whole number from 1 to 10 million, got 0"):
        augment.preview(panoramas(1), cell=0)
