import numpy as np
import pytest
import torch

import augment
from tests.augment.pictures import panoramas


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float32])
def test_a_sheet_shows_every_effect_at_three_strengths(dtype):
    sheet = augment.preview(panoramas(2, 32, 128, dtype=dtype), columns=6, cell=64)
    assert sheet.dtype == np.uint8
    assert sheet.shape[2] == 3
    band = sheet[:, 36:100].reshape(len(sheet), -1)  # the first column of pictures, below 36 pixels of margin
    busy = (band.std(axis=1) > 20) & (band.mean(axis=1) < 225)
    starts = np.flatnonzero(busy & ~np.roll(busy, 1))
    rows = 1 + -(-(3 * len(augment.EFFECTS) + 3) // 6)
    assert len(starts) >= rows


def test_any_size_and_a_single_panorama():
    assert augment.preview(panoramas(1, 16, 48), columns=3, cell=48).shape[1] == 2 * 36 + 3 * 48 + 2 * 10


def test_what_cannot_be_shown():
    with pytest.raises(augment.AugmentError, match="a preview needs at least one panorama"):
        augment.preview(panoramas(0))
    with pytest.raises(augment.AugmentError, match="columns of a preview must be a multiple of 3, got 4"):
        augment.preview(panoramas(1), columns=4)
    with pytest.raises(augment.AugmentError, match="a batch has shape"):
        augment.preview(torch.zeros(3, 8, 8))
