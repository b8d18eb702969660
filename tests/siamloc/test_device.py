"""Which device describes images."""

from __future__ import annotations

import pytest
import torch

from siamloc.device import chosen_device
from siamloc.errors import ConfigError


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
