"""Heads of unit length: what they keep and what they forget."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from siamloc.errors import ConfigError
from siamloc.models import BRANCHES, HEADS, build
from siamloc.models.heads import make_head

SIZE = (64, 256)


def images(count=2, seed=0):
    return torch.rand(count, 3, *SIZE, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("head", ["flat", "gem", "bands", "fourier"])
def test_descriptors_have_unit_length_and_as_many_numbers_as_asked_for(head):
    network = build("simple1", head, SIZE, outputs=7).eval()
    with torch.inference_mode():
        found = network(images())
    assert found.shape == (2, 7)
    assert network.outputs == 7
    assert torch.allclose(found.norm(dim=1), torch.ones(2))
    assert build("simple1", head, SIZE).outputs == 256


def test_the_literal_head_of_the_thesis_is_a_softmax_of_the_other():
    plain, literal = (build("simple1", name, SIZE, seed=3).eval() for name in ("fc500_500_5", "fc500_500_5_softmax"))
    literal.load_state_dict(plain.state_dict())
    with torch.inference_mode():
        found = literal(images())
        raised = plain(images()).exp()
    torch.testing.assert_close(found, raised / raised.sum(dim=1, keepdim=True))
    assert literal.outputs == 5
    assert "our reading" in HEADS["fc500_500_5_softmax"].summary
    chosen = [file.read_text(encoding="utf-8") for file in (Path(__file__).parents[3] / "conf").rglob("*.yaml")]
    assert not any("_softmax" in text for text in chosen)


def test_fourier_is_the_magnitude_of_the_transform_along_the_azimuth():
    network = build("simple1", "fourier", SIZE, outputs=9, seed=3).eval()
    head = network.head
    features = torch.rand(2, 16, 4, 16, generator=torch.Generator().manual_seed(1))
    magnitudes = np.sqrt(np.abs(np.fft.rfft(features.numpy(), axis=3)) ** 2 / 16 + 1e-6).reshape(2, -1)
    expected = magnitudes @ head.layer.weight.detach().numpy().T + head.layer.bias.detach().numpy()
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    with torch.inference_mode():
        assert np.allclose(head(features).numpy(), expected, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("branch", BRANCHES)
@pytest.mark.parametrize("head", ["gem", "bands", "fourier", "magnitudes"])
def test_turning_the_robot_by_a_column_of_the_features_leaves_the_descriptor(branch, head):
    network = build(branch, head, SIZE, circular=True, seed=1).eval()
    panorama, other = images(1, seed=2), images(1, seed=5)
    column = SIZE[1] // network.grid[1]
    with torch.inference_mode():
        found = network(panorama)
        for columns in (1, 3):
            turned = network(panorama.roll(columns * column, dims=3))
            # Rounding alone, while another image is far: both are lengths of differences of unit vectors.
            assert (turned - found).norm() < 1e-5
        assert (network(other) - found).norm() > 1e-3


@pytest.mark.parametrize(("head", "outputs", "over"), [("gem", 3, (2, 3)), ("bands", 12, 3)])
def test_generalized_mean_is_the_average_and_the_maximum_at_its_ends(head, outputs, over):
    pooling = make_head(head, (3, 4, 8), outputs=outputs)
    # All channels have nearly one maximum and means that differ by a tenth. Not below 0.8, whose 200th power is still a
    # number in single precision.
    spread = torch.tensor([0.0, 0.1, 0.2])[:, None, None]
    features = 1 - spread * torch.rand(2, 3, 4, 8, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        pooling.layer.weight.copy_(torch.eye(outputs))
        pooling.layer.bias.zero_()
        for power, pooled in ((1.0, features.mean(dim=over)), (200.0, features.amax(dim=over))):
            pooling.power.fill_(power)
            expected = torch.nn.functional.normalize(pooled.flatten(1))
            # At 200 it lies below the maximum, by a factor of 32 ** (1 / 200) = 1.02 at most.
            assert torch.allclose(pooling(features), expected, rtol=2e-2, atol=0)


def test_outputs_belong_to_heads_that_let_them_be_chosen():
    with pytest.raises(ConfigError, match="the head fc500_500_5 gives 5 numbers, as its name says"):
        build("simple1", "fc500_500_5", SIZE, outputs=7)
    with pytest.raises(ConfigError, match="outputs must be a whole number from 1 to 65,536, got 0"):
        build("simple1", "flat", SIZE, outputs=0)


def magnitudes_of(features) -> np.ndarray:
    squared = np.abs(np.fft.rfft(features.numpy(), axis=3, norm="ortho"))[..., 1:].reshape(len(features), -1) ** 2
    values = (squared + 1e-6) ** 0.35  # never 0, where roots have no slope
    return values / np.linalg.norm(values, axis=1, keepdims=True)


def test_magnitudes_are_those_of_a_fourier_series_without_the_mean_to_a_power_below_one():
    network = build("simple1", "magnitudes", SIZE)
    assert network.outputs == 16 * 4 * 8
    features = torch.rand(3, 16, 4, 16, generator=torch.Generator().manual_seed(2)).double()
    found, expected = network.head.double()(features).numpy(), magnitudes_of(features)
    # As many sums as magnitudes: each has a place and a sign of its own.
    np.testing.assert_allclose(np.sort(np.abs(found)), np.sort(expected), atol=1e-6)  # the basis has single precision
    np.testing.assert_allclose(found @ found.T, expected @ expected.T, atol=1e-6)


@pytest.mark.parametrize("outputs", [100, 256])  # 512 magnitudes: with an incomplete sum, and without
def test_fewer_sums_keep_how_far_apart_descriptors_are(outputs):
    head = build("simple1", "magnitudes", SIZE, outputs=outputs).head.double()
    features = torch.rand(40, 16, 4, 16, generator=torch.Generator().manual_seed(2)).double()
    found, expected = head(features).numpy(), magnitudes_of(features)
    assert found.shape == (40, outputs)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1)
    apart = [np.linalg.norm(one[:20] - one[20:], axis=1) ** 2 for one in (found, expected)]
    # Of 20 squared distances each has a relative error of (2 / outputs) ** 0.5; the scale is common to all.
    ratio = apart[0] / apart[1]
    assert ratio.std() / ratio.mean() < 1.6 * (2 / outputs) ** 0.5
    assert abs(ratio.mean() - 1) < 0.15


def test_magnitudes_forget_a_constant_but_not_the_order_of_rows():
    head = build("simple1", "magnitudes", SIZE).head.double()
    features = torch.rand(1, 16, 4, 16, generator=torch.Generator().manual_seed(3)).double()
    known = head(features)
    torch.testing.assert_close(head(features + torch.rand(1, 16, 4, 1).double()), known)
    assert float((head(features.flip(2)) - known).norm()) > 0.1


def test_magnitudes_train_the_branch_alone_and_have_their_own_size():
    network = build("simple1", "magnitudes", SIZE)
    assert not list(network.head.parameters())
    assert len(network.stages) == 1
    (network(images())[0] @ network(images())[1]).backward()
    assert all(parameter.grad is not None for parameter in network.parameters())
    assert build("panoresnet", "magnitudes", (64, 256)).outputs == 2048
    with pytest.raises(ConfigError, match="needs features of 2 columns, and these have 1: take larger images"):
        build("panoresnet", "magnitudes", (16, 16))
    with pytest.raises(ConfigError, match="the head magnitudes has at most 512 outputs here, one for each magnitude"):
        build("simple1", "magnitudes", SIZE, outputs=513)


def test_pictures_of_nothing_have_a_finite_descriptor_and_slope():
    network = build("simple1", "magnitudes", SIZE)
    features = torch.zeros(1, 16, 4, 16, requires_grad=True)
    found = network.head(features)
    found[0, 0].backward()
    assert torch.isfinite(found).all()
    assert torch.isfinite(features.grad).all()
