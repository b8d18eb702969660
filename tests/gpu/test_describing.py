"""Maps, refinement and evaluation on a GPU: one wait for a chunk of images, and the results of the CPU."""

from __future__ import annotations

import numpy as np
import pytest

import siamloc
from siamloc.models import as_descriptor
from tests.gpu.conftest import SIZE
from tests.gpu.pretend import NAME

NETWORK = {"branch": "panoresnet", "head": "magnitudes", "circular": True, "canonical": True, "relative": True}


@pytest.fixture
def network(gpu):
    return siamloc.models.build(**NETWORK, image_size=SIZE).eval().to(NAME)


@pytest.fixture(scope="module")
def here():
    return as_descriptor(siamloc.models.build(**NETWORK, image_size=SIZE).eval(), "cpu")


def waits(gpu):
    counted = sum(gpu.waits.values())
    gpu.clear()
    return counted


def test_a_chunk_of_images_waits_once_and_a_comparison_once(gpu, network, here, images, frames):
    there, batch = as_descriptor(network, None), images.batch(range(24))
    there.describe(batch)
    gpu.clear()
    for given in (batch, batch.astype(np.float32) / 255):
        found, expected = there.describe(given, chunk=8), here.describe(given, chunk=8)
        assert waits(gpu) == 3
        np.testing.assert_allclose(found.position, expected.position, atol=1e-6)
        np.testing.assert_allclose(found.orientation, expected.orientation, rtol=1e-4, atol=1e-5)
    parts = np.asarray(expected.orientation, np.float32)
    pairs = parts, parts[::-1].copy(), 8
    for told, wanted in zip(there.compare(*pairs), here.compare(*pairs), strict=True):
        np.testing.assert_allclose(told, wanted, rtol=1e-3, atol=1e-4)
    assert waits(gpu) == 1


def test_refinement_waits_twice_at_most(gpu, network, images, drives):
    known = siamloc.maps.build(network, images, drives[0], progress=False)
    assert known.descriptor.module is network
    queries = known.describe(images.batch(range(16, 32)))
    found = known.search(queries.position, k=3)
    siamloc.maps.refine(known, queries, found)
    gpu.clear()
    siamloc.maps.refine(known, queries, found)
    assert waits(gpu) <= 2


def test_queries_are_found_where_the_cpu_finds_them(network, here, images, drives):
    located = []
    for by in (as_descriptor(network, None), here):
        known = siamloc.maps.build(by, images, drives[0], progress=False)
        located.append(siamloc.evaluation.localization(known, images, drives[1], refine="relative", baselines=()))
    for table in ("queries", "rooms", "pairs"):
        for name, column in located[0].tables[table].items():
            other = located[1].tables[table][name]
            if column.dtype.kind == "f":
                np.testing.assert_allclose(column, other, rtol=1e-3, atol=1e-4)
            else:
                np.testing.assert_array_equal(column, other)
