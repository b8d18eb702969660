"""Headings found by a network itself: turns are recovered, but only by networks that wrap around."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch

import analytic
from analytic import AnalyticError, Description
from siamloc.errors import ConfigError
from siamloc.maps.heading import NetworkHeading
from siamloc.models import PlaceModule, SiameseModule, as_descriptor, build
from siamloc.models.network import Network
from siamloc.models.orientation import VALUES, Orientation

SIZE = (64, 256)
SIGNS = [1, -1, -1, -1, 1, 1, 1, 1, 1, 1, 1, -1, 1, -1, 1, -1]


def panoramas(count: int = 2, seed: int = 0) -> np.ndarray:
    """Draw smooth noise that wraps around (count, 3, 64, 256) uint8."""
    noise = np.random.default_rng(seed).random((count, 3, *SIZE), dtype=np.float32)
    wide = np.concatenate([noise, noise, noise], axis=3)
    smooth = np.stack([[cv2.GaussianBlur(one, (0, 0), 4) for one in image] for image in wide])[..., 256:512]
    low, high = smooth.min(), smooth.max()
    return ((smooth - low) / (high - low) * 255).astype(np.uint8)


def network(branch: str = "panoresnet", head: str = "fourier", circular: bool = True, **options):
    return build(branch, head, SIZE, circular=circular, seed=1, **options).eval()


@pytest.mark.parametrize("branch", ["panoresnet", "simple1", "alexnet", "vgg11", "densenet121"])
def test_a_turn_by_whole_columns_of_the_features_comes_back_exactly(branch):
    made = network(branch)
    descriptor, images = as_descriptor(made), panoramas()
    column = SIZE[1] // made.grid[1]
    known = descriptor.describe(images)
    assert known.orientation.shape == (2, 2 * made.grid[1], VALUES)
    for columns in (0, 1, -3):
        turned = descriptor.describe(np.roll(images, columns * column, axis=3))
        expected = np.full(2, columns * 2 * np.pi / made.grid[1])
        np.testing.assert_allclose(descriptor.relative_heading(turned, known), expected, atol=1e-9)


def test_sign_and_unit_are_those_of_the_analytic_descriptors_and_other_turns_are_near():
    descriptor, images = as_descriptor(network()), panoramas(3)
    fs = analytic.descriptor("fs", turns=256)
    for pixels in (40, -101, 7):
        turned = np.roll(images, pixels, axis=3)
        truth = fs.relative_heading(fs.describe(turned), fs.describe(images))
        np.testing.assert_allclose(truth, pixels * 2 * np.pi / 256)
        found = descriptor.relative_heading(descriptor.describe(turned), descriptor.describe(images))
        np.testing.assert_allclose(found, truth, atol=np.radians(3))


def test_both_parts_come_from_one_pass_and_the_batch_does_not_matter():
    made, images = network(), panoramas(5)
    descriptor = as_descriptor(made)
    together = descriptor.describe(images)
    with torch.inference_mode():
        np.testing.assert_allclose(together.position, made(torch.from_numpy(images) / 255).numpy(), atol=1e-6)
    alone = Description.concatenate([descriptor.describe(image) for image in images])
    np.testing.assert_allclose(together.position, alone.position, atol=1e-5)
    np.testing.assert_allclose(together.orientation, alone.orientation, atol=1e-4)
    np.testing.assert_allclose(descriptor.describe(images, chunk=2).orientation, together.orientation, atol=1e-4)
    np.testing.assert_allclose(np.square(together.orientation).mean(axis=(1, 2)), 1, rtol=1e-4)
    for kind in (SiameseModule, PlaceModule):  # which train a network
        inside = as_descriptor(kind(made))
        assert inside.tells_heading
        np.testing.assert_array_equal(inside.describe(images).orientation, together.orientation)


def test_orientation_is_mixed_and_averaged_over_neighbouring_columns():
    part = Orientation(0, (3, 4, 8), (2, 8))
    part.reset()
    features = torch.rand(2, 3, 4, 8, generator=torch.Generator().manual_seed(3))
    rows = features.numpy().reshape(2, 3, 2, 2, 8).mean(axis=3).reshape(2, 6, 8)
    assert set(part.signs.unique().tolist()) == {-1.0, 1.0}
    expected = np.einsum("fc,bck->bkf", part.signs.numpy(), rows)
    expected = expected + np.roll(expected, 1, axis=1)
    expected -= expected.mean(axis=1, keepdims=True)
    expected /= np.sqrt(np.square(expected).mean(axis=(1, 2), keepdims=True))
    np.testing.assert_allclose(part(features).numpy(), expected, atol=1e-5)


def test_the_turn_of_all_pairs_is_that_of_each_pair():
    descriptor = as_descriptor(network())
    queries, references = descriptor.describe(panoramas(3, 1)), descriptor.describe(panoramas(3, 2))
    found = descriptor.align(queries, references)
    by_rows = descriptor.relative_heading(queries, references)
    np.testing.assert_array_equal(np.diag(found.heading), by_rows)
    np.testing.assert_array_equal(found.heading[:, 1], descriptor.relative_heading(queries, references.take([1])))
    np.testing.assert_array_equal(NetworkHeading().relative_heading(queries, references), by_rows)
    with pytest.raises(AnalyticError, match="3 queries need as many references, or one, got 2"):
        descriptor.relative_heading(queries, references.take([0, 1]))


@pytest.mark.parametrize(
    ("head", "circular"),
    [("flat", True), ("gem", True), ("fc500_500_5", True), ("fourier", False), ("magnitudes", False)],
)
def test_other_networks_find_no_headings(head, circular):
    made = network(head=head, circular=circular)
    descriptor = as_descriptor(made)
    assert not descriptor.tells_heading
    seen = descriptor.describe(panoramas())
    assert seen.orientation is None
    with pytest.raises(AnalyticError, match="has no orientation part"):
        descriptor.relative_heading(seen, seen)
    with pytest.raises(ConfigError, match="finds no headings: build one with the head 'fourier' or 'magnitudes' and"):
        made.with_orientation(torch.zeros(1, 3, *SIZE))


def test_an_image_without_anything_to_see_gives_finite_values():
    seen = as_descriptor(network()).describe(np.full((1, 3, *SIZE), 90, np.uint8))
    assert np.isfinite(seen.orientation).all()


def test_a_module_of_ones_own_around_a_network_is_described_by_its_own_forward():
    class Shortened(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.network = network()

        def forward(self, panorama):
            return self.network(panorama)[:, :5]

    class Turned(Network):
        def forward(self, panorama):
            return -super().forward(panorama)

    images, turned = panoramas(), network()
    turned.__class__ = Turned
    for module, expected in (
        (Shortened(), as_descriptor(network()).describe(images).position[:, :5]),
        (turned, -as_descriptor(network()).describe(images).position),
    ):
        seen = as_descriptor(module).describe(images)
        assert seen.orientation is None
        np.testing.assert_allclose(seen.position, expected, atol=1e-5)


def test_an_image_too_narrow_for_finer_features_is_only_described():
    made = build("simple1", "fourier", (32, 24), circular=True)
    assert made.orientation is None
    assert made(torch.zeros(1, 3, 32, 24)).shape == (1, 256)


def test_the_signs_are_those_of_every_map_that_was_made():
    signs = network().orientation.signs
    assert signs[0, :16].tolist() == SIGNS
    assert abs(float(signs.mean())) < 0.02


def test_a_description_compares_with_a_map_that_keeps_its_headings_apart():
    """As when a map's own descriptor compares a live image with the map."""
    descriptor, images = as_descriptor(network()), panoramas()
    seen = descriptor.describe(images)
    bare = Description(seen.position, None, seen.identity)
    assert (descriptor.pairwise(seen, bare).argmin(axis=1) == [0, 1]).all()
    with pytest.raises(AnalyticError, match="no orientation part"):
        descriptor.relative_heading(seen, bare)
    with pytest.raises(AnalyticError, match="no orientation part"):
        Description.concatenate([seen, bare])
