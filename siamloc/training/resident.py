"""`Resident`: the panoramas of a training in device memory, where batches are gathered without the host."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from siamloc.data.library import PanoramaLibrary

SHARE = 0.25
"""Share of a GPU's free memory that panoramas may take."""
_COPIED_AT_ONCE = 256


class Resident:
    """Hold some panoramas of a library on a device, as 8-bit numbers.

    Args:
        library: decoded panoramas.
        rows: the required rows of the library, in any order; repeats are allowed.
        device: where to hold them; each process has its own copy.

    Attributes:
        images: (N, 3, H, W) uint8.
        numbers: index of each row of the library among the images, (len(library),); -1 for rows that are not held.

    Example:
        >>> import cv2, tempfile
        >>> from pathlib import Path
        >>> from siamloc.data import FrameTable
        >>> folder = Path(tempfile.mkdtemp())
        >>> paths = [folder / f"{number}.png" for number in range(4)]
        >>> for number, path in enumerate(paths):
        ...     _ = cv2.imwrite(str(path), np.full((8, 16, 3), number, np.uint8))
        >>> library = PanoramaLibrary(FrameTable(path=paths), folder / "cache", image_size=(8, 16))
        >>> resident = Resident(library, [3, 1], torch.device("cpu"))
        >>> resident.batch(torch.from_numpy(resident.numbers[[1, 1, 3]]))[:, 0, 0, 0]
        tensor([1, 1, 3], dtype=torch.uint8)
    """

    def __init__(self, library: PanoramaLibrary, rows: ArrayLike, device: torch.device) -> None:
        needed: NDArray[np.int64] = np.unique(np.asarray(rows, dtype=np.int64))
        self.numbers = np.full(len(library), -1, dtype=np.int64)
        self.numbers[needed] = np.arange(len(needed))
        self.images = torch.empty((len(needed), *library.image_shape), dtype=torch.uint8, device=device)
        for start in range(0, len(needed), _COPIED_AT_ONCE):
            part = torch.from_numpy(library.batch(needed[start : start + _COPIED_AT_ONCE]))
            self.images[start : start + len(part)].copy_(part)

    def batch(self, numbers: Tensor) -> Tensor:
        """Return panoramas (B, 3, H, W) by their numbers (B,), which must be on the same device."""
        return self.images.index_select(0, numbers)


def room_for(device: torch.device) -> int:
    """Return how many bytes panoramas may take on a device: a quarter of a GPU's free memory, 0 elsewhere."""
    if device.type != "cuda":
        return 0  # the library is in the same memory
    return int(SHARE * torch.cuda.mem_get_info(device)[0])
