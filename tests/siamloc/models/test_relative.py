"""Where an image was taken relative to another: turns turn the answer, the features stay as they are, and it learns."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

import siamloc
from siamloc.errors import ConfigError, DataError
from siamloc.maps import joining
from siamloc.models import as_descriptor, build
from siamloc.models.checkpoint import without_layer
from siamloc.models.network import Network
from siamloc.models.origins import Origins
from siamloc.models.places import PlaceModule
from siamloc.models.registry import Optimizer
from siamloc.models.relative import FREEDOM, REACH, SHARED, RelativePose, _inverse, compared, relative_loss

SIZE, COLUMNS, VALUES = (32, 128), 16, 64
COLUMN = 2 * math.pi / COLUMNS


@pytest.fixture(scope="module")
def network() -> Network:
    found = build("panoresnet", "magnitudes", SIZE, circular=True, relative=True).eval()
    assert found.relative is not None
    with torch.no_grad():  # votes large enough to see how they turn
        found.relative.votes.weight[:3] *= 300
    return found


@pytest.fixture(scope="module")
def ahead() -> Network:
    """A network for images of an ordinary camera."""
    return build("panoresnet", "magnitudes", SIZE, relative=True).eval()


def parts(count: int, seed: int = 0) -> Tensor:
    return torch.randn(count, COLUMNS, VALUES, generator=torch.Generator().manual_seed(seed))


def test_the_shipped_network_recognizes_images_of_one_spot():
    """A robot may stand where a map frame was taken, which two drives hardly ever show to the training."""
    relative = siamloc.models.pretrained().relative
    noise = torch.randn(2, 12, relative.columns, 64, generator=torch.Generator().manual_seed(0))
    known, other = noise / noise.square().mean(dim=(2, 3), keepdim=True).sqrt()
    for turn in (0, 9):
        same = relative((known + 0.1 * other).roll(turn, dims=1), known)
        assert same.match.min() > 0 > relative(other, known).match.max()
        assert same.pose[:, :2].norm(dim=1).max() < 0.05


def test_turning_both_turns_the_displacement_and_not_the_turn(network):
    query, known = parts(5), parts(5, 1)
    before = network.relative(query, known)
    for columns in (1, 5):
        after = network.relative(query.roll(columns, dims=1), known.roll(columns, dims=1))
        # What moves to columns on the right is seen by a robot that has turned left.
        cosine, sine = math.cos(columns * COLUMN), -math.sin(columns * COLUMN)
        turn = torch.tensor([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1.0]])
        torch.testing.assert_close(after.pose, before.pose @ turn.T, rtol=1e-4, atol=1e-4)
        torch.testing.assert_close(after.information, turn @ before.information @ turn.T, rtol=1e-4, atol=1e-3)
        torch.testing.assert_close(after.match, before.match, rtol=1e-4, atol=1e-5)
    assert before.pose[:, :2].norm(dim=1).min() > 0.01, "there is something to turn"


def test_turning_the_query_adds_to_the_turn_alone(network):
    known = parts(4)
    query = known + 0.2 * parts(4, 1)
    before = network.relative(query, known)
    after = network.relative(query.roll(3, dims=1), known)
    torch.testing.assert_close(after.pose[:, :2], before.pose[:, :2], rtol=1e-4, atol=1e-5)
    turned = torch.remainder(after.pose[:, 2] - before.pose[:, 2] - 3 * COLUMN + math.pi, 2 * math.pi) - math.pi
    torch.testing.assert_close(turned, torch.zeros(4), rtol=0, atol=1e-4)
    torch.testing.assert_close(after.steps, torch.full((4,), COLUMNS - 3))


def test_images_of_an_ordinary_camera_are_not_turned_and_their_outer_columns_are_not_neighbours(ahead):
    query, known = parts(4), parts(4, 1)
    changed = query.clone()
    changed[:, -1] += 1
    (before, _), (after, _) = (ahead.relative._votes(one, known) for one in (query, changed))
    reach = ahead.relative.shifts + 4  # the windows, and four layers
    assert torch.equal(before[..., : COLUMNS - 1 - reach], after[..., : COLUMNS - 1 - reach])
    assert not torch.equal(before[..., -1], after[..., -1])
    assert not ahead.relative(query.roll(3, dims=1), query).steps.any()


def test_a_network_of_ordinary_images_compares_them_and_gives_no_heading(ahead):
    descriptor = as_descriptor(ahead)
    assert descriptor.compares
    assert not descriptor.tells_heading
    images = torch.rand(2, 3, *SIZE, generator=torch.Generator().manual_seed(0))
    images[1, :, :, 64:] = images[0, :, :, 64:]
    seen = descriptor.describe(images).orientation
    assert seen.shape == (2, COLUMNS, VALUES)
    alike = [np.corrcoef(*seen[:, column])[0, 1] for column in (2, -3)]
    assert alike[0] < 0.5, "each column shows its own part of the image"
    assert alike[1] > 0.9
    assert all(np.isfinite(one).all() for one in descriptor.compare(seen, seen))


def test_the_errors_have_the_distribution_that_the_answers_are_joined_by():
    assert FREEDOM == joining.FREEDOM


def test_the_inverse_is_the_inverse():
    factor = torch.randn(20, 3, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    matrix = factor @ factor.mT + 0.1 * torch.eye(3, dtype=torch.float64)
    torch.testing.assert_close(_inverse(matrix), torch.linalg.inv(matrix))


def origins(count: int, seed: int = 0) -> Origins:
    rng = torch.Generator().manual_seed(seed)
    return Origins(
        xy=10 * torch.rand(count, 2, generator=rng),
        building=torch.zeros(count, dtype=torch.int64),
        room=torch.zeros(count, dtype=torch.int64),
        frame=torch.arange(count),
        theta=2 * math.pi * torch.rand(count, generator=rng),
    )


def test_images_are_compared_with_near_ones_and_with_other_places_that_look_alike():
    where = origins(30)
    where.theta[3] = math.nan
    descriptors = torch.nn.functional.normalize(torch.randn(30, 8, generator=torch.Generator().manual_seed(0)))
    query, known, counts = compared(where, descriptors)
    assert len(query) == len(known) == 30 * 6, "whatever the images are, so that nothing waits to learn the number"
    query, known = query[counts], known[counts]
    assert (query != known).all()
    assert 3 not in query.tolist() + known.tolist()
    itself = torch.eye(30, dtype=torch.bool)
    apart = where.distances().masked_fill(itself, math.inf)
    apart[3], apart[:, 3] = math.inf, math.inf
    likeness = descriptors @ descriptors.T
    likeness[3], likeness[:, 3] = -math.inf, -math.inf
    for row in (0, 7, 29):
        chosen = known[query == row].tolist()
        assert chosen[:3] == apart[row].argsort()[[0, 4, 10]].tolist()
        others = [torch.where(apart[row] > least, likeness[row], -math.inf) for least in (1, 3, REACH)]
        others = [one.masked_fill(itself[row], -math.inf) for one in others]
        assert chosen[3:] == [int(one.argmax()) for one in others]


def loss_of_a_list(relative: RelativePose, orientation: Tensor, where: Origins, descriptors: Tensor) -> Tensor:
    """`relative_loss` of the pairs that count alone, one by one."""
    query, known, counts = compared(where, descriptors)
    poses, matches, turns = [], [], []
    for i, j in zip(query[counts].tolist(), known[counts].tolist(), strict=True):
        x, y = where.xy[i] - where.xy[j]
        cosine, sine = where.theta[j].cos(), where.theta[j].sin()
        turn = where.theta[i] - where.theta[j]
        found = relative(orientation[i : i + 1], orientation[j : j + 1])
        off = torch.remainder(turn + found.steps * COLUMN + math.pi, 2 * math.pi) - math.pi
        most = 2 * COLUMN if relative.circular else 0.5
        near = torch.hypot(x, y) <= REACH and where.building[i] == where.building[j]
        near &= where.overlap is None or not where.overlap[i, j] < SHARED
        if near and relative.circular:
            between = -turn.item() / COLUMN
            at = math.floor(between) % COLUMNS, (math.floor(between) + 1) % COLUMNS
            share = between - math.floor(between)
            turns.append(-(1 - share) * found.turns[0, at[0]] - share * found.turns[0, at[1]])
        near &= bool(abs(off) <= most)
        sign = 1.0 if near else -1.0
        matches.append(-torch.nn.functional.logsigmoid(sign * found.match[0]))
        if near:
            error = torch.stack([cosine * x + sine * y, cosine * y - sine * x, turn]) - found.pose[0]
            error = torch.cat([error[:2], torch.remainder(error[2:] + math.pi, 2 * math.pi) - math.pi])
            information = found.information[0]
            if where.deviation is not None:  # by the derivatives of the true pose, and matching covariances of errors
                given = torch.cat([where.xy[i], where.theta[i : i + 1], where.xy[j], where.theta[j : j + 1]])
                slopes = torch.autograd.functional.jacobian(seen_from, given)
                variances = where.deviation[[i, i, i, j, j, j], [0, 0, 1, 0, 0, 1]].square()
                blur = slopes @ torch.diag(variances) @ slopes.T * (FREEDOM - 2) / FREEDOM
                information = (information.inverse() + blur).inverse()
            squared = error @ information @ error
            poses.append(0.5 * (FREEDOM + 3) * (1 + squared / FREEDOM).log() - 0.5 * information.logdet())
    learned = torch.stack(poses).mean() + torch.stack(matches).mean()
    return learned + torch.stack(turns).mean() if turns else learned


def seen_from(given: Tensor) -> Tensor:
    """Return the pose of a query as seen from a map frame: both poses in a row (6,)."""
    apart, cosine, sine = given[:2] - given[3:5], given[5].cos(), given[5].sin()
    ahead, left = cosine * apart[0] + sine * apart[1], cosine * apart[1] - sine * apart[0]
    return torch.stack([ahead, left, given[2] - given[5]])


@pytest.mark.parametrize(
    ("count", "circular", "surveyed"), [(3, True, False), (16, True, False), (16, False, False), (16, True, True)]
)
def test_pairs_that_do_not_count_change_neither_the_loss_nor_its_gradients(network, ahead, count, circular, surveyed):
    where = origins(count)
    if surveyed:
        where = replace(where, deviation=torch.rand(count, 2, generator=torch.Generator().manual_seed(1)) * 0.3)
    network = network if circular else ahead
    if count > 3:
        where.theta[3], where.xy[5], where.xy[6, 1] = math.nan, math.nan, math.inf
        where.building[:4] = 1
        overlap = torch.rand(count, count, generator=torch.Generator().manual_seed(1)) ** 4
        where = replace(where, overlap=overlap.where(overlap < 0.9, math.nan))
    seen = seen_in_a_round_room(where.xy.nan_to_num(posinf=0) / 5, where.theta.nan_to_num(), seed=0)
    descriptors = torch.nn.functional.normalize(torch.randn(count, 8, generator=torch.Generator().manual_seed(0)))
    gradients, losses = [], []
    for loss in (loss_of_a_list, relative_loss):
        network.zero_grad()
        orientation = seen.clone().requires_grad_()
        found = loss(network.relative, orientation, where, descriptors)
        losses.append(found if isinstance(found, Tensor) else found[0])
        losses[-1].backward()
        gradients.append([orientation.grad, *(one.grad.clone() for one in network.relative.parameters())])
    torch.testing.assert_close(losses[1], losses[0])
    for one, other in zip(*gradients, strict=True):  # sums in another order are off by a share of their largest terms
        torch.testing.assert_close(other, one, rtol=0, atol=1e-4 * max(float(one.abs().max()), 1e-2))


def seen_in_a_round_room(where: Tensor, theta: Tensor, seed: int, field: float = 2 * math.pi) -> Tensor:
    """Return the view of a textured wall at 3 m in 16 directions of a field of view: (N, 16, 64)."""
    rng = torch.Generator().manual_seed(seed)
    waves = torch.randint(1, 6, (VALUES,), generator=rng)
    phase = 2 * math.pi * torch.rand(VALUES, generator=rng)
    azimuth = -(torch.arange(COLUMNS) + 0.5 - COLUMNS / 2) * (field / COLUMNS)
    ahead = theta[:, None] + azimuth
    ray = torch.stack([ahead.cos(), ahead.sin()], dim=-1)
    along = (ray * where[:, None]).sum(dim=-1)
    reach = -along + (along**2 - (where**2).sum(dim=-1)[:, None] + 9).sqrt()
    hit = where[:, None] + reach[..., None] * ray
    angle = torch.atan2(hit[..., 1], hit[..., 0])
    return 1.4 * (angle[..., None] * waves + phase).cos()


@pytest.mark.slow
@pytest.mark.parametrize("circular", [True, False])
def test_displacements_and_turns_are_learned(circular):
    rng = torch.Generator().manual_seed(0)
    torch.manual_seed(0)
    relative = RelativePose(COLUMNS, VALUES, circular)
    relative.reset()
    optimizer = torch.optim.AdamW(relative.parameters(), lr=0.002)
    errors = []
    for step in range(120):
        where = origins(24, step)
        where.xy[:] = 3 * (torch.rand(24, 2, generator=rng) - 0.5)
        if not circular:
            where.theta[:] = 0.1 * torch.randn(24, generator=rng)
        shown = seen_in_a_round_room(where.xy, where.theta, 0, 2 * math.pi if circular else 1.2)
        loss, error = relative_loss(relative, shown, where, torch.randn(24, 8, generator=rng))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        errors.append(float(error))
    assert sum(errors[:5]) / 5 > 0.5, "images are far apart"
    # An ordinary camera hardly shows how far ahead it moved.
    assert sum(errors[-10:]) / 10 < (0.25 if circular else 1.0)


def test_the_features_learn_what_they_learn_without_it():
    rng = torch.Generator().manual_seed(0)
    where = origins(8)
    batch = {"images": torch.rand(8, 3, *SIZE, generator=rng), "theta": where.theta}
    batch |= {name: getattr(where, name) for name in ("xy", "building", "room", "frame")}
    weights = []
    for relative in (False, True):
        network = build("panoresnet", "fourier", SIZE, circular=True, relative=relative)
        module = PlaceModule(network, optimizer=Optimizer(learning_rate=0.1))
        optimizer = module.configure_optimizers()
        for _ in range(2):
            optimizer.zero_grad()
            module.training_step(batch, 0).backward()
            if relative:
                module.configure_gradient_clipping(optimizer, 0.01)
            else:
                torch.nn.utils.clip_grad_norm_(module.parameters(), 0.01)
            optimizer.step()
        weights.append({name: value for name, value in network.state_dict().items() if name.startswith(("br", "head"))})
    before = build("panoresnet", "fourier", SIZE, circular=True, relative=True)
    assert not torch.equal(network.relative.first.weight, before.relative.first.weight)
    assert not torch.equal(network.orientation.signs, before.orientation.signs), "its sums are learned, too"
    for name, value in weights[0].items():
        torch.testing.assert_close(weights[1][name], value, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize(
    "options", [{"circular": False, "head": "flat"}, {"head": "gem"}, {"branch": "simple1", "image_size": (4, 16)}]
)
def test_networks_without_orientation_parts_are_refused(options):
    wanted = {"branch": "panoresnet", "head": "magnitudes", "image_size": SIZE, "circular": True, **options}
    with pytest.raises(ConfigError, match=r"model\.relative=true .* needs the head fourier or magnitudes"):
        build(**wanted, relative=True)


def test_displacements_alone_are_learned_if_the_descriptors_are_frozen(tmp_path):
    """As the guide does with the shipped network: its head has no weights, and all stages of its branch are frozen."""
    images = siamloc.data.example()
    network = build("panoresnet", "magnitudes", images.image_shape[1:], circular=True, relative=True)
    pairs, frozen = {"places": 4, "images": 2, "epoch_batches": 1}, {"name": "adamw", "frozen_stages": 4}
    before = {name: value.clone() for name, value in network.state_dict().items()}
    more = {"pairs": pairs, "optimizer": frozen, "epochs": 1, "run": tmp_path / "run"}
    siamloc.training.fit(network, images, images.frames, **more)
    changed = {name.partition(".")[0] for name, value in network.state_dict().items() if not value.equal(before[name])}
    assert changed == {"orientation", "relative"}


def test_headings_in_rad_and_positions_in_metres_are_needed(tmp_path):
    images = siamloc.data.example()
    network = build("panoresnet", "magnitudes", images.image_shape[1:], circular=True, relative=True)
    frames, tuesday = (images.frames.select(sequence=day) for day in ("monday", "tuesday"))
    way = {"pairs": {"places": 4, "images": 2, "epoch_batches": 2}, "epochs": 1, "run": tmp_path / "run"}
    blind, degrees = np.full(len(frames), np.nan), np.linspace(0, 350, len(frames))
    for theta, says in ((blind, ", and the training frames have none"), (degrees, ": theta looks like degrees")):
        with pytest.raises(DataError, match=f"learned from headings{says}"):
            siamloc.training.fit(network, images, frames.with_columns(theta=theta), **way)
    with pytest.raises(DataError, match="positions in metres, and those of the training frames are in 'ft'"):
        siamloc.training.fit(network, images, replace(frames, unit="ft"), **way)
    with pytest.raises(ConfigError, match="learned from batches of places by their positions"):
        siamloc.training.fit(network, images, frames, run=tmp_path / "run", epochs=1)
    run = siamloc.training.fit(network, images, frames, **way)
    assert np.isfinite(run.curves()["train/relative"]).all()
    again = siamloc.models.load(run)
    assert again.relative is not None
    torch.testing.assert_close(again.relative.first.weight, network.relative.first.weight)
    way |= {"run": tmp_path / "judged", "validation": tuesday}
    without = build("panoresnet", "magnitudes", images.image_shape[1:], circular=True)
    with pytest.raises(ConfigError, match=r"monitor=refined needs model\.relative=true"):
        siamloc.training.fit(without, images, frames, monitor="refined", **way)
    judged = siamloc.training.fit(network, images, frames, **way)
    assert judged.settings["training"]["monitor"] == "refined"
    known = siamloc.maps.build(siamloc.models.load(judged), images, frames, progress=False)
    asked = {"refine": "relative", "neighbours": 1, "names": ("absolute",), "baselines": ()}
    evaluated = siamloc.evaluation.localization(known, images, tuesday, **asked).tables["queries"]["refined_error"]
    np.testing.assert_allclose(judged.curves()["val/refined"], evaluated.mean(), rtol=1e-3)  # in other precisions


def test_a_batch_without_a_usable_pair_costs_nothing_that_is_not_finite(network):
    for known in (0, 1):
        where = origins(6)
        where.theta[known:] = math.nan
        loss, error = relative_loss(network.relative, parts(6), where, torch.randn(6, 8))
        assert torch.isfinite(loss)
        assert torch.isnan(error)


def test_weights_that_compare_travel_where_they_fit(network, tmp_path, capsys):
    path = siamloc.models.save_weights(network, tmp_path / "whole.safetensors")
    again = siamloc.models.load(path)
    torch.testing.assert_close(again.relative.first.weight, network.relative.first.weight, rtol=1e-2, atol=1e-3)
    like = {"branch": "panoresnet", "head": "magnitudes", "circular": True}
    without = build(**like, image_size=SIZE, weights=str(path))
    assert without.relative is None
    assert "the whole network" in capsys.readouterr().err
    wider = build(**like, image_size=(32, 256), weights=str(path), relative=True, seed=3)
    fresh = build(**like, image_size=(32, 256), relative=True, seed=3)
    torch.testing.assert_close(wider.relative.first.weight, fresh.relative.first.weight)  # of other columns
    ahead = build(**{**like, "circular": False}, image_size=SIZE, weights=str(path), relative=True, seed=3)
    torch.testing.assert_close(ahead.relative.first.weight, fresh.relative.first.weight)  # learned on full turns
    bare = siamloc.models.save_weights(without, tmp_path / "bare.safetensors")
    begun = build(**like, image_size=SIZE, weights=str(bare), relative=True)
    for name, value in without.branch.state_dict().items():
        torch.testing.assert_close(begun.branch.state_dict()[name], value, rtol=1e-2, atol=1e-3)
    fourier = build("panoresnet", "fourier", SIZE, circular=True, relative=True, seed=5)
    kept = without_layer(fourier)
    assert kept.head.name == "magnitudes"
    torch.testing.assert_close(kept.relative.first.weight, fourier.relative.first.weight)
    torch.testing.assert_close(kept.orientation.signs, fourier.orientation.signs)


def test_what_does_not_go_with_it_is_refused(network):
    with pytest.raises(ConfigError, match="learned from batches of places, and these are pairs"):
        siamloc.models.SiameseModule(network)
    batch = {"images": torch.rand(4, 3, *SIZE)}
    where = origins(4)
    batch |= {name: getattr(where, name) for name in ("xy", "building", "room", "frame")}
    with pytest.raises(DataError, match="a batch needs theta as well"):
        PlaceModule(network).training_step(batch, 0)
