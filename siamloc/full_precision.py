"""`full_precision`: float32 that is computed with all of its digits."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from types import ModuleType
from typing import Any

import torch

from foundation.threads import restored

Switch = tuple[Callable[[], Any], Callable[[Any], None], Any]


@contextmanager
def full_precision() -> Iterator[None]:
    """Compute float32 in full: no TF32 or bfloat16 inside convolutions and matrix products.

    A GPU convolves in TF32, with 10 of the 23 bits, unless told otherwise; `torch.set_float32_matmul_precision` does
    similar things to products. Afterwards everything is as the user set it, for the whole process.
    """
    with restored([torch], _values, _restore):
        for get, put, full in [switch for switch in _switches() if _read(switch[0]) is not None]:
            if _read(get) not in (full, "none"):
                put(full)
        yield


def _switches() -> list[Switch]:
    """Return how torch's switches are read and written, and their values for full precision.

    Older switches come first, since writing them writes newer ones as well; then general switches before special ones,
    which may follow them.
    """
    backends: Any = torch.backends
    places = [backends, backends.cudnn] if hasattr(backends, "fp32_precision") else []  # from torch 2.9
    if places:
        places += [backends.cudnn.conv, backends.cuda.matmul, backends.mkldnn.conv, backends.mkldnn.matmul]
    newer = [(*_attribute(place, "fp32_precision"), "ieee") for place in places]
    matmul = (torch.get_float32_matmul_precision, torch.set_float32_matmul_precision, "highest")
    return [(*_attribute(backends.cudnn, "allow_tf32"), False), matmul, *newer]


def _values(_: ModuleType) -> list[Any]:
    return [_read(get) for get, _, _ in _switches()]


def _restore(_: ModuleType, before: list[Any]) -> None:
    for (get, put, _full), value in zip(_switches(), before, strict=True):
        if value is not None and _read(get) != value:
            put(value)


def _attribute(place: Any, name: str) -> tuple[Callable[[], Any], Callable[[Any], None]]:
    return partial(getattr, place, name), partial(setattr, place, name)


def _read(get: Callable[[], Any]) -> Any:
    """Return a switch's value; None if torch refuses to read an older one after a newer one was used."""
    try:
        return get()
    except RuntimeError:
        return None
