"""`read_calibration`: cameras from calibration files of Kalibr (EuRoC), OpenCV (ROS), CamOdoCal and OCamCalib."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from foundation.calls import typed
from foundation.files import expanded
from foundation.settings import shortened
from siamloc.data.cameras import DoubleSphereCamera, DualFisheyeCamera, FisheyeCamera, OCamCamera, UnifiedCamera
from siamloc.data.central import CentralCamera
from siamloc.data.frames import parsed_yaml, read_file
from siamloc.data.panorama import Array
from siamloc.errors import ConfigError, DataError, hint

_ORDINARY = "pictures of an ordinary camera are not unwrapped, set data.circular=false"
_READ = (
    "Kalibr's omni, ds and pinhole with equidistant distortion, OpenCV's fisheye and omnidir, CamOdoCal's MEI and "
    "KANNALA_BRANDT, and OCamCalib are read"
)

_KALIBR = {
    ("omni", "radtan"): (5, 4),
    ("omni", "none"): (5, 0),
    ("ds", "none"): (6, 0),
    ("pinhole", "equidistant"): (4, 4),
}
"""How many intrinsics and distortion coefficients Kalibr writes, by the models of lens and distortion that are read."""


@typed
def read_calibration(path: str | Path, camera: str | Sequence[str] | None = None, **where: Any) -> CentralCamera:
    """Read the calibration of a camera.

    The form of the file is recognized: a camera chain of Kalibr (YAML), the `sensor.yaml` of a drive of EuRoC, what
    OpenCV's `FileStorage` wrote (YAML, XML or JSON) with a camera matrix, distortion coefficients, and `xi` for
    `cv2.omnidir`, ROS's camera info (YAML, or the `camera_info.json` of a recording, with its topics), CamOdoCal's YAML
    (model_type MEI or KANNALA_BRANDT, as VINS has it), or `calib_results.txt` of OCamCalib. Of OpenCV's files, those of
    the fisheye model must say so by the key `fisheye_model` with the value 1, or by the `distortion_model` fisheye or
    equidistant.

    Args:
        path: the file.
        camera: name of the camera in a chain of Kalibr, such as "cam1", the topic of its images, or that of its camera
            info; None if the file has one camera. Two names make one `DualFisheyeCamera`, turned towards each other as
            in the chain.
        **where: where the camera looks: `azimuth`, `elevation`, `roll`, `mirrored` and `fov`, see `CentralCamera`.

    Returns:
        A `FisheyeCamera`, `UnifiedCamera`, `DoubleSphereCamera`, `OCamCamera` or `DualFisheyeCamera`, for pictures of
        the size that it was calibrated on.

    Raises:
        ConfigError: a camera that the file does not have, none named of several, or an impossible parameter.
        DataError: a file that cannot be read, or of a model that no omnidirectional camera has.
    """
    file = expanded(path)
    text = read_file(file, "the calibration", most=1_000_000)
    if re.match(r"\s*#\s*polynomial", text):
        kind, values = _ocam(file, text)
        return kind.of({**values, **where})
    content = _stored(file, text) if re.match(r"\s*(<\?xml|%YAML)", text) else _yaml(file, text)
    groups = {name: one for name, one in content.items() if isinstance(one, Mapping)}
    chain = {name: one for name, one in groups.items() if "camera_model" in one or "k" in one}
    if not chain:
        if camera is not None:
            raise ConfigError(f"{file} is of one camera: leave out camera={camera}")
        of_euroc = {"camera_model", "intrinsics", "resolution"} <= content.keys()
        form = _camodocal if "model_type" in content else _kalibr if of_euroc else _opencv
        kind, values = form(file, content)
        return kind.of({**values, **where})
    if not camera and len(chain) > 1:
        raise _several(file, chain)
    names = [_name_in(file, chain, one) for one in ([camera] if isinstance(camera, str) else camera or chain)]
    if len(names) > 2:
        raise ConfigError(f"one camera or two of {file} make a camera, got {len(names)}: choose of {', '.join(chain)}")
    (first, one), *rest = [(_opencv if "k" in chain[name] else _kalibr)(file, chain[name], name) for name in names]
    if not rest:
        return first.of({**one, **where})
    ((second, other),) = rest
    turn = _between(file, chain, *names) @ np.diag([-1.0, 1.0, -1.0])  # its angles count from the camera's back
    return DualFisheyeCamera.of({"front": first.of(one), "back": second.of({**other, **angles_of(turn)}), **where})


def angles_of(axes: Array) -> dict[str, float]:
    """Return `azimuth`, `elevation` and `roll` in degrees of a camera from its axes.

    Args:
        axes: right, down and ahead of the camera (3, 3), as rows, in the frame of a camera that looks ahead.
    """
    right, _, ahead = np.asarray(axes) @ np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]])  # to the robot's frame
    azimuth = float(np.arctan2(ahead[1], ahead[0]))
    level = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    below = np.cross(ahead, level)
    roll = np.arctan2(right @ below, right @ level)
    elevation = np.arcsin(np.clip(ahead[2], -1, 1))
    return dict(zip(("azimuth", "elevation", "roll"), np.degrees([azimuth, elevation, roll]).tolist(), strict=True))


Made = tuple[type[CentralCamera], dict[str, Any]]


def _name_in(file: Path, chain: Mapping[str, Any], camera: str) -> str:
    """Return the name of a camera in a file by this name, by the topic of its images, or by its only neighbour."""
    if camera in chain:
        return camera
    topic = camera.removesuffix("/compressed")
    found = [name for name in chain if str(chain[name].get("rostopic")).removesuffix("/compressed") == topic]
    above = topic.rpartition("/")[:2]
    found = found or [name for name in chain if "/" in name and name.rpartition("/")[:2] == above]
    if len(found) > 1:
        raise _several(file, found, f", and {camera} may be of any")
    if not found:
        raise ConfigError(f"{file} has no camera {camera!r}: {hint(camera, chain)}")
    return found[0]


def _several(file: Path, names: Iterable[str], doubt: str = "") -> ConfigError:
    return ConfigError(f"{file} is of several cameras{doubt}: give camera=NAME, one of {', '.join(names)}")


def _kalibr(file: Path, values: Mapping[str, Any], name: str = "the camera") -> Made:
    """Return the model and the parameters of a camera of Kalibr, or of EuRoC, whose names are nearly the same."""
    model, distortion = str(values["camera_model"]), str(values.get("distortion_model", "none"))
    numbers = _numbers(file, values.get("intrinsics"), f"intrinsics of {name}")
    bent = _first(values, "distortion_coeffs", "distortion_coefficients") or []
    bent = _numbers(file, bent, f"distortion coefficients of {name}")
    columns, rows = _numbers(file, values.get("resolution"), f"resolution of {name}", 2)
    size: dict[str, Any] = {"image_size": (int(rows), int(columns))}
    if (model, distortion) not in _KALIBR:
        ordinary = f"; {_ORDINARY}" if model == "pinhole" else ""
        raise DataError(f"{name} of {file} is of the model {model} with {distortion} distortion: {_READ}{ordinary}")
    if (len(numbers), len(bent)) != (counts := _KALIBR[model, distortion]):
        raise DataError(
            f"{name} of {file} has {len(numbers)} intrinsics and {len(bent)} distortion coefficients, and a camera of "
            f"the model {model} has {counts[0]} and {counts[1]}"
        )
    size |= dict(zip(("fx", "fy", "cx", "cy"), numbers[-4:], strict=True))
    if model == "pinhole":
        return FisheyeCamera, {**size, "k": bent}
    if model == "ds":
        return DoubleSphereCamera, {**size, "xi": numbers[0], "alpha": numbers[1]}
    return UnifiedCamera, {**size, "xi": numbers[0], "distortion": bent or (0.0,) * 4}


def _between(file: Path, chain: Mapping[str, Any], first: str, second: str) -> Array:
    """Return the axes of the second camera of a chain (3, 3), as rows, in the frame of the first one."""
    names = list(chain)
    start, end = sorted((names.index(first), names.index(second)))
    turn = np.eye(3)
    for name in names[start + 1 : end + 1]:
        rows = chain[name].get("T_cn_cnm1")
        if np.shape(rows) != (4, 4):
            raise DataError(f"{name} of {file} has no T_cn_cnm1, 4 x 4, so that nobody knows how it is turned")
        turn = np.asarray(rows, dtype=np.float64)[:3, :3] @ turn
    return turn if names.index(first) == start else turn.T


def _opencv(file: Path, values: Mapping[str, Any], name: str = "the camera") -> Made:
    """Return the model and the parameters of a camera of OpenCV or ROS."""
    matrix = _first(values, "camera_matrix", "K", "k", "cameraMatrix", "intrinsics")
    if matrix is None and (own := values.get("cam0_calib")):
        raise DataError(f"{file} is no calibration, but names that of its camera: give {file.parent / str(own)}")
    if matrix is None:
        raise DataError(
            f"{file} holds no camera matrix among {shortened(', '.join(values))}: {_READ}; the parameters in other "
            "files can be given by hand, as unwrap=double_sphere or unwrap=fisheye unwrap.fx=... unwrap.k=[...]"
        )
    matrix = _numbers(file, matrix, "the camera matrix", 9)
    bent = _first(values, "distortion_coefficients", "D", "d", "distCoeffs", "dist_coeffs", "distortion_coeffs")
    bent = (0.0,) * 4 if bent is None else _numbers(file, bent, "the distortion")
    fx, skew, cx, _, fy, cy, *_ = matrix
    found: dict[str, Any] = {"fx": fx, "skew": skew, "cx": cx, "fy": fy, "cy": cy}
    rows, columns = _first(values, "image_height", "height"), _first(values, "image_width", "width")
    if rows is not None and columns is not None:
        found["image_size"] = (int(rows), int(columns))
    xi = values.get("xi")
    model = str(_first(values, "distortion_model", "camera_model", "model") or "")
    fisheye = model.lower() in ("fisheye", "equidistant") or bool(values.get("fisheye_model"))
    if xi is None and not fisheye and not model and len(bent) == 4:
        raise DataError(
            f"{name} of {file} has 4 distortion coefficients, and the file does not say of which model: add the key "
            "fisheye_model with the value 1 if it was calibrated by cv2.fisheye, or its xi for cv2.omnidir; "
            f"{_ORDINARY}"
        )
    if (xi is None and not fisheye) or len(bent) != 4:
        what = f"the distortion model {model}" if model else "no model"
        raise DataError(f"{name} of {file} has {what} and {len(bent)} distortion coefficients: {_READ}; {_ORDINARY}")
    if xi is not None:
        return UnifiedCamera, {**found, "xi": _numbers(file, xi, "xi", 1)[0], "distortion": bent}
    return FisheyeCamera, {**found, "k": bent}


def _camodocal(file: Path, values: Mapping[str, Any]) -> Made:
    """Return the model and the parameters in a file of CamOdoCal."""
    model, own = str(values["model_type"]), dict[str, Any]()
    for part in ("mirror", "distortion", "projection"):
        if isinstance(given := values.get(f"{part}_parameters"), Mapping):
            own |= given
    lens = {"MEI": ("gamma1", "gamma2", "xi"), "KANNALA_BRANDT": ("mu", "mv")}.get(model.upper())
    if lens is None:
        ordinary = f"; {_ORDINARY}" if model.upper() == "PINHOLE" else ""
        raise DataError(f"{file} is of the model {model}: {_READ}{ordinary}")
    bent = ("k1", "k2", "p1", "p2") if "xi" in lens else ("k2", "k3", "k4", "k5")
    names = (*lens[:2], "u0", "v0", *bent, *lens[2:])
    fx, fy, cx, cy, *rest = _numbers(file, [own.get(name) for name in names], f"{', '.join(names)} of {model}")
    rows, columns = _numbers(file, [values.get(f"image_{side}") for side in ("height", "width")], "the image size")
    size: dict[str, Any] = {"image_size": (int(rows), int(columns)), "fx": fx, "fy": fy, "cx": cx, "cy": cy}
    if "xi" in lens:
        return UnifiedCamera, {**size, "distortion": rest[:4], "xi": rest[4]}
    return FisheyeCamera, {**size, "k": rest}


def _ocam(file: Path, text: str) -> Made:
    """Return the model and the parameters in a file of OCamCalib: polynomial, inverse, centre, affine and size."""
    lines = [line.split() for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    try:
        polynomial, _, centre, affine, size = ([float(word) for word in line] for line in lines[:5])
        (row, column), (c, d, e), (rows, columns) = centre, affine, size
    except ValueError as error:
        raise DataError(
            f"{file} is not whole: OCamCalib writes five lines of numbers, polynomial, inverse polynomial, centre, "
            "affine parameters and image size"
        ) from error
    if len(polynomial) != polynomial[0] + 1 or len(polynomial) < 3:
        raise DataError(f"{file} announces {polynomial[0]:g} coefficients and lists {len(polynomial) - 1}")
    size_of = {"image_size": (int(rows), int(columns))}
    return OCamCamera, {"polynomial": polynomial[1:], "cx": column, "cy": row, "affine": (c, d, e), **size_of}


def _yaml(file: Path, text: str) -> dict[str, Any]:
    found = parsed_yaml(text, file)
    if not isinstance(found, dict):
        raise DataError(f"{file} is not a calibration file: {_READ}")
    return {str(name): one.get("data", one) if isinstance(one, dict) else one for name, one in found.items()}


def _stored(file: Path, text: str) -> dict[str, Any]:
    """Return the values that OpenCV's FileStorage wrote, matrices as lists."""
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        found: dict[str, Any] = {}
        for name in storage.root().keys():  # noqa: SIM118 (a node is not a mapping)
            node = storage.getNode(name)
            if node.isMap() and node.getNode("data").empty():
                found[name] = {key: node.getNode(key).real() for key in node.keys()}  # noqa: SIM118
            elif node.isMap():
                found[name] = node.mat().ravel().tolist()
            elif node.isSeq():
                found[name] = [node.at(i).real() for i in range(node.size())]
            else:
                found[name] = node.string() if node.isString() else node.real()
    except (cv2.error, SystemError, AttributeError) as error:
        raise DataError(f"{file} is not whole, OpenCV cannot read it: write it again with cv2.FileStorage") from error
    return found


def _first(values: Mapping[str, Any], *names: str) -> Any:
    return next((values[name] for name in names if values.get(name) is not None), None)


def _numbers(file: Path, values: Any, what: str, count: int | None = None) -> tuple[float, ...]:
    """Return a list of numbers, flattened.

    Raises:
        DataError: it is no such list, or of another length.
    """
    try:
        found = tuple(np.asarray(values, dtype=np.float64).ravel().tolist())
    except (TypeError, ValueError) as error:
        raise DataError(f"{file}: {what} must be numbers, got {shortened(repr(values))}") from error
    if not np.isfinite(found).all() or (count is not None and len(found) != count):
        expected = "finite numbers" if count is None else f"{count} finite numbers"
        raise DataError(f"{file}: {what} must be {expected}, got {shortened(repr(values))}")
    return found
