"""ONNX files that compute with 8-bit integers."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from foundation.files import atomic_path

_LAYERS = ["Conv", "Gemm"]


def quantize(path: Path, panoramas: NDArray[np.uint8]) -> None:
    """Make the convolutions and fully connected layers of an ONNX file compute with 8-bit integers, in place.

    Args:
        path: of the file.
        panoramas: (n, 3, H, W) from which the value ranges are taken.
    """
    from onnxruntime.quantization import QuantFormat, QuantType, quantize_static

    with atomic_path(path) as temporary, _quiet():
        quantize_static(
            str(path),
            str(temporary),
            _Panoramas(panoramas),
            quant_format=QuantFormat.QDQ,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
            op_types_to_quantize=_LAYERS,
            per_channel=True,
            reduce_range=True,
        )


class _Panoramas:
    """Feeds a quantizer one panorama after the other."""

    def __init__(self, panoramas: NDArray[np.uint8]) -> None:
        self._left = iter(panoramas)

    def __iter__(self) -> _Panoramas:
        return self

    def __next__(self) -> dict[str, NDArray[np.uint8]]:
        return {"panorama": next(self._left)[None]}

    def get_next(self) -> dict[str, NDArray[np.uint8]] | None:
        return next(self, None)


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence the quantizer's advice, which goes to the root logger."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        yield
    finally:
        logging.disable(before)
