"""Recipes: the command line has the same ones, and changes take the place of their settings."""

from __future__ import annotations

from dataclasses import replace

import pytest

import siamloc
from siamloc.cli.compose import composed
from siamloc.errors import ConfigError
from siamloc.models.batch_losses import make_loss
from siamloc.models.registry import LOSSES
from siamloc.training import RECIPES, Training, recipe


@pytest.mark.parametrize("name", RECIPES)
def test_the_experiment_of_the_command_line_is_the_recipe(name):
    config = composed("train", [f"experiment={name}", "data=manifest", "data.manifest=frames.csv"])
    wanted = recipe(name)
    assert config.training == Training.of(wanted.training)
    made = wanted.build(seed=0).settings
    options = config.model.arguments()
    again = siamloc.models.build(**options, image_size=config.data.image_size, seed=0).settings
    assert again == made
    assert config.augment.policy == wanted.augmentation
    assert config.trainer.precision == wanted.trainer["precision"]
    loss = config.make_loss()
    assert {key: loss.settings[key] for key in wanted.loss} == wanted.loss


def test_a_group_on_the_command_line_takes_the_place_of_the_recipes():
    words = ["experiment=modern", "data=manifest", "data.manifest=frames.csv"]
    config = composed("train", [*words, "augment=none", "optimizer=sgd"])
    assert config.augment.plain() == {"name": "none", "where": "auto"}
    assert config.training.optimizer == siamloc.training.Optimizer()
    config = composed("train", [*words, "pairs=room", "loss=contrastive"])
    assert config.make_loss() is None
    assert config.training.pairs.label == "room"
    with pytest.raises(ConfigError, match="does not go with these pairs"):
        composed("train", [*words, "pairs=room"]).make_loss()


def test_a_network_that_should_wrap_around_is_not_changed_in_silence():
    words = ["experiment=modern", "data=manifest", "data.manifest=frames.csv", "data.circular=false"]
    assert composed("train", words).model.circular is True  # which `fit` refuses
    assert composed("train", [*words, "model.circular=false"]).model.circular is False


@pytest.mark.parametrize("name", LOSSES)
def test_the_command_line_has_every_loss_over_batches(name):
    words = ["pairs=in_batch", f"loss={name}", "data=manifest", "data.manifest=frames.csv"]
    assert composed("train", words).make_loss().settings == make_loss(name).settings


def test_an_argument_that_networks_do_not_have_is_refused():
    own = replace(recipe("modern"), model={"branch": "panoresnet", "hed": "gem"})
    with pytest.raises(ConfigError, match=r"unknown configuration key 'model.hed': did you mean 'model.head'"):
        own.build()


def test_a_recipe_of_another_name_is_refused():
    with pytest.raises(ConfigError, match="unknown recipe 'modren': did you mean 'modern'"):
        recipe("modren")


def test_what_is_given_takes_the_place_of_the_recipes_settings(tmp_path):
    images = siamloc.data.example()
    monday = images.frames.select(sequence="monday")
    used = recipe("modern")
    network = used.build(images.image_size, seed=1, outputs=8)
    changes = {"epochs": 1, "pairs": {"places": 3, "radius": 0.6, "epoch_batches": 2}, "augmentation": None}
    run = used.fit(network, images, monday, run=tmp_path / "run", **changes)
    training = run.settings["training"]
    assert training["epochs"] == 1
    assert training["pairs"]["places"] == 3
    assert training["pairs"]["near"] == used.training["pairs"]["near"]
    assert training["optimizer"]["learning_rate"] == used.training["optimizer"]["learning_rate"]
    assert run.settings["loss"]["sigma"] == used.loss["sigma"]
    assert run.settings["augment"] == {"name": "none"}
    assert network.settings["outputs"] == 8
