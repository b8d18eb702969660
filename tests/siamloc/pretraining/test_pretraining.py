"""Learning from random buildings: what is in a batch depends on the seed, not on how fast buildings arrive."""

from __future__ import annotations

import multiprocessing
import time
from inspect import signature
from typing import Any

import numpy as np
import pytest
import torch

import siamloc
from foundation.files import read_json, write_json
from foundation.settings import fields_of
from siamloc.cli.compose import composed
from siamloc.data.places import PlaceSettings
from siamloc.errors import ConfigError, DataError
from siamloc.models.origins import Origins
from siamloc.models.places import PlaceModule
from siamloc.pretraining import RECIPE, ViewSettings, pretrain, view_batches
from siamloc.pretraining.view_batches import Renderer, ViewBatches, building_seed
from siamloc.simulate.buildings import Worlds
from siamloc.simulate.camera import Cameras
from siamloc.simulate.views import Exposures, Imagings, Views, camera_of, draw_views

SIZE = (16, 64)
SETTINGS = ViewSettings(batches=2, held=3, together=2, drives=2, lights=3, poses=6, processes=0)
PLACES = PlaceSettings(places=4, images=3, near=0.5, reach=1.5, epoch_batches=4)


def drawn(
    seed: int, image_size, drives: int, lights: int, poses: int, spacing: float = 0.3, cameras: Cameras = "any", *_
) -> Views:
    """Stand in for rendering: noise that follows from the seed, along a line."""
    rng = np.random.default_rng(seed)
    count = drives * lights * poses
    xy = np.column_stack([np.tile(np.repeat(np.arange(poses) * 0.3, lights), drives), np.full(count, seed % 7)])
    light = np.concatenate([np.tile(np.arange(lights) + drive * lights, poses) for drive in range(drives)])
    images = rng.integers(0, 256, (count, 3, *image_size), dtype=np.uint8)
    lighting = tuple(["cloudy", "night", "sunny"][number % 3] for number in range(drives * lights))
    overlap = rng.random((drives * poses, drives * poses))
    room, pose = (xy[:, 0] > 0.9).astype(int), np.arange(count) // lights
    overlap, wraps = (overlap + overlap.T) / 2, cameras != "ordinary"
    return Views(images, xy, np.zeros(count), room, light, lighting, pose, overlap, wraps)


@pytest.fixture
def rendered(monkeypatch):
    """Replace rendering, and note which buildings were asked for."""
    asked: list[int] = []

    def noted(seed, *others):
        asked.append(seed)
        return drawn(seed, *others)

    monkeypatch.setattr(view_batches, "draw_views", noted)
    return asked


def batches(seed: int = 0, rank: int = 0, world_size: int = 1) -> ViewBatches:
    return ViewBatches(Renderer(0), SIZE, SETTINGS, PLACES, seed, rank, world_size)


def test_a_batch_follows_from_its_number_alone(rendered):
    forwards = batches()
    in_order = [forwards[divmod(number, 4)] for number in range(10)]
    alone = batches()[(2, 1)]
    for name, value in in_order[9].items():
        torch.testing.assert_close(alone[name], value)
    assert not torch.equal(in_order[0]["images"], in_order[1]["images"])
    assert not torch.equal(batches(seed=1)[(0, 0)]["images"], in_order[0]["images"])


def test_a_batch_has_several_pictures_of_each_place_under_different_lights(rendered):
    source = batches()
    views, frames, rows = source.drawn(2, 0)
    assert len(views) == SETTINGS.together
    item = source[(2, 0)]
    assert item["images"].shape == (12, 3, *SIZE)
    for place in rows.reshape(PLACES.places, PLACES.images):
        assert len(set(frames.building[place].tolist())) == 1
        assert np.ptp(frames.x[place]) <= 2 * PLACES.radius + 1e-9
        assert len(set(frames.lighting[place].tolist())) == PLACES.images
    # The pictures are those of the rows.
    first = len(views[0])
    for row, picture in zip(rows, item["images"].numpy(), strict=True):
        one, number = (views[0], row) if row < first else (views[1], row - first)
        np.testing.assert_array_equal(picture, one.images[number])


def test_a_batch_has_the_overlap_of_its_pictures(rendered):
    source = batches()
    views, _, rows = source.drawn(2, 0)
    overlap = source[(2, 0)]["overlap"].numpy()
    for i, j in np.ndindex(*overlap.shape):
        (one, row), (other, column) = ((rows[k] // len(views[0]), rows[k] % len(views[0])) for k in (i, j))
        expected = views[one].overlap[views[one].pose[row], views[one].pose[column]] if one == other else 0
        assert overlap[i, j] == pytest.approx(expected), "none between two buildings"
    assert (overlap == 0).any()


def test_processes_that_train_together_have_no_overlap_with_each_other(rendered, monkeypatch):
    item, module = batches()[(0, 0)], PlaceModule(RECIPE.build(image_size=SIZE))
    monkeypatch.setattr(module, "all_gather", lambda value, sync_grads: torch.stack([value, 2 * value]))
    origins = Origins(**{name: item[name] for name in ("xy", "building", "room", "frame", "overlap")})
    together = module._of_all(torch.zeros(12, 4), origins)[1].overlap
    torch.testing.assert_close(together[:12, :12], item["overlap"])
    torch.testing.assert_close(together[12:, 12:], 2 * item["overlap"])
    assert not together[:12, 12:].any()
    assert not together[12:, :12].any()


def test_buildings_come_and_go(rendered):
    source = batches(seed=3)
    assert len(source.held(0)) == 1
    assert len(source.held(5)) == SETTINGS.held
    assert rendered == [building_seed(3, number) for number in (0, 3, 4, 5)]
    source.held(6)
    assert rendered[-1] == building_seed(3, 6)
    assert len(rendered) == 5, "those that were there are not rendered again"


def test_all_settings_of_the_views_reach_the_renderer(monkeypatch):
    asked: list[dict[str, Any]] = []

    def noted(*wanted):
        asked.append(signature(draw_views).bind(*wanted).arguments)
        return drawn(*wanted)

    monkeypatch.setattr(view_batches, "draw_views", noted)
    of_a_building = {"drives": 3, "lights": 2, "poses": 5, "spacing": 0.7, "cameras": "ordinary"}
    of_a_building |= {"exposure": "metered", "worlds": "offices", "imaging": "plain"}
    ViewBatches(Renderer(0), SIZE, ViewSettings(**of_a_building, processes=0), PLACES, seed=1).held(0)
    assert asked == [{"seed": building_seed(1, 0), "image_size": SIZE, **of_a_building}]


def test_processes_that_train_together_have_buildings_of_their_own(rendered):
    one, other = (batches(rank=rank, world_size=2)[(1, 0)] for rank in range(2))
    assert not set(one["building"].tolist()) & set(other["building"].tolist())
    assert not set(one["frame"].tolist()) & set(other["frame"].tolist())
    assert len(set(rendered)) == len(rendered)


def test_a_training_that_is_resumed_is_one_that_never_stopped(rendered, tmp_path, monkeypatch):
    monkeypatch.setattr(view_batches, "_VALIDATION_POSES", 4)
    changes = {
        "pairs": {"places": 4, "images": 2, "epoch_batches": 3},
        "views": {"batches": 2, "held": 2, "together": 1, "lights": 3, "poses": 6, "processes": 0},
        "optimizer": {"schedule": "constant"},
        "average": None,
        "trainer": {"precision": "32-true"},
    }

    def network():
        return RECIPE.build(image_size=SIZE)

    whole = network()
    pretrain(whole, run=tmp_path / "whole", epochs=2, **changes)
    parts = network()
    run = pretrain(parts, run=tmp_path / "parts", epochs=1, **changes)
    assert np.isfinite(run.curves()["val/recall"]).all()
    pretrain(parts, run=run, epochs=2, resume=True, **changes)
    curves = [siamloc.training.Run(tmp_path / name).curves() for name in ("whole", "parts")]
    np.testing.assert_allclose(curves[0]["train/loss"], curves[1]["train/loss"], rtol=1e-5)
    again = {**changes, "views": {**changes["views"], "lights": 2}}
    with pytest.raises(ConfigError, match=r"views\.lights"):
        pretrain(parts, run=run, epochs=3, resume=True, **again)
    started = RECIPE.build(image_size=SIZE, weights=run)
    for name, value in siamloc.models.load(run).state_dict().items():
        torch.testing.assert_close(started.state_dict()[name], value)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"pairs": {"epoch_batches": None}}, "epoch_batches"),
        ({"views": {"together": 9, "held": 4}}, r"views\.together=9"),
        ({"pairs": {"by": "sequence"}}, r"leave out pairs\.by=sequence"),
        ({"views": {"drives": 1, "lights": 1, "poses": 8}}, r"set views\.poses larger"),
        ({"workers": 2}, r"views\.processes"),
        ({"epochs": 1, "settings": siamloc.training.Training()}, "give epochs in it"),
        ({"monitor": "room"}, "monitor=room"),
        ({"loss": siamloc.models.CrossEntropyLoss()}, "one building after another"),
        ({"network": torch.nn.Flatten()}, "network must be a Network, got Flatten"),
        ({"network": siamloc.models.build("simple1", "fc500_500_5", image_size=SIZE)}, "length 1"),
    ],
)
def test_settings_without_a_meaning(tmp_path, given, says):
    given = {"network": RECIPE.build(image_size=SIZE), **given}
    with pytest.raises(ConfigError, match=says):
        pretrain(run=tmp_path / "a", **given)
    assert not (tmp_path / "a").exists()


def test_the_command_is_the_recipe():
    config, wanted = composed("pretrain", []), RECIPE
    assert config.training == siamloc.training.Training.of(wanted.training)
    assert config.views == ViewSettings()
    options = config.model.arguments()
    assert siamloc.models.build(**options, image_size=config.image_size).settings == wanted.build().settings
    loss = config.make_loss()
    assert {key: loss.settings[key] for key in wanted.loss} == wanted.loss
    assert config.trainer.precision == wanted.trainer["precision"]


def test_choices_of_the_command_take_the_place_of_the_recipes():
    assert composed("pretrain", ["optimizer=sgd"]).training.optimizer == siamloc.training.Optimizer()
    assert composed("pretrain", ["loss=triplet"]).make_loss().settings["name"] == "triplet"
    assert composed("pretrain", ["pairs=in_batch"]).training.pairs == PlaceSettings()
    assert composed("pretrain", ["pairs.places=8"]).training.pairs.places == 8


@pytest.mark.slow
def test_buildings_of_other_processes_are_those_of_this_one():
    wanted = (7, SIZE, 1, 2, 3, 0.4)
    before, there = {child.pid for child in multiprocessing.active_children()}, Renderer(1)
    try:
        there.begin(wanted)
        one, other = there.views(wanted), Renderer(0).views(wanted)
        np.testing.assert_array_equal(one.images, other.images)
        np.testing.assert_array_equal(one.xy, other.xy)
        (child,) = [child for child in multiprocessing.active_children() if child.pid not in before]
        child.kill()
        child.join()
        with pytest.raises(DataError, match=r"died.*fewer views\.processes"):
            there.views((8, *wanted[1:]))
    finally:
        there.close()


@pytest.mark.slow
def test_a_training_that_fails_leaves_no_process_behind(tmp_path):
    class Failing(torch.nn.Module):
        def forward(self, descriptors, origins):
            raise RuntimeError("as it was asked to")

    before = {child.pid for child in multiprocessing.active_children()}
    views = {"held": 2, "together": 1, "lights": 1, "drives": 1, "poses": 16, "processes": 1}
    places = {"places": 4, "images": 2, "epoch_batches": 2}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(view_batches, "_VALIDATION_POSES", 2)
        with pytest.raises(RuntimeError, match="as it was asked to"):
            pretrain(RECIPE.build(image_size=SIZE), run=tmp_path / "a", views=views, pairs=places, loss=Failing())
    until = time.monotonic() + 60
    while {child.pid for child in multiprocessing.active_children()} - before and time.monotonic() < until:
        time.sleep(0.1)  # the thread of the executor collects them, alongside which `join` may return too early
    assert not {child.pid for child in multiprocessing.active_children()} - before
    assert not list((tmp_path / "a").rglob("*.ckpt"))


def test_the_command_trains_and_says_how_to_go_on(rendered, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(view_batches, "_VALIDATION_POSES", 3)
    words = ["pairs.epoch_batches=2", "pairs.places=3", "pairs.images=2", "image_size=[16,64]", "optimizer=sgd"]
    views = ["views.held=2", "views.together=1", "views.poses=6", "views.processes=0", "loss.kernel=overlap"]
    words.append("model/head=fourier")
    former = ["views.worlds=offices", "views.imaging=plain", "loss.beyond=[]"]
    run = tmp_path / "run"
    given = [f"run={run}", "epochs=1", *words, *views, *former, "trainer.precision=32-true"]
    assert siamloc.cli.main(["pretrain", *given]) == 0
    assert (
        f"next: siamloc train experiment=fine_tuning model.branch.weights={run / 'weights.safetensors'}"
        in capsys.readouterr().out
    )
    kept, best = siamloc.models.load(run / "weights.safetensors"), siamloc.models.load(run)
    assert (best.head.name, kept.head.name) == ("fourier", "magnitudes")
    for name, value in kept.state_dict().items():
        torch.testing.assert_close(value, best.state_dict()[name], rtol=2**-11, atol=1e-7)
    record = read_json(run / "run.json")
    for section, key in (("views", "worlds"), ("views", "imaging"), ("loss", "beyond")):
        del record["settings"][section][key]  # a run of a version before these settings goes on as it began
    write_json(run / "run.json", record)
    assert siamloc.cli.main(["pretrain", f"run={run}", "resume=true", "epochs=2"]) == 0
    assert len(siamloc.training.Run(run).curves()["epoch"]) == 2


def test_the_validation_is_of_panoramas(rendered, monkeypatch):
    monkeypatch.setattr(view_batches, "_VALIDATION_POSES", 3)
    view_batches.validation_views(Renderer(0), SIZE)
    assert len(rendered) == 3
    assert all(camera_of(seed, SIZE).wraps for seed in rendered)
    between = range(min(rendered), max(rendered))
    assert not [seed for seed in between if seed not in rendered and camera_of(seed, SIZE).wraps]


def test_the_comparison_is_learned_from_ordinary_cameras(rendered, tmp_path, monkeypatch):
    monkeypatch.setattr(view_batches, "_VALIDATION_POSES", 4)
    views = {"batches": 2, "held": 2, "together": 1, "lights": 3, "poses": 6, "processes": 0, "cameras": "ordinary"}
    pairs = {"places": 4, "images": 2, "epoch_batches": 2}
    given = {"run": tmp_path / "run", "epochs": 1, "pairs": pairs, "trainer": {"precision": "32-true"}}
    network = RECIPE.build(image_size=SIZE, circular=False, canonical=False, relative=True)
    run = pretrain(network, views=views, **given)
    assert run.settings["training"]["monitor"] == "refined"
    assert np.isfinite(run.curves()["train/relative"]).all()
    assert np.isfinite(run.curves()["val/refined"]).all()
    assert siamloc.models.load(run.weights).relative is not None
    around = RECIPE.build(image_size=SIZE, relative=True)
    for made, cameras, says in ((around, "ordinary", "set model.circular=false"), (network, "any", "and it is any")):
        with pytest.raises(ConfigError, match=says):
            pretrain(made, views={**views, "cameras": cameras}, **given)
    views = drawn(0, SIZE, 1, 1, 2, 0.3, "ordinary")
    assert np.isnan(view_batches.frames_of(views, "a").theta).all(), (
        "a network of panoramas learns no heading from them"
    )


def test_the_choices_are_those_of_rendering():
    hints = fields_of(ViewSettings)
    assert (hints["cameras"], hints["exposure"]) == (Cameras, Exposures)
    assert (hints["worlds"], hints["imaging"]) == (Worlds, Imagings)
