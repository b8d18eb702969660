"""Convolutions and pools around the azimuth, and the normalization of images."""

from __future__ import annotations

import copy

import pytest
import torch
import torch.nn.functional as F
from torch import nn

from siamloc.errors import ConfigError
from siamloc.models import BRANCHES, build
from siamloc.models.circular import circular

SIZE = (64, 256)


@pytest.mark.parametrize("branch", BRANCHES)
def test_turning_the_panorama_turns_the_features(branch):
    network = build(branch, "flat", SIZE, circular=True, seed=1).eval()
    panorama = torch.rand(1, 3, *SIZE, generator=torch.Generator().manual_seed(0))
    column = SIZE[1] // network.grid[1]
    assert column * network.grid[1] == SIZE[1]
    with torch.inference_mode():
        features = network.branch(panorama)
        turned = network.branch(panorama.roll(2 * column, dims=3))
    expected = features.roll(2, dims=3)
    assert torch.allclose(turned, expected, atol=1e-5 * float(features.abs().max()))


LAYERS = [
    *(nn.Conv2d(2, 3, *one) for one in ((3, 1, 1), (5, 2, 2), (7, 2, 3), (11, 4, 2), (1, 1, 0), (3, 2, 0))),
    *(nn.MaxPool2d(*one) for one in ((3, 2, 0), (3, 2, 1), (2, 2, 0))),
]


@pytest.mark.parametrize("layer", LAYERS, ids=str)
def test_a_layer_is_that_of_the_repeated_panorama(layer):
    image = torch.rand(1, 2, 16, 32)
    wrapped = circular(copy.deepcopy(layer))(image)
    # Far from the ends of three panoramas side by side the plain layer sees what the wrapped one sees.
    three = layer(torch.cat([image] * 3, dim=3))
    columns = 32 // (layer.stride[0] if isinstance(layer, nn.Conv2d) else layer.stride)
    assert wrapped.shape[3] == columns
    assert torch.allclose(wrapped, three[..., columns : 2 * columns], atol=1e-6)


@pytest.mark.parametrize("columns", [250, 360, 131])
def test_any_width_will_do(columns):
    network = build("panoresnet", "fourier", (64, columns), circular=True).eval()
    with torch.inference_mode():
        assert network(torch.rand(1, 3, 64, columns)).shape == (1, 256)


@pytest.mark.parametrize("branch", ["alexnet", "vgg11", "densenet121", "panoresnet", "simple1"])
def test_weights_and_their_names_are_the_same_as_without(branch):
    plain, wrapped = build(branch, "gem", SIZE, seed=4), build(branch, "gem", SIZE, seed=4, circular=True)
    assert plain.state_dict().keys() == wrapped.state_dict().keys()
    assert all(torch.equal(one, other) for one, other in zip(plain.parameters(), wrapped.parameters(), strict=True))


def test_normalizing_each_image_makes_exposure_and_contrast_of_no_account():
    network = build("simple1", "flat", SIZE, normalize="image").eval()
    image = 0.2 + 0.4 * torch.rand(1, 3, *SIZE, generator=torch.Generator().manual_seed(0))
    with torch.inference_mode():
        found, brighter = network(image), network(0.5 + 0.8 * (image - image.mean()))
        flat = network(torch.full((1, 3, *SIZE), 0.3))
    # The constant that keeps dark images from being divided by 0 is a thousandth of the contrast of bright ones.
    assert F.cosine_similarity(found, brighter).item() > 0.9999
    assert torch.isfinite(flat).all()


def test_another_normalization_is_refused():
    with pytest.raises(ConfigError, match=r"normalize must be channels or image or .* got 'batch'"):
        build("simple1", "flat", SIZE, normalize="batch")
