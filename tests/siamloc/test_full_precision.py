"""Full precision, whatever the user has set, and the user's settings afterwards."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import torch

from siamloc.full_precision import full_precision
from siamloc.models import as_descriptor, build

CODE = """
import torch
from siamloc.full_precision import full_precision

def read(*names):
    value = torch
    try:
        for name in names:
            value = getattr(value, name)
        return value() if callable(value) else value
    except (AttributeError, RuntimeError) as error:
        return type(error).__name__

def switches():
    places = ["", "cudnn.", "cudnn.conv.", "cuda.matmul.", "mkldnn.", "mkldnn.conv.", "mkldnn.matmul."]
    newer = [read("backends", *f"{place}fp32_precision".split(".")) for place in places]
    tf32 = [read("backends", "cudnn", "allow_tf32"), read("backends", "cuda", "matmul", "allow_tf32")]
    return [*newer, *tf32, read("get_float32_matmul_precision")]

SET
before = switches()
try:
    with full_precision():
        assert not {"tf32", "bf16", "high", "medium", True} & set(switches()), switches()
        raise KeyError
except KeyError:
    pass
assert switches() == before, (switches(), before)
"""
SETTINGS = [
    "pass",
    "torch.set_float32_matmul_precision('high')",
    "torch.set_float32_matmul_precision('medium')",
    "torch.backends.cudnn.allow_tf32 = False",
    "torch.backends.cuda.matmul.allow_tf32 = True",
]
NEWER_SETTINGS = [
    "torch.backends.fp32_precision = 'tf32'",
    "torch.backends.fp32_precision = 'ieee'",
    "torch.backends.cudnn.fp32_precision = 'tf32'",
    "torch.backends.cudnn.conv.fp32_precision = 'ieee'",
    "torch.backends.cuda.matmul.fp32_precision = 'tf32'",
    "torch.backends.mkldnn.matmul.fp32_precision = 'bf16'",
    "torch.set_float32_matmul_precision('high'); torch.backends.cuda.matmul.fp32_precision = 'ieee'",
]


def test_switches_are_off_and_come_back(tmp_path):
    """In processes of their own, forked after one import, as torch's switches cannot all be set back."""
    settings = [*SETTINGS, *(NEWER_SETTINGS if hasattr(torch.backends, "fp32_precision") else [])]
    fork = (
        "import os, sys, torch, siamloc.full_precision\n"
        f"for setting in {settings!r}:\n"
        "    child = os.fork()\n"
        "    if child == 0:\n"
        f"        exec({CODE!r}.replace('SET', setting, 1))\n"
        "        os._exit(0)\n"
        "    assert os.waitpid(child, 0)[1] == 0, setting\n"
    )
    done = subprocess.run([sys.executable, "-c", fork], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_descriptors_do_not_depend_on_the_precision_of_products():
    """Where the CPU has bfloat16 instructions, "medium" computes with them."""
    network = as_descriptor(build("simple1", "fc500_500_5", (32, 64)))
    images = np.random.default_rng(0).integers(0, 256, (8, 3, 32, 64), dtype=np.uint8)
    expected = network.describe(images).position
    torch.set_float32_matmul_precision("medium")
    try:
        np.testing.assert_array_equal(network.describe(images).position, expected)
        assert torch.get_float32_matmul_precision() == "medium"
        with full_precision():
            assert torch.get_float32_matmul_precision() == "highest"
    finally:
        torch.set_float32_matmul_precision("highest")
