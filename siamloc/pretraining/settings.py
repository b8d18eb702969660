"""The settings of the random buildings, and the recipe. Loads no torch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from foundation.settings import Count, Positive, Settings, Thousand, Workers
from siamloc.errors import ConfigError
from siamloc.training.recipes import RECIPES, Recipe


@dataclass(frozen=True)
class ViewSettings(Settings):
    """Which random buildings are rendered for pretraining, and how many are in use at a time.

    Attributes:
        batches: number of batches after which a new building replaces the oldest building in memory.
        held: number of buildings in memory, fewer at the start.
        together: number of buildings that the places of one batch come from, fewer at the start.
        drives: number of drives through each building; between two drives doors, chairs and people move.
        lights: number of lightings of each drive.
        poses: maximum number of poses of each drive.
        spacing: metres between poses.
        cameras: cameras in the buildings: "any", "panoramas" for panorama cameras only, "built_in" for only the
            built-in panorama camera, or "ordinary" for ordinary and fisheye cameras only, also in the validation.
        exposure: "drawn" at random, or "metered" for the best exposure and white balance, without noise.
        worlds: "offices" for office floors, flats and halls with matt surfaces; "any" also for homes, workshops and
            high halls, most of them with natural textures and surfaces that reflect.
        imaging: "plain" if all cameras have the response of a data set's camera, or "drawn" if each has its own tone
            curve, colours, lens, dirt and visible parts of the robot.
        processes: number of rendering processes; 0 renders in the training process.
    """

    WHERE = "views"

    batches: Count = 10
    held: Thousand = 24
    together: Thousand = 4
    drives: Thousand = 2
    lights: Thousand = 4
    poses: Thousand = 80
    spacing: Positive = 0.3
    cameras: Literal["any", "panoramas", "built_in", "ordinary"] = "any"
    exposure: Literal["drawn", "metered"] = "drawn"
    worlds: Literal["offices", "any"] = "any"
    imaging: Literal["plain", "drawn"] = "drawn"
    processes: Workers = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.together > self.held:
            raise ConfigError(
                f"a batch cannot be of views.together={self.together} buildings where views.held={self.held} are in "
                "memory: set views.held larger"
            )

    def drawn(self, seed: int, image_size: Sequence[int]) -> tuple[Any, ...]:
        """Return the arguments of `siamloc.simulate.draw_views` for the building of a seed."""
        return (
            *(seed, tuple(image_size), self.drives, self.lights, self.poses, self.spacing),
            *(self.cameras, self.exposure, self.worlds, self.imaging),
        )


_MODERN = RECIPES["modern"]

RECIPE: Recipe = replace(
    _MODERN,
    model={
        **_MODERN.model,
        **{"branch": "panoresnet_wide", "head": "magnitudes", "normalize": "local_and_colours"},
        **{"canonical": True, "relative": True, "colours": True},
    },
    loss={"name": "soft_contrastive", "kernel": "exponential", "sigma": 0.4, "beyond": [1.0, 2.5]},
    augmentation={
        "name": "pretraining",
        "rotate": 1.0,
        "all_of": [
            {"policy": "any_light", "probability": 0.3},  # on every image, it would leave no use for colours
            {
                "one_of": [
                    {"effect": "blur", "size": 3, "strength": [0.3, 1.0]},
                    {"effect": "motion_blur", "length": [3, 11]},
                    {"effect": "jpeg", "quality": [20, 70]},
                ],
                "probability": 0.3,
            },
            {"effect": "vignette", "probability": 0.1},
            {"effect": "occlude", "share": [0.05, 0.2], "level": [0, 255], "probability": 0.1},
        ],
    },
    training={
        **_MODERN.training,
        "epochs": 14,
        "pairs": {"places": 64, "radius": 2.0, "near": 0.5, "reach": 4.0, "epoch_batches": 500},
        "average": 0.995,
    },
)
"""A wider network than that of the recipe `modern`, which also sees colours, on panoramas in their canonical direction;
trained longer, with larger batches, with images of a place that are farther apart, and with the effects of real cameras
in addition to light."""
