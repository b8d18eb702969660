import numpy as np
import pytest
import torch

import augment
import augment.contact_sheet
from tests.augment.pictures import panoramas


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float32])
def test_a_sheet_shows_every_effect_at_three_strengths(dtype):
    sheet = augment.preview(panoramas(2, 32, 128, dtype=dtype))
    assert (sheet.dtype, sheet.shape[2]) == (np.uint8, 3)
    busy = (sheet < 225).mean(axis=(1, 2)) > 0.5  # rows of pixels that pictures fill
    rows = 1 + -(-(3 * len(augment.EFFECTS) + len(augment.POLICIES) - 1) // 6)
    assert np.flatnonzero(busy & ~np.roll(busy, 1)).size >= rows - 1  # the last row may be nearly empty


def test_an_effect_of_ones_own_is_shown_at_three_strengths_of_its_ranges(monkeypatch):
    monkeypatch.setattr("augment.contact_sheet.EFFECTS", ("gamma",))
    monkeypatch.setattr("augment.contact_sheet.POLICIES", ("none",))
    sheet = augment.preview(panoramas(1, 16, 48))
    pictures = np.array_split(sheet[len(sheet) // 2 + 40 :, 20:-20], 6, axis=1)
    assert len({picture.mean().round(3) for picture in pictures[:3]}) == 3


def test_what_cannot_be_shown():
    with pytest.raises(augment.AugmentError, match="a preview needs at least one panorama"):
        augment.preview(panoramas(0))
