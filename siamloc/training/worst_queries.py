"""The queries of a validation drive that a trained network locates worst, as a picture for the loggers of its run."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from torch import nn

from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.lightning import Callback, LightningModule, Trainer
from siamloc.models.checkpoint import load
from siamloc.models.describing import as_descriptor
from siamloc.runs import Run
from siamloc.training.loggers import log_picture
from siamloc.training.place_batches import evenly

NAME = "worst_queries"
"""Name of the picture in the loggers."""
_ROWS, _WIDTH, _CAPTION, _GAP = 6, 384, 20, 8  # rows of the picture, and sizes in pixels


class WorstQueries(Callback):
    """Log the worst queries of the validation drive when a training ends, by the network that is kept.

    Args:
        run: run of the training.
        images: panoramas of all frames.
        known: map frames, of which at most 500 are used, evenly spaced.
        queries: validation frames, of which at most 500 are used, evenly spaced.
    """

    def __init__(self, run: Run, images: PanoramaLibrary, known: FrameTable, queries: FrameTable) -> None:
        self._run, self._images = run, images
        self._known, self._queries = (evenly(one.take(one.has_position)) for one in (known, queries))

    def on_fit_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Draw and log the picture, while the loggers are still open; nothing if no frame has a position."""
        if trainer.is_global_zero and trainer.loggers and len(self._known) and len(self._queries):
            network = pl_module.get_submodule("network")
            load(self._run, network=network)
            picture = worst_queries(network, self._images, self._known, self._queries)
            log_picture(trainer.loggers, NAME, picture, trainer.global_step)


def worst_queries(
    network: nn.Module, images: PanoramaLibrary, known: FrameTable, queries: FrameTable, rows: int = _ROWS
) -> NDArray[np.uint8]:
    """Draw the queries with the largest errors: query, retrieved map frame and nearest map frame side by side.

    Args:
        network: (B, 3, H, W) -> (B, D).
        images: panoramas of all frames.
        known: map frames with positions, at least one.
        queries: frames with positions, at least one.
        rows: largest number of queries.

    Returns:
        The picture (rows, columns, 3), uint8, RGB; the query with the largest error comes first.
    """
    describe = as_descriptor(network, None).describe
    described, answers = (
        np.concatenate([describe(batch).position for batch in images.batches(frames)]) for frames in (queries, known)
    )
    apart = np.linalg.norm(queries.xy[:, None] - known.xy, axis=2)
    found = np.linalg.norm(described[:, None] - answers, axis=2).argmin(axis=1)
    nearest = apart.argmin(axis=1)
    error = apart[np.arange(len(queries)), found]
    strips = []
    for row in np.argsort(-error, kind="stable")[:rows].tolist():
        shown = [
            (queries.take([row]), "query"),
            (known.take([found[row]]), f"found, off by {error[row]:.2f} {known.unit}"),
            (known.take([nearest[row]]), f"nearest, {apart[row].min():.2f} {known.unit} away"),
        ]
        strips.append(np.concatenate([_tile(images, frame, words) for frame, words in shown], axis=1))
    return np.concatenate(strips)


def _tile(images: PanoramaLibrary, frame: FrameTable, words: str) -> NDArray[np.uint8]:
    """Return the panorama of a frame under a caption, with a white margin."""
    panorama = np.moveaxis(images.batch(images.rows(frame))[0], 0, -1)
    height = max(1, round(panorama.shape[0] * _WIDTH / panorama.shape[1]))
    tile = np.full((_CAPTION + height + _GAP, _WIDTH + _GAP, 3), 255, dtype=np.uint8)
    tile[_CAPTION : _CAPTION + height, :_WIDTH] = cv2.resize(panorama, (_WIDTH, height), interpolation=cv2.INTER_AREA)
    caption = ", ".join(word for word in (words, frame.sequence[0], frame.room[0]) if word)
    cv2.putText(tile, caption, (0, _CAPTION - 6), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 0), 1, cv2.LINE_AA)
    return tile
