"""Normalization of panoramas before a network processes them."""

import numpy as np
import pytest
import torch

from siamloc.models.branch import LEAST_CONTRAST, SURROUNDINGS, by_image, by_surroundings


@pytest.fixture
def panorama():
    return torch.rand(2, 3, 20, 33, generator=torch.Generator().manual_seed(0))


def surroundings_by_loops(image, circular, colours=True):
    """Return what `by_surroundings` should, pixel by pixel, for one image (3, H, W)."""
    _, height, width = image.shape
    reach = round(SURROUNDINGS * height)

    def around(values, y, x):
        rows = [min(max(y + step, 0), height - 1) for step in range(-reach, reach + 1)]
        columns = [x + step for step in range(-reach, reach + 1)]
        columns = [column % width if circular else min(max(column, 0), width - 1) for column in columns]
        return np.mean([[values[..., row, column] for column in columns] for row in rows], axis=(0, 1))

    pixels = [(y, x) for y in range(height) for x in range(width)]
    centred = np.empty_like(image)
    for y, x in pixels:
        mean = around(image, y, x)
        centred[:, y, x] = image[:, y, x] - (mean if colours else mean.mean())
    square = (centred**2).mean(axis=0)
    result = np.empty_like(image)
    for y, x in pixels:
        result[:, y, x] = centred[:, y, x] / (np.sqrt(around(square, y, x)) + LEAST_CONTRAST)
    return result


@pytest.mark.parametrize("colours", [True, False])
@pytest.mark.parametrize("circular", [True, False])
def test_surroundings_as_defined(panorama, circular, colours):
    found = by_surroundings(panorama.double(), circular, colours=colours)
    for image, one in zip(panorama.double().numpy(), found.numpy(), strict=True):
        np.testing.assert_allclose(one, surroundings_by_loops(image, circular, colours), atol=1e-9)


def test_a_coloured_wall_keeps_its_colour_if_it_should():
    wall = torch.tensor([0.1, 0.5, 0.5]).view(1, 3, 1, 1).expand(1, 3, 16, 32)
    assert by_surroundings(wall, circular=True).abs().max() < 1e-4
    red, green, blue = by_surroundings(wall, circular=True, colours=False)[0, :, 8, 8].tolist()
    assert red < -1
    assert green == pytest.approx(blue)
    assert green > 0.5


def test_surroundings_turn_with_the_panorama(panorama):
    turned = by_surroundings(panorama.double().roll(7, dims=3), circular=True)
    torch.testing.assert_close(turned, by_surroundings(panorama.double(), circular=True).roll(7, dims=3))


def test_light_that_varies_over_the_image_matters_little():
    """Half the panorama at a third of the light looks the same away from the edge between the two."""
    panorama = torch.rand(1, 3, 40, 200, generator=torch.Generator().manual_seed(1))
    gain = torch.ones(200)
    gain[:100] = 1 / 3
    before, after = (by_surroundings(images, circular=True) for images in (panorama, panorama * gain))
    reach = 2 * round(SURROUNDINGS * 40) + 1
    inside = slice(reach, 100 - reach)
    # Only the least contrast, 0.03 compared with a third of 0.29, distinguishes them.
    torch.testing.assert_close(after[..., inside], before[..., inside] * 0.86, atol=0.1, rtol=0.1)
    by_whole = by_image(panorama * gain)[..., inside]
    assert (by_whole - by_image(panorama)[..., inside]).abs().mean() > 0.5


def test_a_black_image_stays_finite():
    black = torch.zeros(1, 3, 16, 16)
    assert not by_image(black).any()
    assert not by_surroundings(black, circular=True).any()


@pytest.mark.parametrize("circular", [True, False])
def test_a_panorama_narrower_than_its_surroundings(circular):
    narrow = torch.rand(1, 3, 32, 4, generator=torch.Generator().manual_seed(2)).double()
    found = by_surroundings(narrow, circular)[0].numpy()
    np.testing.assert_allclose(found, surroundings_by_loops(narrow[0].numpy(), circular), atol=1e-9)
