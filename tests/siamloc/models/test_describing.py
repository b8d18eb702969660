"""Describing images with networks: any module is a descriptor."""

from __future__ import annotations

from threading import Event, Thread

import numpy as np
import pytest
import torch
from torch import nn

from analytic import Description, Descriptor, descriptor
from siamloc.errors import ConfigError, DataError
from siamloc.models import as_descriptor, build
from siamloc.models.describing import chosen_device, evaluating

SIZE = (32, 64)


def make(branch="simple1"):
    return as_descriptor(build(branch, "fc500_500_5", SIZE))


def draw(count=8, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.randint(0, 256, (count, 3, *SIZE), generator=generator, dtype=torch.uint8)


def test_it_is_a_descriptor():
    module = make()
    assert isinstance(module, Descriptor)
    assert (module.name, module.default_distance) == ("network", "euclidean")
    assert module.identity == module.module.identity
    images = draw()
    described = module.describe(images)
    assert isinstance(described, Description)
    assert described.orientation is None
    assert described.position.dtype == np.float32
    assert described.position.shape == (len(images), 5)
    apart = module.pairwise(described, described)
    assert apart[1, 2] == pytest.approx(np.linalg.norm(described.position[1] - described.position[2]), rel=1e-5)


@pytest.mark.parametrize("branch", ["simple1", "vgg11_bn"])
def test_a_description_depends_on_no_other_image_of_the_batch(branch):
    module, images = make(branch), draw(5)
    together = module.describe(images).position
    singles = np.concatenate([module.describe(image).position for image in images])
    np.testing.assert_allclose(together, singles, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(together, module.describe(images, chunk=2).position, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(together, module.describe(images.flip(0)).position[::-1], rtol=1e-4, atol=1e-5)


def test_arrays_tensors_bytes_floating_point_and_grey_images_are_described_alike():
    module, images = make(), draw(3)
    expected = module.describe(images).position
    for same in (images.numpy(), images.float() / 255, images.numpy() / 255.0, (images / 255).numpy()):
        np.testing.assert_allclose(module.describe(same).position, expected, atol=1e-5)
    np.testing.assert_allclose(module.describe(images[0].numpy()).position, expected[:1], atol=1e-5)
    grey = images[:2, 0]  # three would be the channels of one
    expected = module.describe(grey[:, None].repeat(1, 3, 1, 1)).position
    np.testing.assert_array_equal(module.describe(grey).position, expected)
    np.testing.assert_allclose(module.describe(grey[0]).position, expected[:1], atol=1e-5)


def test_describing_restores_the_mode_of_every_part():
    module = make("vgg11_bn")
    module.module.train()
    frozen = module.module.branch.features[1].eval()
    statistics = module.module.branch.features[5].running_mean.clone()
    module.describe(draw(2))
    assert not frozen.training
    assert all(part.training for part in module.module.modules() if part is not frozen)
    assert torch.equal(module.module.branch.features[5].running_mean, statistics)
    with pytest.raises(DataError):
        module.describe(np.zeros((2, 3, 5, 5), np.uint8))
    assert module.module.training
    module.module(draw(2) / 255).sum().backward()
    assert module.module.head.layers[1].weight.grad is not None


def test_threads_that_describe_with_one_network_share_its_mode_and_the_precision():
    module, inside, leave = make("vgg11_bn").module.train(), Event(), Event()

    def describe():
        with evaluating(module.branch):
            inside.set()
            leave.wait(30)

    torch.set_float32_matmul_precision("medium")
    try:
        other = Thread(target=describe)
        other.start()
        inside.wait(30)
        with evaluating(module):
            leave.set()
            other.join()
            assert not any(part.training for part in module.modules())
            assert torch.get_float32_matmul_precision() == "highest"
        assert all(part.training for part in module.modules())
        assert torch.get_float32_matmul_precision() == "medium"
    finally:
        torch.set_float32_matmul_precision("highest")


def test_describing_is_in_full_precision_under_autocast():
    module, images = make(), draw(3)
    expected = module.describe(images).position
    with torch.autocast("cpu", dtype=torch.bfloat16):
        np.testing.assert_array_equal(module.describe(images).position, expected)


@pytest.mark.parametrize(
    ("images", "message"),
    [
        ("photo.jpg", "images must be arrays or tensors"),
        (np.zeros((2, 4, *SIZE), np.uint8), "images must have shape"),
        (np.zeros((0, 3, *SIZE), np.uint8), "images must have shape"),
        (np.zeros((*SIZE, 3), np.uint8), r"channels first, \(3, H, W\), got \(32, 64, 3\): transpose it"),
        (np.zeros((2, 3, 64, 32), np.uint8), r"shape \(B, 3, 32, 64\)"),
        (np.zeros((2, 3, *SIZE), np.int64), "uint8 or floating point"),
        (np.full((2, 3, *SIZE), 200.0), r"must lie in \[0, 1\]"),
        (np.full((2, 3, *SIZE), -0.5), r"must lie in \[0, 1\]"),
        (np.full((2, 3, *SIZE), np.nan), r"must lie in \[0, 1\]"),
    ],
)
def test_images_that_cannot_be_described_are_refused(images, message):
    with pytest.raises(DataError, match=message):
        make().describe(images)


def test_descriptors_stay_as_they_are_and_other_things_are_refused():
    hog = descriptor("hog")
    assert as_descriptor(hog) is hog
    with pytest.raises(ConfigError, match="network must be a Module, or a Descriptor, got 'hog'"):
        as_descriptor("hog")


class Own(nn.Module):
    def __init__(self):
        super().__init__()
        self.layer = nn.Linear(3, 2)

    def forward(self, panorama):
        return self.layer(panorama.mean((2, 3)))


def test_a_module_of_ones_own_is_known_by_its_class_and_its_weights():
    module = Own()
    own = as_descriptor(module, "cpu")
    assert own.describe(draw()).position.shape == (8, 2)
    before = own.identity
    assert before["class"] == "Own"
    with torch.no_grad():
        module.layer.bias += 1
    assert own.identity["weights"] != before["weights"]
    assert own.margin is None


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (lambda found: found - found.mean(0), "when other images are in its batch.* along dim=1 instead of dim=0"),
        (lambda found: nn.functional.normalize(found, dim=0), "when other images are in its batch"),
        (lambda found: nn.functional.dropout(found.repeat(1, 50)), "again: switch dropout .* off in evaluation mode"),
        (nn.BatchNorm1d(2, track_running_stats=False), r"together but not one alone \(ValueError: Expected more"),
        (lambda found: torch.complex(found, found), r"complex numbers.*: return .*torch\.view_as_real"),
    ],
)
def test_a_network_whose_descriptors_depend_on_more_than_the_image_is_refused(changed, message):
    class Changed(Own):
        def forward(self, panorama):
            return changed(super().forward(panorama))

    module = Changed()
    if isinstance(changed, nn.Module):
        module.changed = changed
    for images in (draw(1), draw(4)):
        with pytest.raises(DataError, match=message):
            as_descriptor(module, "cpu").describe(images)


@pytest.mark.parametrize(
    ("layers", "message"),
    [
        (
            [nn.Conv2d(3, 8, 3), nn.BatchNorm2d(8, track_running_stats=False), nn.ReLU()],
            "other images are in its batch",
        ),
        (
            [nn.Flatten(0), nn.Unflatten(0, (1, 3, -1, 1))],
            r"one image but not three at once \(DataError: .*got shape \(1",
        ),
    ],
)
def test_noise_tells_whether_a_network_takes_images_alone(layers, message):
    torch.manual_seed(0)
    module = nn.Sequential(*layers, nn.AdaptiveAvgPool2d(2), nn.Flatten())
    with pytest.raises(DataError, match=message):
        as_descriptor(module, "cpu").describe(torch.rand(1, 3, 16, 32))


def test_a_network_that_fails_on_panoramas_is_named():
    module = nn.Sequential(nn.Flatten(), nn.Linear(7, 3))
    with pytest.raises(DataError, match="the network cannot take panoramas of 3 x 16 x 32: RuntimeError: mat1"):
        as_descriptor(module, "cpu").describe(torch.rand(2, 3, 16, 32))


def test_the_rounding_of_other_kernels_is_no_dependence_on_the_batch():
    class Rounded(Own):
        def forward(self, panorama):
            return super().forward(panorama) * (1 + 0.01 * (len(panorama) > 1))

    assert as_descriptor(Rounded(), "cpu").describe(draw()).position.shape == (8, 2)


@pytest.mark.parametrize("gpus", [0, 2])
def test_auto_is_the_gpu_if_there_is_one(monkeypatch, gpus):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: gpus > 0)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: gpus)
    assert chosen_device("auto") == ("cuda" if gpus else "cpu")
    assert chosen_device("cpu") == chosen_device(torch.device("cpu")) == "cpu"
    here = "auto, cpu, cuda:0, cuda:1" if gpus else "auto, cpu"
    for name in ("cuda:7", "gpu", "xpu", ""):
        message = f"^torch cannot compute on device='{name}' here: use one of {here}$"
        with pytest.raises(ConfigError, match=message):
            chosen_device(name)
