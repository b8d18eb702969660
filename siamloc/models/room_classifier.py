"""Name the room from a descriptor, with the class layer trained by `CrossEntropyLoss`. Loads no torch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from siamloc.errors import DataError
from siamloc.models.registry import COLOURS


@dataclass(frozen=True, eq=False)
class NamedRooms:
    """The rooms that a classifier names for n images.

    Attributes:
        room: (n,) the most probable room of each image.
        probabilities: (n, r) probability of each room; each row sums to 1.
        names: (r,) the rooms.
    """

    room: NDArray[np.str_]
    probabilities: NDArray[np.float64]
    names: NDArray[np.str_]


@dataclass(frozen=True, eq=False)
class RoomClassifier:
    """Name rooms from descriptors with one fully connected layer and a softmax. Immutable.

    Attributes:
        names: (r,) the rooms, named as in `FrameTable.place`; each once.
        weight: (r, D) float32.
        bias: (r,) float32.

    Raises:
        DataError: parts that do not match.

    Example:
        >>> rooms = RoomClassifier(["hall", "office"], [[1.0, 0.0], [0.0, 1.0]], [0.0, 0.0])
        >>> rooms.named([[5.0, 0.0], [0.0, 5.0]]).room
        array(['hall', 'office'], dtype='<U6')
    """

    names: NDArray[np.str_]
    weight: NDArray[np.float32]
    bias: NDArray[np.float32]

    def __post_init__(self) -> None:
        names = np.array(self.names, dtype=np.str_)
        weight, bias = (np.array(part, dtype=np.float32) for part in (self.weight, self.bias))
        if names.ndim != 1 or not len(names) or weight.ndim != 2 or {len(weight), bias.size} != {len(names)}:
            raise DataError(
                f"a class layer has a name, a row of weights and a bias for each room, got {names.shape}, "
                f"{weight.shape} and {bias.shape}"
            )
        if len(set(names.tolist())) < len(names):
            raise DataError("a class layer names a room twice")
        for name, array in (("names", names), ("weight", weight), ("bias", bias.reshape(-1))):
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.names)

    def scores(self, descriptors: ArrayLike) -> NDArray[np.float64]:
        """Return the scores (n, r) of descriptors (n, D); their softmax gives the probabilities.

        Colours after the D learned numbers are not read.

        Raises:
            DataError: descriptors of another length.
        """
        found = np.asarray(descriptors, dtype=np.float64)
        learned = self.weight.shape[1]
        if found.ndim != 2 or found.shape[1] not in (learned, learned + COLOURS):
            raise DataError(
                f"the class layer reads descriptors of {self.weight.shape[1]} numbers (n, {self.weight.shape[1]}), got "
                f"{found.shape}"
            )
        return found[:, :learned] @ self.weight.T.astype(np.float64) + self.bias

    def named(self, descriptors: ArrayLike) -> NamedRooms:
        """Return the rooms that descriptors (n, D) show, with probabilities.

        Raises:
            DataError: descriptors of another length.
        """
        scores = self.scores(descriptors)
        shares = np.exp(scores - scores.max(axis=1, keepdims=True))
        return NamedRooms(self.names[scores.argmax(axis=1)], shares / shares.sum(axis=1, keepdims=True), self.names)

    def of(self, names: Sequence[str]) -> RoomClassifier:
        """Return a classifier for only some of the rooms, in the given order; it never names any other room.

        Raises:
            DataError: a room that the classifier does not know.
        """
        number = {name: row for row, name in enumerate(self.names.tolist())}
        if unknown := [name for name in names if name not in number]:
            trained = ", ".join(number)
            raise DataError(f"the class layer knows no room {', '.join(unknown)}: it was trained on {trained}")
        rows = [number[name] for name in names]
        return RoomClassifier(self.names[rows], self.weight[rows], self.bias[rows])
