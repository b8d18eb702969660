"""The standard benchmark in Python: the drives of the simulated building freiburg_like and their roles.

The roles are those of the protocol `freiburg_sim`: map and queries from different drives, three lightings.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from scipy.spatial.distance import cdist

import siamloc
from siamloc.data import FrameTable, PanoramaLibrary
from siamloc.evaluation.absolute import evaluate_absolute, neighbours

USUAL = "freiburg_like"
LIGHTINGS = ("cloudy", "night", "sunny")
TRAIN = ("*seq2_cloudy3", "*seq2_night1", "*seq2_sunny3")
VALIDATION = ("*seq2_cloudy1", "*seq2_sunny1")
MAP = ("*seq2_cloudy3",)
QUERIES = ("*seq2_cloudy2", "*seq2_night2", "*seq2_sunny2")


class Building:
    """The rendered building with its panoramas at one size.

    Args:
        folder: output of `siamloc simulate camera=panorama`.
        image_size: rows and columns.
    """

    def __init__(self, folder: Path, image_size: tuple[int, int] = (128, 512)) -> None:
        self.frames = siamloc.data.read("cold", root=folder, name="freiburg_sim")
        self.images = PanoramaLibrary(self.frames, image_size=image_size)

    def drives(self, names: Sequence[str], every: int = 1) -> FrameTable:
        """Return every k-th frame of some drives."""
        return self.frames.select(sequence=list(names)).every(every)


def opened(data: Path) -> tuple[str, FrameTable]:
    """Return the name and the frames of a building: of the folder of a rendered one, or of a manifest."""
    if data.is_file():
        return data.resolve().parent.name, siamloc.data.read("manifest", manifest=data)
    return data.resolve().name, siamloc.data.read("cold", root=data)


def report_name(name: str, folder: Path) -> str:
    """Return the name of a benchmark's file, which includes the building unless it is the usual one."""
    building = folder.resolve().name
    return name if building == USUAL else f"{name}_{building}"


def begun(run: Path) -> bool:
    """Whether there is a run to resume."""
    return siamloc.training.Run(run).record.is_file()


def mean_and_range(values: Sequence[float], digits: int = 2) -> str:
    """Return the mean over seeds with the lowest and highest value, as text."""
    mean = f"{statistics.mean(values):.{digits}f}"
    return mean if len(values) == 1 else f"{mean} ({min(values):.{digits}f} to {max(values):.{digits}f})"


def by_lighting(absolute: dict[str, Any], measure: str = "error", figure: str = "mean") -> dict[str, float]:
    """Return one figure of absolute localization under each lighting."""
    return {name: absolute["lighting"][name][measure][figure] for name in LIGHTINGS}


def located(building: Building, descriptor: Any, every: Sequence[int] = (5, 1)) -> dict[str, Any]:
    """Describe map and queries once, and return errors in m and the share of right rooms under each lighting.

    Args:
        building: the building, at the image size that the descriptor expects.
        descriptor: a network, or anything else that `siamloc.maps.build` accepts.
        every: for each k, a map of every k-th frame of its drive.

    Returns:
        {"5": {"cloudy": {"mean": ..., "excess": ..., "floor": ..., "p95": ..., "room": ..., "nearest_room": ...}, ...},
        "1": ...}: mean error, its excess over the floor, the floor, 95 % error, the share of queries whose most
        alike map frame is in their room, and the share of those whose truly nearest map frame is.
    """
    # Map frames that are in no part need no description.
    common = math.gcd(*every)
    known = siamloc.maps.build(descriptor, building.images, building.drives(MAP, common), progress=False)
    asked = siamloc.maps.build(descriptor, building.images, building.drives(QUERIES), progress=False)
    found: dict[str, Any] = {}
    for step in every:
        part = known.take(range(0, len(known), step // common))
        nearest = siamloc.maps.match(part, asked.turning(), neighbours((1,), len(part)))
        result = evaluate_absolute(part, asked.frames, nearest, ks=(1,))
        right = part.frames.room[nearest.most_alike] == asked.frames.room
        truly_nearest = cdist(asked.frames.xy, part.frames.xy).argmin(axis=1)
        nearest_right = part.frames.room[truly_nearest] == asked.frames.room
        found[str(step)] = {
            light: {
                "mean": group["error"]["mean"],
                "excess": group["excess"]["mean"],
                "floor": group["floor"]["mean"],
                "p95": group["error"]["p95"],
                "room": float(right[asked.frames.lighting == light].mean()),
                "nearest_room": float(nearest_right[asked.frames.lighting == light].mean()),
            }
            for light, group in result.parts["absolute"]["lighting"].items()
        }
    return found
