"""Batch normalization across processes against that of torch; two training processes are in test_fitting.py."""

from __future__ import annotations

import copy

import pytest
import torch
from torch import distributed, nn

from siamloc.training import batch_norm
from siamloc.training.batch_norm import OneBatch


@pytest.fixture
def process(tmp_path, monkeypatch):
    """The only process of a group, which takes itself for one of two."""
    store = distributed.FileStore(str(tmp_path / "store"), 1)
    distributed.init_process_group("gloo", store=store, rank=0, world_size=1)
    monkeypatch.setattr(batch_norm.distributed, "get_world_size", lambda: 2)
    yield
    distributed.destroy_process_group()


@pytest.mark.parametrize(
    ("layer", "shape"),
    [
        (nn.BatchNorm2d(5), (6, 5, 4, 3)),
        (nn.BatchNorm2d(5, momentum=None, eps=1e-3), (6, 5, 4, 3)),
        (nn.BatchNorm2d(5, affine=False, track_running_stats=False), (6, 5, 4, 3)),
        (nn.BatchNorm1d(5), (6, 5)),
        (nn.BatchNorm1d(5), (6, 5, 7)),
    ],
    ids=str,
)
def test_it_normalizes_as_torch_does(process, layer, shape):
    generator = torch.Generator().manual_seed(0)
    ours = nn.Sequential(copy.deepcopy(layer))
    sync = OneBatch(gpu=False)
    assert sync.apply(ours) is ours
    assert type(ours[0]) is not type(layer)
    assert isinstance(ours[0], type(layer))
    for _ in range(3):
        images = (3 + 2 * torch.randn(shape, generator=generator)).requires_grad_()
        weights = torch.randn(shape, generator=generator)
        same = images.detach().clone().requires_grad_()
        expected, found = layer(images), ours(same)
        assert torch.allclose(found, expected, atol=1e-5)
        (expected * weights).sum().backward()
        (found * weights).sum().backward()
        assert torch.allclose(same.grad, images.grad, atol=1e-4)
    sync.revert(ours)
    assert type(ours[0]) is type(layer)
    assert set(vars(ours[0])) == set(vars(layer))
    for name, value in layer.state_dict().items():
        assert torch.allclose(ours[0].state_dict()[name], value, atol=1e-5), name
    assert torch.equal(ours.eval()(images), ours[0](images))


def test_half_precision_comes_back_as_it_came(process):
    layer = nn.Sequential(nn.BatchNorm2d(3))
    OneBatch(gpu=False).apply(layer)
    images = torch.rand(4, 3, 5, 5, generator=torch.Generator().manual_seed(0))
    assert layer(images.bfloat16()).dtype == torch.bfloat16


def test_one_process_has_the_layers_it_had():
    layer = nn.Sequential(nn.BatchNorm2d(3))
    OneBatch(gpu=False).apply(layer)
    assert type(layer[0]) is nn.BatchNorm2d


def test_a_gpu_has_the_layer_of_torch(process):
    network = nn.Sequential(nn.BatchNorm2d(3))
    sync = OneBatch(gpu=True)
    sync.apply(network)
    assert type(network[0]) is nn.SyncBatchNorm
    assert "process_group" in vars(network[0])
    sync.revert(network)
    assert set(vars(network[0])) == set(vars(nn.BatchNorm2d(3)))
