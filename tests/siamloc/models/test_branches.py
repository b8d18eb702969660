"""What each branch is made of, the grid of features that it gives, and how it normalizes images."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import nn

from siamloc.errors import ConfigError
from siamloc.models import BRANCHES, build
from siamloc.models.branch import LEAST_CONTRAST, SURROUNDINGS, by_image, by_surroundings, layer_shapes

# Convolutions of [T] table 5.1; DenseNet-121 has two in each of its 58 layers, three transitions and the first.
CONVOLUTIONS = {
    "simple1": 3,
    "simple2": 3,
    "alexnet": 5,
    "densenet121": 2 * 58 + 3 + 1,
    "vgg11": 8,
    "vgg13": 10,
    "vgg16": 13,
    "vgg19": 16,
    "panoresnet": 1 + 2 * 6 + 3,
    "panoresnet_wide": 1 + 2 * 6 + 3,
}
AT_128_512 = {
    "simple1": (16, 4, 16),
    "simple2": (32, 4, 16),
    "alexnet": (256, 3, 15),
    "densenet121": (1024, 4, 16),
    "vgg": (512, 4, 16),
    "panoresnet": (192, 8, 32),
    "panoresnet_wide": (288, 8, 32),
}
SMALLEST = {"simple1": (4, 16), "simple2": (4, 16), "alexnet": (63, 63), "densenet121": (29, 29), "vgg": (32, 32)}


def family(name):
    return "vgg" if name.startswith("vgg") else name


@pytest.mark.parametrize("name", BRANCHES)
def test_features_have_the_shape_that_was_foreseen_and_end_in_a_relu(name):
    assert layer_shapes(name, (128, 512), False)[-1] == AT_128_512[family(name)]
    size = (70, 150)
    branch, panorama = build(name, "fc500_500_5", size).eval().branch, torch.rand(1, 3, *size)
    before = panorama.clone()
    with torch.inference_mode():
        features = branch(panorama)
    assert features.shape[1:] == layer_shapes(name, size, False)[-1]
    assert features.min() >= 0
    assert torch.equal(panorama, before)


@pytest.mark.parametrize("name", BRANCHES)
def test_number_of_convolutions(name):
    branch = build(name, "fc500_500_5", (64, 64)).branch
    convolutions = [part for part in branch.modules() if isinstance(part, nn.Conv2d)]
    normalizations = [part for part in branch.modules() if isinstance(part, nn.BatchNorm2d)]
    assert len(convolutions) == CONVOLUTIONS[name.removesuffix("_bn")]
    if name.endswith("_bn"):
        assert len(normalizations) == len(convolutions)


@pytest.mark.parametrize(("name", "widths"), [("simple1", [3, 8, 16]), ("simple2", [3, 16, 32])])
def test_simple_branches_have_three_convolutions_each_with_a_relu(name, widths):
    features = build(name, "fc500_500_5").branch.features
    assert [type(part).__name__ for part in features] == ["Conv2d", "ReLU"] * 3 + ["AdaptiveAvgPool2d"]
    assert [part.out_channels for part in features if isinstance(part, nn.Conv2d)] == widths
    assert {part.kernel_size for part in features if isinstance(part, nn.Conv2d)} == {(3, 3)}


@pytest.mark.parametrize("name", ["simple1", "alexnet", "densenet121", "vgg11", "vgg16_bn"])
def test_the_smallest_image_is_taken_and_a_smaller_one_is_not(name):
    rows, columns = SMALLEST[family(name)]
    assert min(layer_shapes(name, (rows, columns), False)[-1]) >= 1
    for size in ((rows - 1, columns), (rows, columns - 1)):
        with pytest.raises(ConfigError, match=rf"{size[0]} x {size[1]} pixels is too small for the branch '{name}'"):
            build(name, "fc500_500_5", size)


def test_input_is_normalized_with_imagenets_numbers_channel_by_channel():
    branch = build("vgg11", "fc500_500_5", (32, 32)).branch.eval()
    panorama = torch.rand(2, 3, 32, 32)
    by_hand = torch.empty_like(panorama)
    for channel, (mean, std) in enumerate(((0.485, 0.229), (0.456, 0.224), (0.406, 0.225))):
        by_hand[:, channel] = (panorama[:, channel] - mean) / std
    torch.testing.assert_close(branch(panorama), branch.features(by_hand))


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
@pytest.mark.parametrize("size", [(20, 33), (32, 4)], ids=["wide", "narrower than its surroundings"])
def test_surroundings_as_defined(size, circular, colours):
    panoramas = torch.rand(2, 3, *size, generator=torch.Generator().manual_seed(0)).double()
    found = by_surroundings(panoramas, circular, colours=colours)
    for image, one in zip(panoramas.numpy(), found.numpy(), strict=True):
        np.testing.assert_allclose(one, surroundings_by_loops(image, circular, colours), atol=1e-9)


def test_a_black_image_stays_finite():
    black = torch.zeros(1, 3, 16, 16)
    assert not by_image(black).any()
    assert not by_surroundings(black, circular=True).any()


def test_colours_are_seen_beside_textures_whatever_the_gain():
    panorama = 0.1 + 0.4 * torch.rand(2, 3, 16, 32, generator=torch.Generator().manual_seed(0))
    branch = build("panoresnet", "gem", (16, 32), circular=True, normalize="local_and_colours").branch
    found = branch.normalized(panorama)
    assert torch.equal(found[:, :3], by_surroundings(panorama, True))
    logarithm = torch.log(panorama.double() + 0.02)
    expected = logarithm - logarithm.mean(dim=(1, 2, 3), keepdim=True)
    torch.testing.assert_close(found[:, 3:], expected.float(), rtol=1e-4, atol=1e-5)
    brighter = branch.normalized(2 * panorama)[:, 3:]  # up to the constant that keeps dark noise small
    assert (brighter - found[:, 3:]).abs().mean() < 0.1 * found[:, 3:].abs().mean()
    warm = panorama * torch.tensor([1.5, 1.0, 0.7]).view(3, 1, 1)
    shift = (branch.normalized(warm)[:, 3:] - found[:, 3:]).mean(dim=(0, 2, 3))
    assert shift[0] > 0.2 > -0.2 > shift[2]


def test_a_branch_of_torchvision_has_no_more_channels():
    with pytest.raises(ConfigError, match="first layer of alexnet has three channels: leave normalize=local_and_col"):
        build("alexnet", "flat", (64, 128), normalize="local_and_colours")
    network = build("simple1", "fc500_500_5", (16, 32), normalize="local_and_colours")
    assert network(torch.rand(1, 3, 16, 32)).shape == (1, 5)
