"""The classes of Lightning that siamloc uses: importing them here makes torchvision, which Lightning imports, work."""
# ruff: noqa: E402

from augment.torchvision_compat import ensure_torchvision

ensure_torchvision()

from lightning.fabric.plugins import TorchCheckpointIO
from lightning.pytorch import Callback, LightningDataModule, LightningModule, Trainer
from lightning.pytorch.callbacks import Checkpoint, ModelCheckpoint, WeightAveraging
from lightning.pytorch.loggers import CSVLogger, Logger, MLFlowLogger, TensorBoardLogger, WandbLogger
from lightning.pytorch.plugins import LayerSync
from lightning.pytorch.utilities.exceptions import SIGTERMException

__all__ = ["Callback", "LayerSync", "LightningDataModule", "LightningModule", "SIGTERMException", "Trainer"]
__all__ += ["Checkpoint", "ModelCheckpoint", "TorchCheckpointIO", "WeightAveraging"]
__all__ += ["CSVLogger", "Logger", "MLFlowLogger", "TensorBoardLogger", "WandbLogger"]
