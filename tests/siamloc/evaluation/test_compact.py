"""Localization in compact maps, against a slow and obvious form."""

from __future__ import annotations

import math

import numpy as np
import pytest

import analytic
from siamloc import evaluation, maps
from siamloc.data import example
from siamloc.errors import ConfigError, DataError
from siamloc.evaluation import Result
from siamloc.evaluation.compact_maps import grid_of


@pytest.fixture(scope="module")
def world():
    images = example()
    monday, tuesday = (images.frames.select(sequence=day) for day in ("monday", "tuesday"))
    tuesday = tuesday.with_columns(lighting=["cloudy", "night"] * 6)
    known = maps.build("hog", images, monday, progress=False)
    return images, tuesday, known


def obvious(known, labels, vectors, xy, standing=None):
    """Return both errors of each query by loops over nodes and frames: (n, 2)."""
    names = sorted(set(labels.tolist()))
    errors = []
    for vector, true in zip(vectors, xy, strict=True):
        best = (math.inf, None, None)
        for node in names:
            rows = np.flatnonzero(labels == node)
            mean = known.descriptors[rows].astype(np.float64).mean(axis=0)
            place = known.frames.xy[rows].mean(axis=0)
            if standing is not None:
                mean, place = known.descriptors[standing[node]].astype(np.float64), known.frames.xy[standing[node]]
            apart = float(analytic.distance(known.distance)(vector[None], mean[None])[0, 0])
            if apart < best[0]:
                best = (apart, node, place)
        rows = np.flatnonzero(labels == best[1])
        apart = analytic.distance(known.distance)(vector[None], known.descriptors[rows])[0]
        frame = known.frames.xy[rows[int(np.argmin(apart))]]
        errors.append((math.dist(best[2], true), math.dist(frame, true)))
    return np.array(errors)


@pytest.mark.parametrize("way", ["spectral", "sample", "som"])
def test_both_errors_are_those_of_the_obvious_form(world, way):
    images, tuesday, known = world
    result = evaluation.compact(known, images, tuesday, nodes=(3, 6), ways=(way,), seed=3)
    vectors = known.descriptor.describe(images.batch(images.rows(tuesday))).position
    answers = result.tables["answers"]
    for nodes in (3, 6):
        asked = {"grid": grid_of(nodes)} if way == "som" else {"nodes": nodes}
        labels = maps.group(known, way, seed=3, progress=False, **asked).layer.labels
        standing = analytic.clustering.sample_rows(len(known), nodes) if way == "sample" else None
        expected = obvious(known, labels, vectors, tuesday.xy, standing)
        rows = answers["nodes"] == len(set(labels.tolist()))
        # Representatives are kept as float32, which no nearest node of these queries hangs on.
        np.testing.assert_allclose(answers["error"][rows], expected[:, 0], atol=1e-9)
        np.testing.assert_allclose(answers["error_frames"][rows], expected[:, 1], atol=1e-9)
        held = next(one for one in result.measures["curves"] if one["nodes"] == len(set(labels.tolist())))
        assert held["error"]["mean"] == pytest.approx(expected[:, 0].mean())
        assert held["error_frames"]["mean"] == pytest.approx(expected[:, 1].mean())
        assert held["silhouette"] == pytest.approx(analytic.measures.silhouette(known.frames.xy, labels))
        assert held["floor"] <= held["error"]["mean"]


def test_nodes_by_one_descriptor_are_represented_by_another(world):
    images, tuesday, known = world
    clusters = maps.build(analytic.descriptor("gist", blocks=16, orientations=8), images, known.frames, progress=False)
    result = evaluation.compact(known, images, tuesday, clusters=clusters, nodes=(6,), ways=("spectral",))
    labels = maps.group(clusters, "spectral", nodes=6, progress=False).layer.labels
    vectors = known.descriptor.describe(images.batch(images.rows(tuesday))).position
    np.testing.assert_allclose(
        result.tables["answers"]["error"], obvious(known, labels, vectors, tuesday.xy)[:, 0], atol=1e-9
    )
    assert result.measures["clustered"] == "gist"
    with pytest.raises(DataError, match="must hold the map's frames in the same order"):
        evaluation.compact(known, images, tuesday, clusters=clusters.take(np.arange(len(clusters))[::-1]), nodes=(6,))


def test_descriptors_that_are_turned_first_are_sampled_alone(world):
    images, tuesday, known = world
    turned = maps.build(analytic.descriptor("briefgist", rows=16), images, known.frames, progress=False)
    result = evaluation.compact(turned, images, tuesday, nodes=(8,), ways=("sample",))
    apart = turned.descriptor.pairwise(
        turned.descriptor.describe(images.batch(images.rows(tuesday))), turned.description
    )
    kept = analytic.clustering.sample_rows(len(turned), 8)
    np.testing.assert_array_equal(result.tables["answers"]["node"], apart[:, kept].argmin(axis=1))
    with pytest.raises(ConfigError, match=r"use task.ways=\[sample\]"):
        evaluation.compact(turned, images, tuesday, nodes=(8,))


def test_what_it_is_not_asked_for_is_refused(world):
    images, tuesday, known = world
    for wrong, says in (
        ({"nodes": (13,)}, "task.nodes asks for 13 nodes, and the map has 12 frames"),
        ({"nodes": (4, 4)}, "task.nodes must be a list of one or more whole numbers from 1 that differ"),
        ({"ways": ("kmeans",)}, "task.ways must be a list of one or more of spectral, som and sample"),
    ):
        with pytest.raises(ConfigError, match=says):
            evaluation.compact(known, images, tuesday, **{"nodes": (4,), **wrong})


def test_it_is_written_drawn_and_read_back(world, tmp_path):
    images, tuesday, known = world
    result = evaluation.compact(known, images, tuesday, nodes=(4, 8))
    drawn = result.save(tmp_path)
    assert [path.name for path in drawn] == ["compact.png"]
    again = Result.load(tmp_path)
    assert again.measures["curves"][0]["error"]["mean"] == result.measures["curves"][0]["error"]["mean"]
    table = again.table().splitlines()
    assert table[0] == "localization in compact maps, hog, correlation distance"
    # Each map has a row for all queries, and one for each of the two lightings.
    assert sum(line.startswith(("spectral", "sample")) for line in table) == 12
