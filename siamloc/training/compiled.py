"""`Training.compile`: compile the network of a training step with torch, while its weights keep their names."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Literal

import torch
from torch import Tensor

from siamloc.errors import ConfigError
from siamloc.models.module import NetworkModule

BACKEND = "inductor"


@contextmanager
def compiled(module: NetworkModule, wanted: Literal["auto"] | bool) -> Iterator[None]:
    """Let training steps use the compiled network; validation and later calls use the network as it is.

    The network, or each of the two parts of one that learns displacements, is compiled once, for the size of a whole
    batch; a smaller last batch takes the network as it is. Names of weights, checkpoints and hooks stay as they are.
    With "auto", a network that cannot be compiled is used as it is, and a note is printed.

    Raises:
        ConfigError: the network cannot be compiled, which shows in the first step.
    """
    if not wanted:
        yield
        return
    from torch._dynamo.exc import TorchDynamoException
    from torch._inductor.exc import InductorError

    parts: dict[Callable[..., Any], tuple[Callable[..., Any], int]] = {}

    def call(part: Callable[..., Any], *inputs: Tensor) -> Any:
        if part not in parts:
            made = torch.compile(lambda *given: part(*given), backend=BACKEND, dynamic=False)
            parts[part] = made, len(inputs[0])
        fast, whole = parts[part]
        if len(inputs[0]) < whole:
            return part(*inputs)
        try:
            return fast(*inputs)
        except (TorchDynamoException, InductorError) as error:
            reason = " ".join([line.strip() for line in str(error).splitlines() if line.strip()][:2])
            if wanted != "auto":
                raise ConfigError(
                    f"torch cannot compile this network here: {reason}; leave compile=true out"
                ) from error
            print(f"note: training without torch.compile, which fails here: {reason}", file=sys.stderr)
            module.compiled = None
            return part(*inputs)

    module.compiled = call
    try:
        yield
    finally:
        module.compiled = None
