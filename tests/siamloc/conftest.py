"""Shared by the tests of siamloc: what libraries do again and again is done once."""

from __future__ import annotations

import hashlib
from unittest import mock

import pytest
import torch


@pytest.fixture(autouse=True, scope="session")
def _translated_once():
    """Let torch translate networks of the same modules and weights for their ONNX files once, for a second each.

    Every export compares its file with its network, so that the file of another network would be noticed.
    """
    translate, programs = torch.onnx.export, {}

    def export(graph, example, **options):
        weights = hashlib.sha256()
        for value in graph.state_dict().values():
            weights.update(value.numpy(force=True).tobytes())
        shapes = [one.shape for one in example]
        key = str([list(map(type, graph.modules())), graph, shapes, options["output_names"], weights.hexdigest()])
        if key not in programs:
            programs[key] = translate(graph, example, **options)
        return programs[key]

    with mock.patch.object(torch.onnx, "export", export):
        yield


@pytest.fixture(autouse=True, scope="session")
def _composed_once():
    """Let -m alone make a command a sweep: Hydra would compose all settings once more to look for that in them."""
    with mock.patch("hydra._internal.hydra.Hydra.get_mode", return_value=None):
        yield
