"""Stages of a network: what belongs to which, and what freezing does."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from siamloc.errors import ConfigError
from siamloc.models import BRANCHES, HEADS, Network, build, stages

SIZE = (64, 128)
COUNTS = {"simple": 2, "alexnet": 4, "densenet121": 6, "vgg": 6, "panoresnet": 5}


@pytest.mark.parametrize("circular", [False, True])
@pytest.mark.parametrize("branch", BRANCHES)
def test_every_branch_has_a_stage_for_each_resolution_and_the_head(branch, circular):
    with torch.device("meta"):  # without values, as large ones take long to draw
        network = Network(branch, "flat", SIZE, circular=circular)
    found = stages(network)
    assert len(found) == next(count for start, count in COUNTS.items() if branch.startswith(start))
    assert [name for names in found for name in names] == [name for name, _ in network.named_parameters()]
    assert found[-1] == ["head.layer.weight", "head.layer.bias"]
    # What the layers of a stage give has one number of rows, and each stage gives fewer than the one before.
    stage_of = {name: number for number, names in enumerate(found) for name in names}
    rows = [set() for _ in found[:-1]]
    features = torch.empty(1, 3, *SIZE, device="meta")
    for name, layer in network.eval().branch.features.named_children():
        features = layer(features)
        for weight, _ in layer.named_parameters():
            rows[stage_of[f"branch.features.{name}.{weight}"]].add(features.shape[2])
    assert all(len(seen) == 1 for seen in rows)
    assert sorted(set.union(*rows), reverse=True) == [max(seen) for seen in rows]


@pytest.mark.parametrize("head", [head for head in HEADS if head != "magnitudes"])
def test_a_head_with_weights_is_the_last_stage(head):
    network = build("simple1", head, SIZE)
    assert stages(network)[-1] == [f"head.{name}" for name, _ in network.head.named_parameters()]


class Own(nn.Module):
    """A custom network that names its stages."""

    def __init__(self, *said):
        super().__init__()
        self.stem, self.body, self.head = nn.Linear(3, 3), nn.Linear(3, 3), nn.Linear(3, 2)
        self.said = said

    @property
    def stages(self):
        return [[getattr(self, name) for name in names.split()] for names in self.said]

    def forward(self, panorama):
        return self.head(self.body(self.stem(panorama.mean(dim=(2, 3)))))


def test_a_network_of_ones_own_says_its_stages():
    found = stages(Own("stem body", "head"))
    assert found == [["stem.weight", "stem.bias", "body.weight", "body.bias"], ["head.weight", "head.bias"]]


class Modules(nn.Module):
    def __init__(self, parts):
        super().__init__()
        self.layer = nn.Linear(3, 2)
        self.stages = parts


@pytest.mark.parametrize(
    ("network", "says"),
    [
        (nn.Linear(3, 2), r"Linear does not say its stages: give it a property `stages`"),
        (Modules(None), "Modules does not say its stages"),
        (Modules("layer"), "Modules does not say its stages"),
        (Modules([[], []]), "Modules does not say its stages"),
        (Own("stem", "head"), "must hold each of its weights once"),
        (Own("stem body", "body head"), "must hold each of its weights once"),
        (Modules([]), "must hold each of its weights once"),
    ],
)
def test_stages_that_are_not_said_or_not_whole_are_refused_in_one_sentence(network, says):
    with pytest.raises(ConfigError, match=says) as info:
        stages(network)
    assert "\n" not in str(info.value)
