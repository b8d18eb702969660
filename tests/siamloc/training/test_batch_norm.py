"""Batch normalization across processes is that of torch."""

from __future__ import annotations

import pytest
from torch import distributed, nn

from siamloc.training.batch_norm import OneBatch


@pytest.mark.parametrize(("processes", "expected"), [(1, nn.BatchNorm2d), (2, nn.SyncBatchNorm)])
def test_several_processes_have_the_layer_of_torch_while_they_train(monkeypatch, processes, expected):
    monkeypatch.setattr(distributed, "is_initialized", lambda: True)
    monkeypatch.setattr(distributed, "get_world_size", lambda: processes)
    network, sync = nn.Sequential(nn.BatchNorm2d(3)), OneBatch()
    sync.apply(network)
    assert type(network[0]) is expected
    assert ("process_group" in vars(network[0])) == (processes > 1)
    sync.revert(network)
    assert type(network[0]) is nn.BatchNorm2d
    assert set(vars(network[0])) == set(vars(nn.BatchNorm2d(3)))
