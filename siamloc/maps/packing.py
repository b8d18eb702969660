"""Arrays at lower precision: each row has a scale that maps its largest value to the top of the number range."""

from __future__ import annotations

import math
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from siamloc.maps.search import slices

Precision = Literal["float32", "float16", "int8"]
"""How numbers are stored."""
PRECISIONS: tuple[Precision, ...] = get_args(Precision)

_LEVELS = 127
_EXPONENT = 14  # of a power of two below the largest float16
_AT_ONCE = 1 << 20  # numbers


def packed(name: str, values: NDArray, precision: Precision) -> dict[str, NDArray]:
    """Return an array (n, ...) in another precision, with the scale of each row (n,) under `<name>_scale`.

    The scale of float16 is a power of two, so that only the significand is rounded.

    Args:
        name: name of the array.
        values: finite numbers; complex ones become pairs along a last axis.
        precision: "float16" or "int8".

    Example:
        >>> held = packed("a", np.array([[0.5, -1.0], [0.0, 0.0]]), "int8")
        >>> held["a"], unpacked(held["a"], held["a_scale"])[0]
        (array([[  64, -127],
               [   0,    0]], dtype=int8), array([ 0.503937, -1.      ], dtype=float32))
    """
    if np.iscomplexobj(values):
        values = np.stack([values.real, values.imag], axis=-1)
    largest = np.abs(values).reshape(len(values), -1).max(axis=1).astype(np.float64)
    if precision == "int8":
        scale = np.where(largest > 0, largest / _LEVELS, 1.0)
    else:
        scale = np.ldexp(1.0, np.frexp(largest)[1] - _EXPONENT)
    shares = values / scale.reshape(-1, *[1] * (values.ndim - 1))
    kept = np.rint(shares).astype(np.int8) if precision == "int8" else shares.astype(np.float16)
    return {name: kept, f"{name}_scale": scale.astype(np.float32)}


def shares_values(one: NDArray[Any], other: NDArray[Any]) -> bool:
    """Whether two arrays share the same memory in the same order, possibly in different shapes."""
    return (
        one.ctypes.data == other.ctypes.data
        and (one.dtype, one.size) == (other.dtype, other.size)
        and one.flags.c_contiguous
        and other.flags.c_contiguous
    )


def all_finite(values: NDArray[Any]) -> bool:
    """Whether all values of an array (n, ...) are finite, checked in blocks of rows since maps are large."""
    blocks = slices(len(values), _AT_ONCE // max(1, math.prod(values.shape[1:])))
    return all(bool(np.isfinite(values[block]).all()) for block in blocks)


def unpacked(values: NDArray, scale: NDArray) -> NDArray:
    """Return a packed array as float32 or complex64, at the precision with which it was stored.

    Raises:
        ValueError: arrays that do not match each other.
    """
    if values.dtype not in (np.int8, np.float16) or scale.shape != values.shape[:1] or scale.dtype != np.float32:
        raise ValueError(f"values {values.dtype} {values.shape} with a scale {scale.dtype} {scale.shape}")
    full = values.astype(np.float32)
    with np.errstate(over="ignore", invalid="ignore"):  # readers of a file check for values that are not finite
        full *= scale.reshape(-1, *[1] * (values.ndim - 1))  # in place: maps are large
    return full.view(np.complex64)[..., 0] if full.ndim == 4 and full.shape[3] == 2 else full
