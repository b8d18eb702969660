"""Shared by all ONNX files here: tracing a module, labelling a file, running it."""

from __future__ import annotations

import json
import logging
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from torch import nn

from siamloc.errors import FormatError

FORMAT_VERSION = 2
OPSET = 20


def traced(
    module: nn.Module,
    example: tuple[torch.Tensor, ...],
    inputs: Sequence[str],
    outputs: Sequence[str],
    *,
    free_batch: bool,
) -> Any:
    """Trace a module in evaluation mode, then restore the mode of every part.

    Args:
        module: the module to trace.
        example: its arguments, with a batch of two or more if the batch is free: one would be taken as constant.
        inputs: names of the arguments.
        outputs: names of the outputs.
        free_batch: whether the first dimension of the arguments is free, the same one for all.
    """
    batch = {0: torch.export.Dim("batch")}
    options: dict[str, Any] = {"dynamic_shapes": tuple(batch for _ in example)} if free_batch else {}
    training = [(part, part.training) for part in module.modules()]
    module.eval()
    try:
        with quiet(), torch.no_grad():
            return torch.onnx.export(
                module,
                example,
                dynamo=True,
                input_names=list(inputs),
                output_names=list(outputs),
                opset_version=OPSET,
                verbose=False,
                **options,
            )
    finally:
        for part, mode in training:
            part.training = mode


def label(program: Any, kind: str, identity: dict[str, Any]) -> None:
    """Write format, version and identity into the metadata of a file."""
    program.model.metadata_props.update(
        {
            "format": kind,
            "format_version": str(FORMAT_VERSION),
            "identity": json.dumps(identity, sort_keys=True),
        }
    )


def session_of(path: str | Path) -> Any:
    """Open a file with onnxruntime, on the CPU.

    Raises:
        FormatError: a file that onnxruntime cannot run.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's exceptions have no common base
        raise FormatError(f"{path} is not an ONNX file that onnxruntime can run ({type(error).__name__})") from error


@contextmanager
def quiet() -> Iterator[None]:
    """Silence the exporter's deprecation warnings and progress lines, but not its errors."""
    loggers = [logging.getLogger(name) for name in ("torch.onnx", "onnxscript", "onnx_ir")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
