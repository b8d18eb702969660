import cv2
import numpy as np
import pytest
import torch

import augment
from tests.augment.pictures import generator, panoramas

GREY = torch.full((4, 3, 64, 256), 0.5)


@pytest.mark.parametrize("variance", [0.0025, 0.01])
def test_noise_is_normal_with_its_variance(variance):
    noise = augment.effect("noise", variance=variance)(GREY, generator()) - 0.5
    scaled = noise.flatten(1) / variance**0.5
    assert scaled.mean(1).abs().max() < 0.02
    assert (scaled.var(1) - 1).abs().max() < 0.03
    assert float((scaled.abs() < 1).float().mean()) == pytest.approx(0.6827, abs=0.005)
    assert float((scaled.abs() < 2).float().mean()) == pytest.approx(0.9545, abs=0.003)


def test_noise_of_frames_channels_and_neighbours_is_unrelated():
    noise = augment.effect("noise", variance=0.01)(GREY, generator()) - 0.5
    frames = torch.corrcoef(noise.flatten(1))
    assert (frames - torch.eye(4)).abs().max() < 0.03
    channels = torch.corrcoef(noise.transpose(0, 1).flatten(1))
    assert (channels - torch.eye(3)).abs().max() < 0.03
    lagged = (noise * noise.roll(1, 3)).mean() / noise.var()
    assert lagged.abs() < 0.02


def test_noise_reaches_beyond_the_end_of_its_table():
    effect, batch = augment.effect("noise", variance=0.01), GREY[:1]
    params = effect.draw(generator(), batch)
    params["second"][0] = 2**21 - 5
    out = effect.apply(batch, params) - 0.5
    assert float(out.std()) == pytest.approx(0.1, rel=0.03)


def test_jpeg_is_the_codec():
    effect, batch = augment.effect("jpeg", quality=(20, 40)), panoramas(3, 32, 64)
    params = effect.draw(generator(), batch)
    out = effect.apply(batch, params)
    for frame in range(3):
        image = np.ascontiguousarray(batch[frame].permute(1, 2, 0).numpy()[:, :, ::-1])
        packed = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, int(params["quality"][frame])])[1]
        wanted = cv2.imdecode(packed, cv2.IMREAD_COLOR)[:, :, ::-1]
        assert np.array_equal(out[frame].permute(1, 2, 0).numpy(), wanted)
