"""Losses over a batch against loops, their gradients, and their refusals."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F
from hypothesis import given, settings
from hypothesis import strategies as st

from siamloc.errors import ConfigError, DataError
from siamloc.models.batch_losses import SoftContrastiveLoss, make_loss
from siamloc.models.origins import Origins
from siamloc.models.registry import LOSSES
from tests.oracles import mined_losses
from tests.oracles.soft_contrastive import soft_contrastive_loss

OF_PLACES = [name for name in LOSSES if name not in ("cross_entropy", "distillation")]  # of rooms, and of a teacher


def origins(xy, building=None, room=None, overlap=None):
    count = len(xy)
    building = torch.zeros(count, dtype=torch.int64) if building is None else torch.as_tensor(building)
    room = torch.zeros(count, dtype=torch.int64) if room is None else torch.as_tensor(room)
    return Origins(torch.as_tensor(xy), building, room, torch.arange(count), overlap=overlap)


def draw(images, dimensions, seed):
    generator = torch.Generator().manual_seed(seed)
    descriptors = F.normalize(torch.randn(images, dimensions, generator=generator))
    xy = 2 * torch.rand(images, 2, generator=generator)
    return descriptors, xy, torch.randint(0, 2, (images,), generator=generator)


@settings(deadline=None, max_examples=40)
@given(
    images=st.integers(2, 9),
    dimensions=st.integers(1, 8),
    temperature=st.floats(0.05, 2),
    sigma=st.floats(0.1, 3),
    kernel=st.sampled_from(["gaussian", "exponential", "overlap"]),
    share=st.sampled_from([0.0, 0.3, 1.0]),
    seed=st.integers(0, 1000),
)
def test_agrees_with_a_loop_over_pairs(images, dimensions, temperature, sigma, kernel, share, seed):
    descriptors, xy, building = draw(images, dimensions, seed)
    room = torch.randint(-1, 3, (images,), generator=torch.Generator().manual_seed(seed))
    if share:
        xy[0] = math.nan  # at unknown positions
    overlap = torch.rand(images, images, generator=torch.Generator().manual_seed(seed))
    overlap[overlap < 0.2], overlap[overlap > 0.8] = 0.0, math.nan  # nothing in common, and unknown
    parameters = {"temperature": temperature, "sigma": sigma, "kernel": kernel}
    loss = SoftContrastiveLoss(**parameters, room=share)(descriptors, origins(xy, building, room, overlap))
    given = descriptors.tolist(), xy.tolist(), building.tolist()
    more = {"rooms": room.tolist(), "room_share": share, "overlap": overlap.tolist()}
    expected = soft_contrastive_loss(*given, **parameters, **more)
    # float32 against float64: similarities up to 1 / 0.05 are rounded at 1e-6 of their size.
    assert loss.item() == pytest.approx(expected, rel=1e-4, abs=1e-5)


def test_distances_of_uncertain_positions_are_those_of_their_mean_squares():
    xy, deviation = (
        torch.tensor([[0.0, 0.0], [0.3, 0.4], [0.0, 0.0]]),
        torch.tensor([[0.1, 1.0], [0.2, 1.0], [0.1, 1.0]]),
    )
    number = torch.tensor([0, 1, 0])
    found = Origins(xy, torch.zeros(3), torch.zeros(3), number, deviation=deviation).distances()
    noise = torch.randn(200_000, 2, 2, generator=torch.Generator().manual_seed(0)) * deviation[:2, :1]
    apart = xy[0] + noise[:, 0] - xy[1] - noise[:, 1]
    assert float(found[0, 1]) == pytest.approx(float(apart.square().sum(dim=1).mean().sqrt()), rel=2e-3)
    assert found[0, 2] == found[0, 0] == 0, "one frame has one error"
    loss = SoftContrastiveLoss(kernel="exponential", sigma=0.2)
    alike = torch.nn.functional.normalize(torch.tensor([[1.0, 0.1], [1.0, 0.0], [0.0, 1.0]]))
    origins = Origins(torch.tensor([[0.0, 0], [0.1, 0], [0.3, 0]]), torch.zeros(3), torch.zeros(3), torch.arange(3))
    pulls = []
    for each in (0.0, 0.3):
        given = alike.clone().requires_grad_()
        loss(given, replace(origins, deviation=torch.tensor([[0.0, 0.0], [each, 0.0], [0.0, 0.0]]))).backward()
        pulls.append(given.grad)
    assert pulls[1][0] @ alike[2] < pulls[0][0] @ alike[2], "the certain neighbour pulls more beside an uncertain one"


def test_the_overlap_takes_the_place_of_the_distance():
    xy = torch.tensor([[0.0, 0], [0.1, 0], [3, 0]])
    hall = torch.tensor([[1.0, 0, 0.5], [0, 1, 0], [0.5, 0, 1]])  # the second image is behind a wall
    alike = torch.tensor([[1.0, 0], [0, 1], [1, 0]])  # the first and the third
    by_overlap, by_distance = (SoftContrastiveLoss(kernel=kernel) for kernel in ("overlap", "exponential"))
    swapped = alike[[0, 2, 1]]
    assert by_overlap(alike, origins(xy, overlap=hall)) < 0.1 < by_overlap(swapped, origins(xy, overlap=hall))
    assert by_distance(alike, origins(xy, overlap=hall)) > by_distance(swapped, origins(xy, overlap=hall))
    unknown = origins(xy, overlap=torch.full((3, 3), math.nan))
    assert by_overlap(alike, unknown) == 0


def farther(descriptors, xy, building, overlap, temperature, distance):
    """The term of images farther than a distance from each other, image by image."""
    costs, count = [], len(xy)
    for i in range(count):
        others = [
            j for j in range(count) if j != i and (building[i] != building[j] or not math.dist(xy[i], xy[j]) < distance)
        ]
        wanted = {j: overlap[i][j] ** 1.5 if overlap[i][j] == overlap[i][j] else 0.0 for j in others}
        total = sum(wanted.values())
        if total <= 0.01:
            continue
        alike = {j: sum(a * b for a, b in zip(descriptors[i], descriptors[j], strict=True)) for j in others}
        whole = sum(math.exp(value / temperature) for value in alike.values())
        costs.append(-sum(wanted[j] / total * (alike[j] / temperature - math.log(whole)) for j in others))
    return sum(costs) / max(len(costs), 1)


@pytest.mark.parametrize("seed", range(5))
def test_images_farther_apart_are_compared_by_their_overlap(seed):
    descriptors, xy, building = draw(7, 4, seed)
    overlap = torch.rand(7, 7, generator=torch.Generator().manual_seed(seed))
    overlap[overlap < 0.3], overlap[overlap > 0.9] = 0.0, math.nan
    where = origins(xy, building, overlap=overlap)
    given = descriptors.tolist(), xy.tolist(), building.tolist(), overlap.tolist()
    near = SoftContrastiveLoss(temperature=0.3)(descriptors, where)
    both = SoftContrastiveLoss(temperature=0.3, beyond=(0.6, 1.1))(descriptors, where)
    expected = near.item() / 2 + farther(*given, 0.3, 0.6) / 4 + farther(*given, 0.3, 1.1) / 4
    assert both.item() == pytest.approx(expected, rel=1e-4)
    assert both.item() != pytest.approx(near.item(), rel=1e-2)


def test_farther_images_have_rooms_or_surfaces_not_both():
    with pytest.raises(ConfigError, match=r"loss\.beyond compares surfaces, and loss\.room the names of rooms"):
        SoftContrastiveLoss(room=0.5, beyond=(1.0,))


@pytest.mark.parametrize(
    ("parameters", "instead"),
    [({"kernel": "overlap"}, "kernel=exponential or gaussian"), ({"beyond": (1.0,)}, "beyond=")],
)
def test_images_without_an_overlap_are_refused_before_the_training(parameters, instead):
    loss = SoftContrastiveLoss(**parameters)
    for call in (loss.lacks, lambda given: loss(torch.eye(2), given)):
        with pytest.raises(DataError, match=rf"the loss needs the visual overlap .* set loss\.{instead}"):
            call(origins(torch.zeros(2, 2)))


def test_gradients_are_finite_also_where_descriptors_are_equal():
    descriptors = F.normalize(torch.ones(6, 4)).requires_grad_()
    loss = SoftContrastiveLoss()(descriptors, origins(torch.rand(6, 2)))
    loss.backward()
    assert torch.isfinite(loss)
    assert torch.isfinite(descriptors.grad).all()


MULTI = {"near": 0.5, "far": 0.9, "alpha": 2.0, "beta": 5.0, "base": 0.4}
MINED = {
    "metric_calibrated": (mined_losses.metric_calibrated, {"cap": 1.3}),
    "triplet": (mined_losses.triplet, {"near": 0.5, "far": 0.9, "margin": 0.3}),
    "circle": (mined_losses.circle, {"near": 0.5, "far": 0.9, "m": 0.3, "gamma": 8.0}),
    "multi_similarity": (mined_losses.multi_similarity, MULTI),
}
TAUGHT_BY = {
    "triplet": mined_losses.triplet_costs,
    "circle": mined_losses.circle_slopes,
    "multi_similarity": mined_losses.multi_similarity_slopes,
}
MINERS = ["multi_similarity", "batch_hard", "batch_easy_hard", "semihard"]
MINED_WITH = [("metric_calibrated", {})] + [
    (name, {"miner": miner, "distance": distance})
    for name, distances in (
        ("triplet", ("euclidean", "squared", "cosine")),
        ("multi_similarity", ("cosine", "euclidean", "squared")),
        ("circle", ("cosine",)),
    )
    for distance in distances
    for miner in (None, *MINERS[: None if name == "triplet" else 3])
]


@pytest.mark.parametrize(("name", "further"), MINED_WITH)
@pytest.mark.parametrize("seed", range(5))
def test_miners_and_distances_agree_with_loops(name, further, seed):
    descriptors, xy, _ = draw(3 + 2 * seed, 3, seed)  # 5 images: one pair of each kind
    oracle, parameters = MINED[name]
    loss = make_loss(name, **parameters, **further)
    told = {key: value for key, value in further.items() if (name, key) != ("circle", "distance")}
    expected = oracle(descriptors.tolist(), xy.tolist(), **parameters, **told)
    # float32 against float64; exponents of up to 8 * 1.4 * 1.3 are rounded at 1e-6 of their size.
    assert loss(descriptors, origins(xy)).item() == pytest.approx(expected, rel=2e-4, abs=2e-5)
    if name in TAUGHT_BY:
        costs = TAUGHT_BY[name](descriptors.tolist(), xy.tolist(), **parameters, **told)
        active = sum(cost > (0 if name == "triplet" else 1e-3) for cost in costs) / max(len(costs), 1)
        assert loss.active(descriptors, origins(xy)).item() == pytest.approx(active)


@settings(deadline=None, max_examples=25)
@given(
    name=st.sampled_from(["triplet", "circle", "multi_similarity"]),
    miner=st.sampled_from(MINERS[:3]),
    images=st.integers(4, 14),
    seed=st.integers(0, 1000),
)
def test_a_miner_knows_nothing_of_the_order_nor_of_what_is_neither_near_nor_far(name, miner, images, seed):
    descriptors, xy, _ = draw(images, 4, seed)
    loss = make_loss(name, near=0.5, far=0.9, miner=miner)
    found = loss(descriptors, origins(xy))
    order = torch.randperm(images, generator=torch.Generator().manual_seed(seed))
    assert loss(descriptors[order], origins(xy[order])).item() == pytest.approx(found.item(), rel=1e-5, abs=1e-5)
    nowhere = origins(torch.cat([xy, torch.full((1, 2), math.nan)]))
    more = loss(torch.cat([descriptors, descriptors[:1]]), nowhere).item()
    share = images / (images + 1) if name == "multi_similarity" else 1  # which is a mean over all images
    assert more == pytest.approx(share * found.item(), rel=1e-5, abs=1e-5)


@pytest.mark.parametrize("name", OF_PLACES)
def test_every_loss_brings_neighbours_together(name):
    xy = torch.tensor([[0.0, 0], [0.1, 0], [5, 0], [5.1, 0]])
    weights = torch.randn(4, 8, generator=torch.Generator().manual_seed(0)).requires_grad_()
    optimizer = torch.optim.Adam([weights], lr=0.05)
    for _ in range(80):
        optimizer.zero_grad()
        make_loss(name)(F.normalize(weights), origins(xy)).backward()
        optimizer.step()
    alike = F.normalize(weights.detach()) @ F.normalize(weights.detach()).T
    assert min(alike[0, 1], alike[2, 3]) > alike[:2, 2:].max() + 0.2


@pytest.mark.parametrize("name", OF_PLACES)
def test_images_that_nobody_knows_a_place_of_cost_nothing(name):
    descriptors = draw(4, 3, 0)[0].requires_grad_()
    nowhere = origins(torch.full((4, 2), math.nan))
    loss = make_loss(name)
    cost = loss(descriptors, nowhere)
    cost.backward()
    assert cost.item() == 0
    assert not descriptors.grad.any()
    assert not hasattr(loss, "active") or loss.active(descriptors, nowhere) == 0


@pytest.mark.parametrize(
    ("name", "given", "says"),
    [
        ("circle", {"distance": "euclidean"}, "loss.distance must be cosine, got 'euclidean'"),
        ("circle", {"miner": "semihard"}, "loss.miner must be multi_similarity or batch_hard or batch_easy_hard, or"),
        ("soft_contrastive", {"temperature": 0}, "loss.temperature must be a number above 0"),
        ("triplet", {"miner": "hard"}, "loss.miner must be multi_similarity or batch_hard or batch_easy_hard or semi"),
        ("multi_similarity", {"distance": "dot"}, "loss.distance must be cosine or euclidean or squared, got 'dot'"),
        ("soft_contrastive", {"miner": "batch_hard"}, "unknown key loss.miner"),
        ("soft_contrastive", {"sigm": 0.2}, "unknown key loss.sigm: did you mean 'sigma'"),
        ("soft_contrast", {}, "did you mean 'soft_contrastive'"),
        ("triplet", {"far": 0.2}, "loss.far, 0.2, must not be less than loss.near, 0.3"),
        ("triplet", {"near": 0, "near_start": 1.0}, "loss.near_start shrinks by equal factors, never to 0"),
        ("triplet", {"near_start": 2.0}, "far begins with 1, which must not be less than what near begins with, 2"),
    ],
)
def test_what_has_no_meaning_is_refused(name, given, says):
    with pytest.raises(ConfigError, match=re.escape(says)):
        make_loss(name, **given)


@pytest.mark.parametrize(
    ("name", "begin", "middle", "end"),
    [
        ("soft_contrastive", {"sigma": 4.0}, {"sigma": 1.0}, {"sigma": 0.25}),
        ("metric_calibrated", {"cap": 4.0}, {"cap": 2.0}, {"cap": 1.0}),
        ("triplet", {"near": 0.9, "far": 1.6}, {"near": 0.6, "far": 1.2}, {"near": 0.4, "far": 0.9}),
        ("circle", {"far": 1.8}, {"far": 1.2}, {"far": 0.8}),
    ],
)
def test_distances_shrink_by_equal_factors(name, begin, middle, end):
    descriptors, xy, _ = draw(14, 4, 3)
    loss = make_loss(name, **end, **{f"{key}_start": value for key, value in begin.items()})
    for share, parameters in ((None, end), (0, begin), (0.5, middle), (1, end)):
        if share is not None:
            loss.progress(share)
        expected = make_loss(name, **parameters)(descriptors, origins(xy))
        assert expected > 0
        assert loss(descriptors, origins(xy)).item() == pytest.approx(expected.item(), rel=1e-5)
