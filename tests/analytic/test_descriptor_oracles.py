"""The descriptors against their docstrings, computed again with loops in `tests/oracles/descriptors`."""

import numpy as np
import pytest

from analytic import DISTANCES, AnalyticError, descriptor, distance
from tests.analytic.photographs import photographs
from tests.analytic.radon_lines import radon_transform
from tests.oracles.descriptors import briefgist, fourier, gist, hog, hsv, radon, turns, wisurf
from tests.oracles.descriptors.cases import ODD, SHAPES, SWEEP
from tests.oracles.descriptors.images import grey, homomorphic_colour
from tests.oracles.descriptors.images import homomorphic as slow_homomorphic

RNG = np.random.default_rng(11)

# Small pictures of every kind that `describe` takes; three planes would be one colour image.
MADE = {
    "grey bytes": RNG.integers(0, 256, (2, 16, 64), dtype=np.uint8),
    "colour": RNG.uniform(size=(2, 3, 16, 64)),
    "odd": RNG.uniform(size=(2, 12, 45)).astype(np.float32),
    "flat and a bar": np.stack([np.full((16, 64), 0.25), np.tile(np.arange(64) // 8 == 3, (16, 1)) * 0.5]),
}

DESCRIBE = {
    "fs": fourier.describe,
    "hog": hog.describe,
    "gist": gist.describe,
    "wisurf": wisurf.describe,
    "briefgist": briefgist.describe,
    "radon_fourier": radon.fourier,
    "radon_poc": radon.poc,
    "hsv": hsv.describe,
}


def same(found, expected, apart=0.0):
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-4 * max(np.abs(expected).max(), 1e-3) + apart)


def compare(name, params, pictures, circular, **options):
    """Assert that a batch is described as its images are by the oracle."""
    made = descriptor(name, **params, **options, circular=circular)
    described = made.describe(pictures)
    shapes = made.sizes(*pictures.shape[-2:])
    assert shapes == SHAPES[name](params, pictures.shape[-1])
    assert described.position.shape == (len(pictures), np.prod(shapes[0]))
    for position, orientation, picture in zip(described.position, described.orientation, pictures, strict=True):
        image = hsv.colours(picture) if name == "hsv" else grey(picture)
        if options.get("homomorphic"):
            image = (homomorphic_colour if name == "hsv" else slow_homomorphic)(image, circular=circular)
        by_loops = DESCRIBE[name](image, **params, circular=circular)
        apart = [0.0, 0.0]  # what pixels add whose bin depends on rounding
        if name == "hog":
            apart = [hog.undecided(image, params[bins], circular) for bins in ("bins", "orientation_bins")]
        elif name == "hsv":
            count = hsv.undecided(image, **params, within=1e-5 if options.get("homomorphic") else 1e-6)
            apart = [(count * params["rows"] / image[0].size) ** 0.5, count / (len(image[0]) * params["window"])]
        same(position, by_loops[0], apart[0])
        same(orientation, by_loops[1], apart[1])
        assert orientation.shape == (shapes[1] if name != "fs" else shapes[1][::-1])


@pytest.mark.parametrize("circular", [True, False], ids=["circular", "flat"])
@pytest.mark.parametrize("kind", MADE)
@pytest.mark.parametrize("name", DESCRIBE)
def test_made_pictures_are_described_as_written(name, kind, circular):
    for params in (ODD if kind == "odd" else SWEEP)[name]:
        compare(name, params, MADE[kind], circular)


@pytest.mark.data
@pytest.mark.parametrize("circular", [True, False], ids=["circular", "flat"])
@pytest.mark.parametrize("name", DESCRIBE)
def test_photographs_are_described_as_written(name, circular):
    for params in SWEEP[name][1:3]:
        compare(name, params, photographs(), circular)


LOOPS_ARE_FAST = ["fs", "hog", "wisurf", "briefgist", "radon_poc", "hsv"]


@pytest.mark.data
@pytest.mark.parametrize("name", LOOPS_ARE_FAST)
def test_a_whole_panorama_is_described_as_written_by_default(name):
    made = descriptor(name)
    (panorama,) = photographs((40,), (512, 128))
    params = {key: value for key, value in made.identity.items() if key in PARAMS[name]}
    compare(name, params, panorama[None], True)


@pytest.mark.parametrize("circular", [True, False], ids=["circular", "flat"])
@pytest.mark.parametrize("name", DESCRIBE)
def test_light_can_be_taken_off_first(name, circular):
    compare(name, SWEEP[name][1], MADE["colour"][:1], circular, homomorphic=True)


@pytest.mark.parametrize("side", [24, 31])
def test_omnidirectional_images_are_described_as_written(side):
    discs = RNG.integers(0, 256, (2, side, side), dtype=np.uint8)
    transformed = radon_transform(discs, step=7.5, size=22, source="omnidirectional")
    fs = descriptor("radon_fourier", step=7.5, size=22, lines=11, orientation_lines=1, source="omnidirectional")
    poc = descriptor("radon_poc", step=7.5, size=22, source="omnidirectional")
    for i, disc in enumerate(discs):
        same(transformed[i], radon.transform(grey(disc), 7.5, 22, "omnidirectional"))
        for made, by_loops in (
            (fs, radon.fourier(grey(disc), 7.5, 22, 11, 1, "omnidirectional")),
            (poc, radon.poc(grey(disc), 7.5, 22, "omnidirectional")),
        ):
            same(made.describe(disc).position[0], by_loops[0])
            same(made.describe(disc).orientation[0], by_loops[1])


def test_a_line_is_the_sum_over_its_points():
    found = radon_transform(MADE["odd"][0], step=12, size=30)[0]
    for t, k in [(0, 0), (7, 14), (29, 3), (13, 8)]:
        assert found[t, k] == pytest.approx(radon.line(grey(MADE["odd"][0]), 12, 30, t, k), abs=1e-5)


# --- comparing

ALIGN = [  # name, parameters, and what is largest at the best turn, of two orientation parts
    ("fs", {"whitened": True}, lambda q, r: fourier.correlation_scores(q, r, 64, True)),
    ("fs", {"whitened": False}, lambda q, r: fourier.correlation_scores(q, r, 64, False)),
    ("fs", {"heading": "phase_product"}, lambda q, r: fourier.phase_product_scores(q, r, 64)),
    ("hog", {"whitened": True}, lambda q, r: turns.scores(turns.whitened(q, 1e-5), turns.whitened(r, 1e-5))),
    ("hog", {"whitened": False}, turns.scores),
    ("gist", {}, turns.scores),
    ("gist", {"normalized": False}, turns.scores),
    ("wisurf", {}, turns.scores),
    ("briefgist", {}, turns.scores),
    ("radon_fourier", {}, turns.scores),
    ("radon_poc", {}, turns.scores),
    ("hsv", {}, lambda q, r: turns.scores(turns.whitened(q, 1e-5), turns.whitened(r, 1e-5))),
]
PARAMS = {
    "fs": SWEEP["fs"][1],
    "hog": SWEEP["hog"][1],
    "gist": SWEEP["gist"][1],
    "wisurf": SWEEP["wisurf"][2],
    "briefgist": SWEEP["briefgist"][3],
    "radon_fourier": SWEEP["radon_fourier"][0],
    "radon_poc": SWEEP["radon_poc"][1],
    "hsv": SWEEP["hsv"][1],
}


def pairs(kind):
    """Return four references, and queries: three of them turned, noisy, one with a bar, and a picture of noise."""
    rng = np.random.default_rng(2)
    references = rng.uniform(size=(4, 16, 64)) if kind == "noise" else photographs((5, 40, 70, 95)).mean(axis=1) / 255
    width = references.shape[-1]
    moved = (width // 8, -width // 4, 0)
    queries = [np.roll(image, s, axis=-1) for image, s in zip(references, moved, strict=False)]
    queries = [np.clip(image + rng.normal(0, 0.03, image.shape), 0, 1) for image in queries]
    queries[0][:, 3:9] = 0
    return np.stack([*queries, rng.uniform(size=references[0].shape)]), references


def aligned_distance(name, options, query, reference, step):
    query, reference = (part.astype(np.complex128 if name == "fs" else np.float64) for part in (query, reference))
    if options.get("heading") == "phase_product":
        return fourier.phase_product_distance(query, reference, 64, step)
    if name == "fs":
        return fourier.correlation_distance(query, reference, 64, step)
    return turns.euclidean(query, reference, step)


@pytest.mark.parametrize("kind", ["noise", pytest.param("photographs", marks=pytest.mark.data)])
@pytest.mark.parametrize(("name", "options", "score"), ALIGN, ids=[f"{row[0]} {row[1]}" for row in ALIGN])
def test_every_turn_is_tried(name, options, score, kind):
    queries, references = pairs(kind)
    params = {**PARAMS[name], **options}
    made = descriptor(name, **params)
    known, seen = made.describe(references), made.describe(queries)
    found = made.align(seen, known)
    turned = np.stack([made.relative_heading(made.describe(queries), made.describe(one)) for one in references], axis=1)
    np.testing.assert_array_equal(turned, found.heading)
    by_rows = made.relative_heading(made.describe(queries), made.describe(references))
    np.testing.assert_array_equal(by_rows, np.diag(found.heading))
    slow_queries = [DESCRIBE[name](grey(q), **params)[1] for q in queries]
    slow_references = [DESCRIBE[name](grey(r), **params)[1] for r in references]
    for i, query in enumerate(slow_queries):
        for j, reference in enumerate(slow_references):
            scores = score(query, reference)
            step = turns.best(scores)
            assert found.heading[i, j] == pytest.approx(turns.angle(step, len(scores)), abs=1e-9)
            # The distance of what was described, since phases of faint coefficients depend on rounding before that.
            one, other = seen.orientation[i], known.orientation[j]
            expected = aligned_distance(name, options, one, other, step)
            assert found.distance[i, j] == pytest.approx(expected, **tolerance(name, options, one))


def tolerance(name, options, vector):
    """What float32 allows, whoever adds up its products.

    Distances taken from lengths and a scalar product are above sqrt(2e-2) of the lengths, and sums of some hundred
    products in float32 err by less than 2e-6 of these squared. Closer vectors are compared value by value.
    """
    return {"rel": 1e-4, "abs": 1e-6 * aligned_distance(name, options, vector, 0 * vector, 0)}


@pytest.mark.data
@pytest.mark.parametrize("noise", [0.0, 1e-4, 1e-2])
@pytest.mark.parametrize(("name", "options", "score"), ALIGN, ids=[f"{row[0]} {row[1]}" for row in ALIGN])
def test_near_duplicates_are_as_far_apart_as_in_double_precision(name, options, score, noise):
    references = photographs((5, 40, 70, 95)).mean(axis=1) / 255
    rng = np.random.default_rng(4)
    turned = np.stack([np.roll(image, s, axis=-1) for image, s in zip(references, (0, 32, -48, 64), strict=True)])
    made = descriptor(name, **{**PARAMS[name], **options})
    known = made.describe(references)
    seen = made.describe(np.clip(turned + rng.normal(0, noise, turned.shape), 0, 1)) if noise else known
    found = made.align(seen, known)
    for i in range(4):
        steps = 64 if name == "fs" else known.orientation.shape[1]
        step = round(found.heading[i, i] * steps / (2 * np.pi)) % steps
        one, other = seen.orientation[i], known.orientation[i]
        expected = aligned_distance(name, options, one, other, step)
        assert found.distance[i, i] == pytest.approx(expected, **tolerance(name, options, one))


@pytest.mark.data
@pytest.mark.parametrize("name", DESCRIBE)
def test_a_photograph_has_no_distance_to_itself(name):
    made = descriptor(name, **PARAMS[name])
    seen = made.describe(photographs())
    np.testing.assert_array_equal(np.diag(made.align(seen, seen).distance), 0)
    np.testing.assert_array_equal(np.diag(made.align(seen, seen).heading), 0)
    for measure in DISTANCES:
        scale = distance(measure)(seen.position, 0 * seen.position).max()
        for apart in (made.pairwise(seen, seen, measure), distance(measure)(seen.position, seen.position)):
            np.testing.assert_allclose(np.diag(apart), 0, atol=1e-14 * scale)


@pytest.mark.parametrize("kind", ["noise", pytest.param("photographs", marks=pytest.mark.data)])
@pytest.mark.parametrize("name", DESCRIBE)
def test_distances_are_those_of_vectors_turned_alike(name, kind):
    queries, references = pairs(kind)
    made = descriptor(name, **PARAMS[name])
    q, r = made.describe(queries), made.describe(references)
    slow_queries = [DESCRIBE[name](grey(image), **PARAMS[name]) for image in queries]
    slow_references = [DESCRIBE[name](grey(image), **PARAMS[name]) for image in references]
    for measure in DISTANCES:
        found = made.pairwise(q, r, measure)
        expected = np.zeros(found.shape)
        for i, (position, orientation) in enumerate(slow_queries):
            for j, (of_map, map_orientation) in enumerate(slow_references):
                if made.aligned:
                    step = turns.best(turns.scores(orientation, map_orientation))
                    position, of_map = orientation.ravel(), np.roll(map_orientation, step, axis=0).ravel()
                expected[i, j] = turns.between(position, of_map, measure)
        np.testing.assert_allclose(found, expected, rtol=2e-4, atol=1e-5, err_msg=measure)
        if measure == made.default_distance:
            np.testing.assert_array_equal(made.pairwise(q, r), found)
            np.testing.assert_array_equal(made.localize(q, r).index, expected.argmin(axis=1))


@pytest.mark.parametrize("name", ["wisurf", "briefgist", "radon_poc"])
def test_without_a_circle_vectors_are_compared_as_they_stand(name):
    queries, references = pairs("noise")
    made = descriptor(name, **PARAMS[name], circular=False)
    q, r = made.describe(queries), made.describe(references)
    slow_queries = [DESCRIBE[name](grey(image), **PARAMS[name], circular=False)[0] for image in queries]
    slow_references = [DESCRIBE[name](grey(image), **PARAMS[name], circular=False)[0] for image in references]
    expected = [[turns.between(query, of_map, "manhattan") for of_map in slow_references] for query in slow_queries]
    np.testing.assert_allclose(made.pairwise(q, r, "manhattan"), expected, rtol=1e-4)
    with pytest.raises(AnalyticError, match="circular=False"):
        made.relative_heading(q, r)


def test_phase_only_correlation_is_that_of_the_transforms():
    queries, references = pairs("noise")
    made = descriptor("radon_poc", step=7.5, size=20)
    found = made.pairwise(made.describe(queries), made.describe(references))
    for i, query in enumerate(queries):
        for j, reference in enumerate(references):
            expected = 1 - max(radon.poc_scores(query, reference, step=7.5, size=20))
            assert found[i, j] == pytest.approx(expected, abs=1e-5)


def test_of_equal_turns_of_bits_the_smallest_to_the_left_is_taken():
    images = RNG.integers(0, 2, (24, 2, 16), dtype=np.uint8) * 255
    made = descriptor("briefgist", rows=2, columns=8)
    found = made.align(made.describe(images), made.describe(images)).heading
    hamming = made.pairwise(made.describe(images), made.describe(images))
    bits = [briefgist.describe(grey(image), 2, 8)[1] for image in images]
    ties = 0
    for i, query in enumerate(bits):
        for j, reference in enumerate(bits):
            different = [int((query != np.roll(reference, s, axis=0)).sum()) for s in range(8)]
            ties += different.count(min(different)) > 1
            assert hamming[i, j] == min(different)
            assert found[i, j] == pytest.approx(turns.angle(different.index(min(different)), 8), abs=1e-9)
    assert ties > 100
