"""A network on a GPU, which convolves in TF32, becomes the file that a robot computes with on its CPU."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import siamloc
from augment.torchvision_compat import ensure_torchvision
from siamloc.data.library import PanoramaLibrary
from siamloc.models import as_descriptor
from siamloc.models.describing import as_float, learned
from siamloc.models.registry import BRANCHES, BranchSpec
from tests.gpu.pretend import NAME

ensure_torchvision()
from torchvision import models  # noqa: E402

SIZES = {"alexnet": (64, 64), "vgg16": (32, 64), "densenet4": (32, 64), "densenet121": (64, 64), "shipped": (64, 256)}


@pytest.fixture
def _densenet(monkeypatch):
    """Writing all 58 dense layers of densenet121 takes ten seconds; they are alike."""
    monkeypatch.setitem(models._api.BUILTIN_MODELS, "densenet4", lambda **_: models.DenseNet(32, (1, 1, 1, 1), 64))
    monkeypatch.setitem(BRANCHES, "densenet4", BranchSpec())


@pytest.mark.usefixtures("_densenet")
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name in ("densenet121", "shipped"))) for name in SIZES]
)
def test_a_network_on_the_gpu_is_exported(gpu, drives, tmp_path, name):
    images, some = PanoramaLibrary(drives[0], tmp_path, image_size=SIZES[name]), drives[0].every(8)
    network = siamloc.models.pretrained() if name == "shipped" else siamloc.models.build(name, "gem", SIZES[name])
    expected = as_descriptor(network, "cpu").describe(images.batch([0, 8])).position
    known = siamloc.maps.build(network, images, some, device=NAME, progress=False)
    refinement = None
    if known.descriptor.compares:
        refinement = siamloc.maps.Refinement("relative", map_digest=known.digest)
    with torch.device(NAME):  # as torch.set_default_device("cuda") does
        bundle = siamloc.runtime.export(network, known, tmp_path / "bundle", refinement=refinement)
    assert next(network.parameters()).is_cuda
    assert bundle.parity["max_relative_difference"] < 1e-5
    np.testing.assert_allclose(known.descriptors, expected, atol=1e-5)
    with torch.no_grad():  # as training computes, which is not precise enough for a file
        trained = network(as_float(torch.from_numpy(images.batch([0])).to(NAME))).cpu().numpy()
    assert np.abs(trained - learned(network, expected[:1])).max() > 1e-5
