"""Building networks: names, seeds, independence, initialization."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import nn

from siamloc.errors import ConfigError, DataError
from siamloc.models import HEADS, build

SIZE = (32, 64)


def same_state(a, b):
    left, right = a.state_dict(), b.state_dict()
    return left.keys() == right.keys() and all(torch.equal(left[key], right[key]) for key in left)


THESIS = {
    "fc500_500_5": (500, 500, 5),
    "fc500_100_10": (500, 100, 10),
    "fc1000_1000_10": (1000, 1000, 10),
    "fc4096_4096_1000": (4096, 4096, 1000),
}


def test_the_heads_of_three_layers_are_those_of_the_thesis():
    literal = {f"{name}_softmax": widths for name, widths in THESIS.items()}
    assert {name: head.widths for name, head in HEADS.items() if len(head.widths) == 3} == THESIS | literal


@pytest.mark.parametrize(("name", "widths"), THESIS.items())
def test_head_has_three_layers_and_nothing_after_the_last(name, widths):
    network = build("simple1", name, SIZE)
    layers = [part for part in network.head.modules() if not list(part.children())]
    assert [type(part).__name__ for part in layers] == ["Flatten", "Linear", "ReLU", "Linear", "ReLU", "Linear"]
    assert [part.out_features for part in layers if isinstance(part, nn.Linear)] == list(widths)
    assert layers[1].in_features == 16 * 4 * 16
    assert network(torch.rand(3, 3, *SIZE)).shape == (3, widths[-1])
    assert network.outputs == widths[-1]


@pytest.mark.parametrize("branch", ["simple1", "vgg11_bn"])
def test_one_seed_gives_one_network_and_another_seed_another(branch):
    first, again, other = (build(branch, "fc500_100_10", SIZE, seed=seed) for seed in (0, 0, 1))
    assert same_state(first, again)
    assert not same_state(first, other)
    names = {"name": "network", "branch": branch, "head": "fc500_100_10", "image_size": [32, 64]}
    assert first.identity == again.identity == {**names, "weights": first.identity["weights"]}
    assert first.identity["weights"] != other.identity["weights"]


@pytest.mark.parametrize("branch", ["simple2", "alexnet", "vgg11", "densenet121"])
def test_the_global_generator_is_neither_moved_nor_read(branch):
    torch.manual_seed(5)
    before = torch.random.get_rng_state()
    first = build(branch, "fc500_500_5", (64, 64), seed=3)
    assert torch.equal(torch.random.get_rng_state(), before)
    torch.manual_seed(6)
    assert same_state(first, build(branch, "fc500_500_5", (64, 64), seed=np.int64(3)))


@pytest.mark.parametrize("branch", ["alexnet", "vgg16", "densenet121"])
def test_initialization_is_he_normal_with_zero_biases(branch):
    network = build(branch, "fc1000_1000_10", (64, 64))
    linears = [part for part in network.modules() if isinstance(part, nn.Linear)]
    for part in network.modules():
        if isinstance(part, (nn.Conv2d, nn.Linear)):
            inputs = part.weight[0].numel()
            expected = (1 / (inputs * 10) if part is linears[-1] else 2 / inputs) ** 0.5
            assert part.weight.std().item() == pytest.approx(expected, rel=0.1)
            assert part.bias is None or not part.bias.any()
        elif isinstance(part, nn.BatchNorm2d):
            assert bool((part.weight == 1).all())
            assert bool((part.running_var == 1).all())
            assert not part.bias.any()
            assert not part.running_mean.any()


@pytest.mark.parametrize("head", ["fc500_500_5", "fc4096_4096_1000"])
@pytest.mark.parametrize("branch", ["simple1", "alexnet", "vgg19", "vgg19_bn", "densenet121"])
def test_descriptors_begin_with_a_length_on_the_scale_of_the_margin(branch, head):
    network = build(branch, head, (64, 64))
    with torch.inference_mode():
        descriptors = network(torch.rand(4, 3, 64, 64, generator=torch.Generator().manual_seed(0)))
    assert 0.1 < descriptors.norm(dim=1).mean().item() < 10


IMAGE_SIZE = r"image_size must be (a list, each item a whole number|\[rows, columns\])"
SIZES = [(128,), (128, 512, 3), 128, "128", (0, 512), (128.0, 512), None]


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"branch": "vgg_16"}, r"unknown branch 'vgg_16': did you mean 'vgg16'\?.*densenet121"),
        ({"head": "fc500_500"}, r"unknown head 'fc500_500': did you mean 'fc500_500_5'\?"),
        *(({"image_size": size}, IMAGE_SIZE) for size in SIZES),
        *(({"seed": seed}, "seed must be a whole number from 0") for seed in (-1, 2**63, 1.5, None, True)),
    ],
)
def test_what_no_network_can_be_built_from_is_refused(given, says):
    with pytest.raises(ConfigError, match=says):
        build(**{"branch": "simple1", "head": "fc500_500_5", **given})


@pytest.mark.parametrize("shape", [(3, 32, 64), (2, 1, 32, 64), (2, 3, 64, 32), (2, 32, 64, 3)])
def test_other_shapes_and_integers_are_refused(shape):
    network = build("simple1", "fc500_500_5", SIZE)
    with pytest.raises(DataError, match=r"floating point in \[0, 1\], got torch.uint8"):
        network(torch.zeros(2, 3, *SIZE, dtype=torch.uint8))
    with pytest.raises(DataError, match=r"shape \(B, 3, 32, 64\), got"):
        network(torch.zeros(shape))
