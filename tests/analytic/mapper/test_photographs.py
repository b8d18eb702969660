"""Real photographs: a corridor driven twice, on different days, with an ordinary fisheye camera."""

import json
from collections import Counter
from pathlib import Path

import cv2
import numpy as np
import pytest

import analytic
from analytic.mapper import IncrementalMapper, Reason, replay

CORRIDOR = Path(__file__).parents[3] / ".." / "shared" / "data" / "corridor"

pytestmark = [pytest.mark.data, pytest.mark.skipif(not CORRIDOR.exists(), reason="needs ../shared/data/corridor")]


@pytest.fixture(scope="module")
def drives():
    hog = analytic.descriptor("hog", circular=False)

    def described(name):
        images = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in sorted((CORRIDOR / name).glob("*.jp*g"))]
        return hog.describe(np.stack([cv2.resize(image, (160, 128)) for image in images]))

    truth = json.loads((CORRIDOR / "ground_truth.json").read_text())["query_to_ref"]
    return hog, described("ref"), described("query"), {int(query): frames for query, frames in truth.items()}


@pytest.mark.parametrize("version", [1, 2])
def test_a_drive_falls_into_stretches_and_another_day_is_learned(drives, version):
    hog, reference, query, truth = drives
    mapper = IncrementalMapper(hog, version)
    for frame in range(len(reference)):
        mapper.add(reference.take([frame]), [float(frame), 0.0])
    labels = mapper.labels()
    assert len(mapper.nodes) >= 3
    assert (labels >= 0).mean() > 0.7
    assert np.array_equal(replay(mapper.events), labels)

    def share_closing(rows):
        found = [mapper.locate(query.take([row])) for row in rows]
        return np.mean(
            [place.closes and place.node in labels[truth[row]] for row, place in zip(rows, found, strict=True)]
        )

    asked = range(1, len(query), 2)
    before = share_closing(asked)
    for node in mapper.nodes:
        seen = [row for row in range(0, len(query), 2) if _node_of(labels[truth[row]]) == node.id]
        if len(seen) >= mapper.parameters.smallest_node:
            assert mapper.maintain(node.id, query.take(seen)).reason is Reason.MAINTAINED
    assert before < 0.1
    assert share_closing(asked) > 0.5


def _node_of(labels):
    return Counter(labels.tolist()).most_common(1)[0][0]
