"""Training with Lightning on the pretended GPU."""

from __future__ import annotations

import torch

from augment.torchvision_compat import ensure_torchvision
from tests.gpu.pretend import NAME

ensure_torchvision()
from lightning.pytorch import Callback, Trainer  # noqa: E402, F401
from lightning.pytorch.accelerators import Accelerator  # noqa: E402
from lightning.pytorch.plugins import MixedPrecision  # noqa: E402
from lightning.pytorch.strategies import SingleDeviceStrategy  # noqa: E402

FIRST = 2  # the steps before may make tables that are kept


class PretendAccelerator(Accelerator):
    """What Lightning asks about a device."""

    def setup_device(self, device): ...
    def teardown(self): ...
    @staticmethod
    def parse_devices(devices):
        return [torch.device(NAME, 0)]

    @staticmethod
    def get_parallel_devices(devices):
        return devices

    @staticmethod
    def auto_device_count():
        return 1

    @staticmethod
    def is_available():
        return True

    @staticmethod
    def name():
        return NAME


def pretend_trainer(precision="bf16-mixed", **more):
    """Return arguments of `lightning.Trainer` for the pretended GPU."""
    plugins = [MixedPrecision(precision, device=NAME)] if precision == "bf16-mixed" else []
    strategy = SingleDeviceStrategy(device=torch.device(NAME, 0))
    return {"accelerator": PretendAccelerator(), "strategy": strategy, "plugins": plugins, **more}


class Steps(Callback):
    """Record what happens from the beginning of a step to the end of the last one, with all that lies between steps.

    Attributes:
        waits: of the host for the device, by their places.
        count: number of steps.
    """

    def __init__(self, gpu):
        self._gpu = gpu
        self.waits, self.count = {}, 0

    def on_train_batch_start(self, trainer, pl_module, batch, batch_idx):
        if batch_idx == FIRST:
            self._gpu.clear()

    def on_train_batch_end(self, trainer, pl_module, outputs, batch, batch_idx):
        self.waits, self.count = dict(self._gpu.waits), batch_idx - FIRST + 1
