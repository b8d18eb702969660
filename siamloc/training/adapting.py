"""Learning from the order of one drive: its steps, the stretches that are held out, and the check of the result.

A robot drives at changing speed, and stops: numbers of frames do not measure how far two images are apart. So the drive
is divided into steps by what the network sees before the training. A new step begins where a frame is less similar to
the first frame of its step than half way from identical to the median of two frames of the drive. Frames of a robot
that stands still are left out first: a spot would otherwise count as often as it has frames.

Whether the training helped is checked in stretches of the drive that it never learns from. The map is one frame of each
stretch of the whole drive; the queries are frames of the stretches held out, augmented like the training images. An
error is the number of steps between a query and the map frame with the most similar descriptor. The weights from
before, from after, or a mean of both are kept: those with the smallest mean error, if they are better than those from
before beyond doubt: errors are compared query by query, and the mean gain of the frames asked is more than two standard
errors. Queries that show the same frame count once, by their mean. The check asks for the learned part of descriptors;
the colours that maps search by as well are not in it.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from foundation.columns import spread_rows
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.data.places import PlaceSettings
from siamloc.errors import ConfigError, DataError
from siamloc.models.checkpoint import load
from siamloc.models.describing import as_descriptor, comparing, learned
from siamloc.models.network_stages import comparing_weights
from siamloc.models.weights import read_checkpoint
from siamloc.progress import shown
from siamloc.runs import Run
from siamloc.training.batches import BatchAugmentation
from siamloc.training.callbacks import AtomicCheckpoints
from siamloc.training.run_folder import stopped
from siamloc.training.settings import Training

_FRAMES = 50  # at least
_ALIKE = 0.98  # similarity above which two frames are of one step, however alike all frames of the drive are
_STILL = 0.99  # similarity to the last frame that is kept above which the robot stands still: noise leaves 0.994
_IN_ORDER = 0.65  # share of frames that resemble the next one: half of those in no order do, and most of a drive
_STRETCH = 8  # steps
_HELD_OUT = 4  # one stretch of this many
_SAMPLE = 1000  # frames at most from which the median similarity is computed
_QUERIES = 256
_DOUBT = 2.0  # standard errors of the mean gain
_SHARES = (0.0, 0.5, 0.75, 1.0)  # of the weights from after the training


@dataclass(frozen=True)
class Adapting:
    """A drive that a network learns from by its order, and the network's weights from before.

    Attributes:
        drive: frames of the drive in order (n), without those of a robot that stands still; x is the number of the step
            of each frame, y is 0.
        before: weights from before the training, by name.
    """

    drive: FrameTable
    before: Mapping[str, Tensor]

    @classmethod
    def begun(
        cls,
        network: nn.Module,
        images: PanoramaLibrary,
        frames: FrameTable,
        validation: FrameTable | None,
        resumed: Run | None,
        settings: Training,
    ) -> Adapting | None:
        """Divide a drive into steps, if the places are drawn by steps; else return None.

        Args:
            network: the network to train; for a run that is resumed, the network as it was before is used instead.
            images: decoded panoramas of all frames.
            frames: training frames, in order.
            validation: validation frames, which are refused.
            resumed: the run that is resumed, None for a training from the beginning.
            settings: settings of the training.

        Raises:
            ConfigError: validation frames, or a network whose part that compares images has learned nothing yet.
            DataError: several drives, too few frames, frames of one spot, or frames in no order.
        """
        if not isinstance(settings.pairs, PlaceSettings) or settings.pairs.by != "steps":
            return None
        if validation is not None:
            raise ConfigError("pairs.by=steps checks the result on the drive it learns from: leave the validation out")
        part = comparing(network)
        bias = None if part is None else part.first.bias
        if bias is not None and not bias.any():  # biases are 0 until they learn
            raise ConfigError(
                "the part of this network that compares images has learned nothing yet (it starts anew if images have "
                "another width or are no full turn), and pairs.by=steps does not teach it: leave it out by "
                "model.relative=false (from Python relative=False)"
            )
        drives = sorted(set(frames.sequence.tolist()))
        if len(drives) > 1:
            raise DataError(
                f"pairs.by=steps learns from the order of one drive, and the training frames are of {len(drives)} "
                f"({', '.join(name or '(unnamed)' for name in drives[:4])}): choose one of them as "
                "protocol.train.sequences"
            )
        if len(frames) < _FRAMES:
            raise DataError(
                f"pairs.by=steps learns from the order of {_FRAMES} frames of a drive or more, and there are "
                f"{len(frames)}: give more of them"
            )
        if resumed is not None and (resumed.checkpoints / "last.ckpt").is_file():
            network = load(resumed, which="untrained")
        described = _described(network, images, frames)
        moved = np.diff(_parts(described, _STILL), prepend=-1) > 0
        frames, described = frames.take(moved), described[moved]
        steps = steps_of(described)
        if steps[-1] + 1 < 2 * _STRETCH:
            raise DataError(
                f"the frames of this drive look so alike that their number of steps is {steps[-1] + 1}, and "
                f"pairs.by=steps learns from {2 * _STRETCH} or more: give a drive through several rooms"
            )
        successive = np.einsum("nd,nd->n", described[:-1], described[1:])
        if (shown := (successive > _median_similarity(described)).mean()) < _IN_ORDER:
            raise DataError(
                f"the frames of this drive are in no order, or too far apart: only {shown:.0%} look more like the next "
                "one than two frames of the drive usually do. Give them in the order in which they were taken, at most "
                "two metres apart"
            )
        drive = frames.with_columns(x=steps, y=np.zeros(len(steps)), building=[""] * len(steps))
        return cls(replace(drive, unit="steps"), _weights(network))

    @staticmethod
    @contextmanager
    def comparison_kept(network: nn.Module) -> Iterator[None]:
        """Keep the part of a network that compares images as it is: it would need headings to learn.

        Its own inputs are features of the frozen stages, so that it still fits them; `begun` refuses one that has
        learned nothing.
        """
        weights = [weight for weight in comparing_weights(network) if weight.requires_grad]
        for weight in weights:
            weight.requires_grad_(False)
        try:
            yield
        finally:
            for weight in weights:
                weight.requires_grad_(True)

    @property
    def learned(self) -> FrameTable:
        """The frames outside of the stretches that are held out; x is the number of the step."""
        return self.drive.take(~self._held_out)

    @property
    def _held_out(self) -> NDArray[np.bool_]:
        return self.drive.x // _STRETCH % _HELD_OUT == 1

    def keep_the_better(
        self, network: nn.Module, images: PanoramaLibrary, change: BatchAugmentation | None, run: Run, *, writes: bool
    ) -> None:
        """Give the network the weights with the smallest error in the check, and write them as the best checkpoint.

        Args:
            network: the network that was trained.
            images: decoded panoramas of all frames.
            change: augmentation of the queries; None leaves them as they are.
            run: the run, with the weights from after the training in its last checkpoint.
            writes: whether this process writes the checkpoint and prints the result.
        """
        if writes:
            _write_best(run, self.before)  # until the check is over, no command may take what is not checked
        try:
            check = self._checked(network, images, change, _weights(load(run, which="last", network=network)))
        except KeyboardInterrupt as error:
            network.load_state_dict(self.before)
            raise stopped(run, "during the check, which has kept nothing") from error
        if not writes:
            return
        kept, errors = check["kept"], dict(zip(check["shares"], check["errors"], strict=True))
        _write_best(run, _weights(network))
        run.record_check(check)
        best = min(errors, key=lambda share: errors[share])
        result = (
            f"{errors[kept]:.2f} with {100 * kept:.0f} % of the change of the weights, which is kept"
            if kept
            else f"{errors[best]:.2f} at best afterwards, which is no clear gain: the weights from before are kept"
        )
        if shown():
            print(
                f"check on the drive of {check['steps']} steps: {check['frames']} frames held out are found "
                f"{errors[0]:.2f} steps off on average before the training; {result}\ncheckpoint: {run.checkpoint()}",
                file=sys.stderr,
            )

    def _checked(
        self, network: nn.Module, images: PanoramaLibrary, change: BatchAugmentation | None, after: Mapping[str, Tensor]
    ) -> dict[str, Any]:
        """Give the network the weights to keep; return the result of the check as plain values, with the share kept."""
        known, asked, queries = self._check(images, change)
        errors = {}
        for share in _SHARES:
            network.load_state_dict(_mean(self.before, after, share))
            described = learned(network, as_descriptor(network, None).describe(queries).position)
            similarity = described @ _described(network, images, known).T
            errors[share] = np.abs(known.x[similarity.argmax(axis=1)] - asked.x)
        means = {share: float(one.mean()) for share, one in errors.items()}
        frame = np.unique(asked.path, return_inverse=True)[1]
        better = [share for share in _SHARES if clearly_smaller(errors[share], errors[0], frame)]
        kept = min(better, key=lambda share: means[share], default=0.0)
        network.load_state_dict(_mean(self.before, after, kept))
        return {
            "steps": int(self.drive.x[-1]) + 1,
            "frames": int(frame.max()) + 1,
            "shares": list(means),
            "errors": list(means.values()),
            "kept": kept,
        }

    def _check(
        self, images: PanoramaLibrary, change: BatchAugmentation | None
    ) -> tuple[FrameTable, FrameTable, Tensor]:
        """Return the map frames, the query frames and the images of the queries (256, 3, H, W), uint8."""
        steps, held_out = self.drive.x, np.flatnonzero(self._held_out)
        middles = np.arange(_STRETCH / 2, steps[-1] + 1, _STRETCH)
        known = np.abs(steps - middles[:, None]).argmin(axis=1)
        asked = np.setdiff1d(held_out, known)
        asked = asked[np.linspace(0, len(asked) - 1, _QUERIES).round().astype(np.int64)]
        frames = self.drive.take(asked)
        queries = torch.from_numpy(images.batch(images.rows(frames)))
        if change is not None:
            queries = change.effect.apply(queries, change.draw((0,), len(queries), tuple(queries.shape[1:])))
        return self.drive.take(known), frames, queries


def clearly_smaller(errors: NDArray[np.float64], before: NDArray[np.float64], frame: NDArray[np.int64]) -> bool:
    """Return whether errors (q) of queries are smaller than those before (q) by more than two standard errors.

    Args:
        errors: error of each query.
        before: error of the same query before.
        frame: number of the frame that each query shows, from 0; the queries of a frame count once, by their mean.

    Example:
        >>> clearly_smaller(np.array([1.0, 2.0, 0.0]), np.array([4.0, 6.0, 3.0]), np.arange(3))
        True
        >>> clearly_smaller(np.array([1.0, 2.0, 0.0]), np.array([4.0, 1.0, 0.0]), np.arange(3))
        False
    """
    gain = np.bincount(frame, before - errors) / np.bincount(frame)
    return len(gain) > 1 and bool(gain.mean() > _DOUBT * gain.std(ddof=1) / np.sqrt(len(gain)))


def steps_of(descriptors: NDArray[np.float32]) -> NDArray[np.int64]:
    """Number the steps of a drive from the descriptors (n, D) of its frames in order, of unit length.

    Example:
        >>> angle = np.linspace(0, np.pi / 2, 10)
        >>> steps_of(np.column_stack([np.cos(angle), np.sin(angle)])).tolist()
        [0, 0, 0, 1, 1, 1, 2, 2, 2, 3]
    """
    return _parts(descriptors, min((1 + _median_similarity(descriptors)) / 2, _ALIKE))


def _parts(descriptors: NDArray[np.float32], level: float) -> NDArray[np.int64]:
    """Number the parts of a drive: one begins where a frame is less similar than `level` to the first of the last."""
    steps, first = np.zeros(len(descriptors), np.int64), 0
    for row in range(1, len(descriptors)):
        leaves = descriptors[row] @ descriptors[first] < level
        first = row if leaves else first
        steps[row] = steps[row - 1] + leaves
    return steps


def _median_similarity(descriptors: NDArray[np.float32]) -> float:
    """Return the median of the similarities of all frames of a drive, from their descriptors (n, D) of unit length."""
    sample = descriptors[spread_rows(len(descriptors), _SAMPLE)]
    return float(np.median(sample @ sample.T))


def _described(network: nn.Module, images: PanoramaLibrary, frames: FrameTable) -> NDArray[np.float32]:
    """Return the learned part (n, D) of the descriptors of frames."""
    describe = as_descriptor(network, None).describe
    return learned(network, np.concatenate([describe(batch).position for batch in images.batches(frames)]))


def _write_best(run: Run, weights: Mapping[str, Tensor]) -> None:
    """Write weights of the network as the best checkpoint of a run, with all else as in its last."""
    content = read_checkpoint(run.checkpoints / "last.ckpt")
    content["state_dict"].update({f"network.{name}": value for name, value in weights.items()})
    run.record_written(["checkpoints/best.ckpt"])
    AtomicCheckpoints().save_checkpoint(content, run.checkpoints / "best.ckpt")


def _weights(network: nn.Module) -> dict[str, Tensor]:
    """Return a copy of the weights of a network by name, in main memory."""
    return {name: value.detach().cpu().clone() for name, value in network.state_dict().items()}


def _mean(before: Mapping[str, Tensor], after: Mapping[str, Tensor], share: float) -> dict[str, Tensor]:
    """Return the mean of two sets of weights; `share` is the weight of those from after the training."""
    return {
        name: value.lerp(after[name], share) if value.is_floating_point() else value for name, value in before.items()
    }
