"""Reader of 360Loc: equirectangular pictures of four scenes, taken by hand by day and by night (Huang et al. 2024)."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from foundation.files import expanded
from foundation.settings import shortened
from siamloc.data.frames import TILT, FrameTable, placed
from siamloc.data.image_files import image_files
from siamloc.data.text_rows import text_rows
from siamloc.data.trajectory import Array, Axes, Trajectory
from siamloc.errors import DataError, Policy, hint

_PARTS = {"mapping": "mapping", "query_360": "query"}
_LAYOUT = "<scene>/{mapping,query_360}/<sequence>/image/*.jpg with poses in <scene>/pose/*.txt"
_LIGHTINGS = {"daytime": "day", "nighttime": "night"}


def read_360loc(
    root: str | Path, *, scene: str | None = None, axes: Axes | None = None, on_error: Policy = "skip"
) -> FrameTable:
    """Read the scenes of 360Loc.

    Sequences are called `atrium_mapping_daytime_360_0` and `atrium_query_nighttime_360_1`, buildings after the scenes,
    lightings "day" and "night". The poses of the camera are taken to the ground plane: each scene has a frame of its
    own. Pictures have no times; they are in the order of their names.

    Args:
        root: the folder of the scenes, or of one scene.
        scene: only this scene: "atrium", "concourse", "hall" or "piatrium".
        axes: whose poses they are: "camera", with z ahead and y down, also if None, or "robot", with x ahead and z up.
        on_error: "skip" or "raise", for pictures without a pose.

    Raises:
        DataError: no scene in the folder, an unknown scene, or poses that cannot be used (with file and line).
    """
    folder = expanded(root)
    found = [path for path in (folder, *sorted(folder.glob("*"))) if (path / "mapping").is_dir()]
    if not found:
        raise DataError(f"{folder} holds no scene of 360Loc: expected {_LAYOUT}")
    chosen = [path for path in found if scene in (None, path.absolute().name)]
    if not chosen:
        raise DataError(f"{folder} has no scene {scene!r}; {hint(scene, [path.absolute().name for path in found])}")
    rows = [row for path in chosen for row in _scene(path, axes or "camera")]
    return placed(FrameTable.from_rows(rows), f"pictures of {folder} have no pose", on_error)


def _scene(folder: Path, axes: Axes) -> Iterator[dict[str, Any]]:
    listed = _listed(folder)
    name = folder.absolute().name
    for part, called in _PARTS.items():
        for sequence in sorted(path for path in folder.glob(f"{part}/*") if (path / "image").is_dir()):
            own = {file: pose for (drive, file), pose in listed.items() if drive == sequence.name}
            own = own or _of_matrices(sequence / "camera_pose.json")
            poses = {}
            if own:
                values = np.array(list(own.values()))
                trajectory = Trajectory.of(np.full(len(own), np.nan), values[:, :3], values[:, 3:], str(sequence))
                poses = dict(zip(own, trajectory.tilted(axes), strict=True))
            light = next((light for word, light in _LIGHTINGS.items() if word in sequence.name), "")
            labels = {"sequence": f"{name}_{called}_{sequence.name}", "building": name, "lighting": light}
            for image in image_files(sequence / "image"):
                pose = dict(zip(("x", "y", "theta", *TILT), poses.get(image.name, ()), strict=False))
                yield {"path": str(image), **labels, **pose}


def _listed(folder: Path) -> dict[tuple[str, str], Array]:
    """Return x, y, z and the quaternion (x, y, z, w) of each picture in the lists of a scene, by sequence and name."""
    found: dict[tuple[str, str], Array] = {}
    for path in sorted(folder.glob("pose/*360*.txt")):
        for number, words in text_rows(path):
            try:
                x, y, z, w, *rest = map(float, words[1:8])
                drive, _, image = words[0].split("/")[-3:]
                pose = np.array([x, y, z, *rest, w])
            except ValueError:
                pose = np.zeros(0)
            if len(pose) != 7:
                line = shortened(" ".join(words))
                raise DataError(f"{path}, line {number}: expected SEQUENCE/image/NAME x y z qw qx qy qz, got {line!r}")
            found[drive, image] = pose
    return found


def _of_matrices(path: Path) -> dict[str, Array]:
    """Return x, y, z and the quaternion (x, y, z, w) of each picture in a table of matrices (4, 4), by name."""
    from scipy.spatial.transform import Rotation

    if not path.is_file():
        return {}
    try:
        matrices = {name: np.array(matrix, dtype=np.float64) for name, matrix in json.loads(path.read_text()).items()}
        turns = {name: Rotation.from_matrix(one[:3, :3]).as_quat() for name, one in matrices.items()}
        return {name: np.concatenate([one[:3, 3], turns[name]]) for name, one in matrices.items()}
    except (ValueError, AttributeError, IndexError) as error:
        raise DataError(f"{path} is not a table of names and matrices of 4 x 4 numbers ({error})") from error
