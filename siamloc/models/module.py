"""Base of all training modules: optimizer, logging, and the contents of checkpoints."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from foundation.calls import typed
from siamloc.errors import ConfigError, DataError
from siamloc.lightning import LightningModule
from siamloc.models.cross_entropy import CrossEntropyLoss
from siamloc.models.describing import as_float, comparing, margin_of, orienting
from siamloc.models.descriptor_checks import checked_descriptors, shown
from siamloc.models.drive_figures import RECALL_RADIUS, DriveFigures
from siamloc.models.network import Network
from siamloc.models.network_stages import FrozenStages, comparing_weights, stages
from siamloc.models.registry import Optimizer
from siamloc.models.weights import CONTENT_KEY, FORMAT_VERSION


class NetworkModule(LightningModule):
    """Base of the modules that train a network.

    Args:
        network: (B, 3, H, W) floating point in [0, 1] -> (B, D): what `siamloc.models.build` makes, or any module.
        loss: a module, whose parameters are trained as well, or a function; that of the class if None. If it has a
            method `progress`, this is called before each step with the share of the training that is done.
        optimizer: how the weights are updated.
        recall_radius: radius of the recall on a validation drive, see `DriveFigures`.

    Raises:
        ConfigError: a network that is not a module or lacks the stages to freeze, or a loss that is not callable.
    """

    default_loss: ClassVar[type[nn.Module]]

    @typed
    def __init__(
        self,
        network: nn.Module,
        loss: Callable[..., Any] | None = None,
        optimizer: Optimizer | None = None,
        recall_radius: float = RECALL_RADIUS,
    ) -> None:
        super().__init__()
        self.network = network
        self.loss: Any = self.default_loss() if loss is None else loss
        self.optimizer = Optimizer() if optimizer is None else optimizer
        self._drive = DriveFigures(recall_radius)
        self._figures: dict[str, list[Tensor]] = {}  # of the steps of the epoch
        self.compiled: Callable[..., Any] | None = None  # calls a part of the network, compiled, if steps are compiled
        self._frozen: FrozenStages | None = None
        if (frozen := self.optimizer.frozen_stages) and frozen >= (count := sum(map(bool, stages(network)))):
            raise ConfigError(
                f"optimizer.frozen_stages={frozen} leaves nothing to train: the network has {count} stages, so freeze "
                f"{count - 1} at most"
            )

    @property
    def trained_network(self) -> nn.Module:
        """The network alone, without the loss: it is what is used and exported after the training."""
        return self.network

    @property
    def comparing_network(self) -> Network | None:
        """The network if it learns to compare two images, else None; see `siamloc.models.relative`."""
        learns = any(weight.requires_grad for weight in comparing_weights(self.network))
        return orienting(self.network) if learns else None

    def forward(self, panorama: Tensor) -> Tensor:
        """Compute the descriptors (B, D) of panoramas (B, 3, H, W), floating point in [0, 1]."""
        return self.network(panorama)

    def computed(self, part: Callable[..., Any], *inputs: Tensor) -> Any:
        """Call the network, or a part of it, for a step; in training its compiled form, if steps are compiled."""
        return self.compiled(part, *inputs) if self.training and self.compiled is not None else part(*inputs)

    def log_step(self, loss: Tensor) -> None:
        """Log the loss of a training step; on a CPU also show it in the progress bar, which would make a GPU wait."""
        if self._trainer is not None:
            shown = loss.device.type == "cpu"
            self.log("loss_step", loss.detach(), on_step=True, on_epoch=False, prog_bar=shown, batch_size=1)

    def setup(self, stage: str) -> None:
        """Freeze the first stages of the network until the training ends."""
        if stage == "fit" and self.optimizer.frozen_stages:
            self._frozen = FrozenStages(self.network, self.optimizer.frozen_stages)

    def on_train_start(self) -> None:
        """Switch the frozen stages to evaluation mode, after Lightning has checked the modes of all modules."""
        if self._frozen is not None:
            self._frozen.rest()

    def on_train_batch_start(self, batch: Any, batch_idx: int) -> None:
        """Pass the share of the training that is done, 0 to 1, to a loss that changes during training."""
        progress = getattr(self.loss, "progress", None)
        if callable(progress):
            steps = self.trainer.estimated_stepping_batches
            progress(min(self.trainer.global_step / max(steps - 1, 1), 1.0))

    def teardown(self, stage: str) -> None:
        """Restore the gradients and modes of the frozen stages."""
        frozen, self._frozen = self._frozen, None
        if frozen is not None:
            frozen.thaw()

    def configure_optimizers(self) -> Any:
        """Make the optimizer of all weights, including those of the loss, and the learning rate schedule."""
        settings = self.optimizer
        fused = self.device.type in ("cpu", "cuda") or None  # one kernel for all weights where torch has one
        common: dict[str, Any] = {"lr": settings.learning_rate, "weight_decay": settings.weight_decay, "fused": fused}
        if settings.name == "sgd":
            made: torch.optim.Optimizer = torch.optim.SGD(self.parameters(), momentum=settings.momentum, **common)
        else:
            kind = torch.optim.Adam if settings.name == "adam" else torch.optim.AdamW
            made = kind(self.parameters(), betas=(settings.momentum, 0.999), **common)
        # Gradients of half precision are unscaled before they are clipped, and so not by the optimizer.
        made._step_supports_amp_scaling = False  # type: ignore[attr-defined]
        if settings.schedule == "constant":
            return made
        steps = max(int(self.trainer.estimated_stepping_batches), 2)
        if math.isclose(steps * settings.warm_up, 1):
            steps += 1  # torch divides by the steps after the first of the warm-up
        rate, warm_up = settings.learning_rate, float(settings.warm_up)
        schedule = torch.optim.lr_scheduler.OneCycleLR(made, rate, steps, pct_start=warm_up, cycle_momentum=False)
        return {"optimizer": made, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}

    def content(self) -> dict[str, Any]:
        """Describe in plain values what is trained: the network, the loss, its rooms, and the optimizer."""
        loss: dict[str, Any] = {"class": name_of(self.loss), **getattr(self.loss, "settings", {})}
        if margin_of(self.loss) is not None:
            loss["margin"] = margin_of(self.loss)
        network = getattr(self.network, "_orig_mod", self.network)  # inside a network that was compiled
        model = network.settings if isinstance(network, Network) else {"class": name_of(self.network)}
        rooms = {"rooms": list(self.loss.rooms)} if isinstance(self.loss, CrossEntropyLoss) else {}
        return {"model": model, "loss": loss, **rooms, "optimizer": self.optimizer.plain()}

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Add the content that `siamloc.models.load` needs to a checkpoint."""
        checkpoint[CONTENT_KEY] = {"format": FORMAT_VERSION, **self.content()}

    def log_epoch(self, stage: str, values: Mapping[str, Any]) -> None:
        """Log the figures of an epoch under names such as "train/loss".

        Args:
            stage: "train" or "val", the first part of the names.
            values: the figures by the second part of their names.

        Raises:
            ConfigError: the loss is not finite.
        """
        loss = values.get("loss")
        if loss is not None and not bool(torch.isfinite(torch.as_tensor(loss))):
            raise self.diverged(f"{stage}/loss of epoch {self.current_epoch + 1} is {float(loss)}")
        # The sums are already those of all processes; averaging equal numbers over them changes nothing.
        self.log_dict({f"{stage}/{name}": value for name, value in values.items()}, sync_dist=True)

    def describe_drive(self, batch: Mapping[str, Tensor]) -> None:
        """Describe a batch of map frames and queries of the validation drive, and keep the descriptors.

        Raises:
            DataError: a batch that does not say which frames belong to the map.
        """
        images, network = as_float(batch["images"]), self.comparing_network
        found, parts = (self.network(images), None) if network is None else network.with_orientation(images)
        self._drive.add(batch, checked_descriptors(found, len(images)), parts)

    def drive_figures(self) -> dict[str, Tensor]:
        """Search the queries of the validation drive in the map and return the figures; empty without queries.

        Raises:
            ConfigError: the descriptors are not finite.
        """
        try:
            naming = self.loss.accuracy if isinstance(self.loss, CrossEntropyLoss) else None
            return self._drive.compute(comparing(self.network), naming)
        except FloatingPointError as error:
            raise self.diverged(f"{error} after epoch {self.current_epoch + 1}") from error

    def epoch_sums(self) -> dict[str, Tensor]:
        """Return what the training figures of the current epoch are computed from, for a checkpoint within the epoch.

        In this class: the value of each figure at every step so far (steps,), by the figure's name.
        """
        return {name: torch.stack(each) for name, each in self._figures.items()}

    def load_epoch_sums(self, sums: Mapping[str, Tensor]) -> None:
        """Continue an epoch with the sums that `epoch_sums` returned for a checkpoint."""
        self._figures = {name: list(each) for name, each in sums.items()}

    def diverged(self, sign: str) -> ConfigError:
        """Return the error for a training that diverged; `sign` says what showed it, such as a loss of NaN."""
        rate = self.optimizer.learning_rate
        advice = f"train again with a smaller optimizer.learning_rate than {rate:g}"
        return ConfigError(f"the training diverged: {sign}; {advice}")


def name_of(thing: object) -> str:
    """Return the qualified name of a function, or of the class of an object."""
    return str(getattr(thing, "__qualname__", type(thing).__qualname__))


def checked_loss(loss: Any, kind: object, learned_from: Tensor | None) -> Tensor:
    """Check the output of a loss, and return it as a scalar.

    Args:
        loss: the output.
        kind: the loss itself.
        learned_from: the descriptors of a training step; None where nothing is learned.

    Raises:
        DataError: the output is not one number, or in training a number without a gradient.
    """
    if not isinstance(loss, Tensor) or loss.numel() != 1:
        raise DataError(f"the loss {name_of(kind)} must give one number, got {shown(loss)}")
    if learned_from is not None and not loss.requires_grad:
        what = f"the loss {name_of(kind)} gives a number"
        if not learned_from.requires_grad:
            what = f"the network gives descriptors ({str(learned_from.dtype).removeprefix('torch.')})"
        raise DataError(
            f"{what} without a gradient, so nothing can be learned from it: compute floating point numbers without "
            "detach(), item() or NumPy"
        )
    return loss.squeeze()
