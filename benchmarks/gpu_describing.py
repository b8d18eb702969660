"""The parts of `benchmarks.gpu` that use networks: description, refinement of poses, and export."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import nn

import siamloc
from benchmarks.gpu_bench import Bench, Figures, rows
from siamloc.data import example
from siamloc.models import as_descriptor


def description(bench: Bench) -> Figures:
    """Describe panoramas in full precision with each network, as it is and compiled, and compare with the CPU."""
    images = bench.images.batch(np.arange(bench.sizes.described) % len(bench.images))
    works: dict[str, Callable[[], Figures]] = {}
    for name in bench.sizes.networks:
        works[name] = partial(_described, bench, name, images, compiles=False)
        if bench.on_cuda:
            works[f"{name}, compiled"] = partial(_described, bench, name, images, compiles=True)
    return rows(works)


def _described(bench: Bench, name: str, images: np.ndarray, compiles: bool) -> Figures:
    network = bench.build(name).eval()
    expected = as_descriptor(network, "cpu").describe(images[:4]).position
    made: Any = torch.compile(network) if compiles else network
    describes = as_descriptor(made, bench.device).describe
    begin = time.monotonic()
    apart = relative(describes(images[:4]).position, expected)
    first = time.monotonic() - begin
    return {
        "images_per_second": len(images) / bench.median(lambda: describes(images)),
        "first_s": first,
        "apart": apart,
    }


def relative(found: np.ndarray, expected: np.ndarray) -> float:
    """Return the largest distance between two descriptors of an image, divided by the length of the second one."""
    return float((np.linalg.norm(found - expected, axis=1) / np.linalg.norm(expected, axis=1)).max())


def refinement(bench: Bench) -> Figures:
    """Refine the poses of a drive on a map of another one, with the network that ships with siamloc."""
    network = siamloc.models.pretrained()
    images = example(bench.sizes.frames, network.image_size)
    monday, tuesday = (images.frames.select(sequence=name) for name in ("monday", "tuesday"))
    known = siamloc.maps.build(network, images, monday, device=str(bench.device), progress=False)
    asked = known.descriptor.describe(images.batch(images.rows(tuesday)))
    found = siamloc.maps.match(known, asked, 3)
    seconds = bench.median(lambda: siamloc.maps.refine(known, asked, found))
    return {"queries_per_second": len(tuesday) / seconds, "ms_per_call": 1000 * seconds, "queries": len(tuesday)}


def export(bench: Bench) -> Figures:
    """Map with each network on the device, and export network and map, which compares them on the CPU."""
    names = [name for name in bench.sizes.networks if name != "modern"]
    works = {name: partial(_exported, bench, bench.build(name)) for name in names}
    return rows({**works, "pretrained": partial(_exported, bench, siamloc.models.pretrained())})


def _exported(bench: Bench, network: nn.Module) -> Figures:
    images = example(12, network.image_size)  # type: ignore[arg-type]
    known = siamloc.maps.build(network, images, images.frames, device=str(bench.device), progress=False)
    begin = time.monotonic()
    bundle = siamloc.runtime.export(network, known, bench.fresh())
    asked = siamloc.runtime.Localizer(bundle.path).describe(images.batch(np.arange(len(images))))
    return {"apart": relative(asked.position, known.description.position), "seconds": time.monotonic() - begin}
