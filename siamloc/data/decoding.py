"""Decode an image file into a panorama of the working size."""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from foundation.files import plain
from foundation.settings import Size, checked
from siamloc.data.panorama import CAMERAS, OmnidirectionalCamera, PanoramaView, unwrap
from siamloc.errors import ConfigError, DataError, hint


class UnreadableImageError(Exception):
    """An image file that cannot be decoded; the text says why."""


@dataclass(frozen=True)
class Preprocessing:
    """How an image becomes a panorama.

    Attributes:
        view: size of the panorama, and its elevations after unwrapping.
        camera: the camera whose omnidirectional images are unwrapped; None to resize only.

    Example:
        >>> ring = Preprocessing.checked((64, 256), {"kind": "polar", "inner": 30})
        >>> ring.camera
        PolarRing(centre=None, inner=30, outer=None, forward=0.0, mirrored=True, inside_up=False)
        >>> Preprocessing.of(ring.parameters()) == ring
        True
    """

    view: PanoramaView
    camera: OmnidirectionalCamera | None

    @classmethod
    def checked(
        cls, image_size: Sequence[int], unwrap: OmnidirectionalCamera | Mapping[str, Any] | None = None
    ) -> Preprocessing:
        """Make the preprocessing from settings.

        Args:
            image_size: rows and columns (H, W) of a panorama.
            unwrap: the camera; or plain values, `kind` none, polar or hyperbolic and the parameters of `PolarRing`, or
                of `HyperbolicMirror` and the view's `top` and `bottom`. None or "none" to resize what is a panorama.

        Raises:
            ConfigError: an impossible size, an unknown kind or parameter, or a camera whose parameters cannot be read.
        """
        size = checked(image_size, Size, "image_size")
        if isinstance(unwrap, Mapping):
            options = dict(unwrap)
            kind = checked(options.pop("kind", "none"), str, "unwrap.kind")
            if kind not in CAMERAS:
                raise ConfigError(f"unknown unwrap.kind {kind!r}: {hint(kind, CAMERAS)}")
            view = PanoramaView(*size, **{key: options.pop(key) for key in ("top", "bottom") if key in options})
            camera = CAMERAS[kind]
            if camera is None and options:
                raise ConfigError(f"unwrap.kind={kind} has no parameters, got {next(iter(options))!r}: leave it out")
            return cls(view, None if camera is None else camera.of(options))
        if unwrap is not None and not (dataclasses.is_dataclass(unwrap) and hasattr(unwrap, "sampling")):
            raise ConfigError(f"a camera must be a dataclass with a method `sampling`, got {unwrap!r}")
        return cls(PanoramaView(*size), cast("OmnidirectionalCamera | None", unwrap))

    @classmethod
    def of(cls, parameters: Mapping[str, Any]) -> Preprocessing:
        """Make a preprocessing again from what `parameters` returned.

        Raises:
            ConfigError: a custom camera, which cannot be rebuilt from plain values, or missing values.
        """
        classes = {camera.__name__ if camera else None: camera for camera in CAMERAS.values()}
        try:
            view = PanoramaView(**{key: value for key, value in parameters.items() if key != "camera"})
            options = dict(parameters["camera"] or {"kind": None})
            camera = classes[options.pop("kind")]
        except (KeyError, TypeError, ValueError) as error:
            raise ConfigError(
                f"these values do not say how images become panoramas, or name a camera of your own: {parameters}"
            ) from error
        return cls(view, camera.of(options) if camera else None)

    def parameters(self) -> dict[str, Any]:
        """Return everything that determines the panorama's pixels, as plain values that `of` reads back."""
        if self.camera is None:
            return {"height": self.view.height, "width": self.view.width, "camera": None}
        camera = {"kind": type(self.camera).__name__, **dataclasses.asdict(self.camera)}  # type: ignore[call-overload]
        return {**dataclasses.asdict(self.view), "camera": camera}

    def unwrap_settings(self) -> dict[str, Any]:
        """Return the camera and the elevations as plain values, which `checked` reads."""
        if self.camera is None:
            return {"kind": "none"}
        own = type(self.camera)
        kind = next((kind for kind, camera in CAMERAS.items() if camera is own), own.__name__)
        options = dataclasses.asdict(self.camera)  # type: ignore[call-overload]
        return plain({"kind": kind, **options, "top": self.view.top, "bottom": self.view.bottom})

    def panorama(self, path: str | Path) -> NDArray[np.uint8]:
        """Read an image and return its panorama (3, H, W), uint8, RGB.

        Raises:
            UnreadableImageError: the file is missing, empty, cut short, or not an image.
            ConfigError: the camera does not fit the image.
        """
        try:
            picture = self._picture(read_image(path))
        except DataError as error:
            raise UnreadableImageError(str(error)) from error
        except cv2.error as error:
            raise UnreadableImageError(f"the image cannot be brought to size ({error.err})") from error
        return np.ascontiguousarray(picture[..., ::-1].transpose(2, 0, 1))

    def panoramas(self, paths: Sequence[str | Path], count: int) -> NDArray[np.uint8]:
        """Read up to `count` images, spread evenly over a list, and return their panoramas (B, 3, H, W), uint8, RGB.

        Raises:
            DataError: an image that cannot be read.
        """
        spread = np.linspace(0, len(paths) - 1, min(count, len(paths))).round().astype(int)
        try:
            return np.stack([self.panorama(path := paths[number]) for number in spread.tolist()])
        except UnreadableImageError as error:
            raise DataError(f"{path} cannot be shown: {error}") from error

    def prepare(self, pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the panorama (3, H, W) of an image in memory (rows, columns, 3); both uint8, RGB.

        Raises:
            ConfigError, DataError: the camera does not fit the image.
        """
        return np.ascontiguousarray(self._picture(np.ascontiguousarray(pixels)).transpose(2, 0, 1))

    def _picture(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        if self.camera is None:
            size = (self.view.width, self.view.height)
            return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        return unwrap(image, self.camera, self.view)


_LARGEST = 16_384  # pixels per side of an image


def read_image(path: str | Path) -> NDArray[np.uint8]:
    """Read an image file as (rows, columns, 3), uint8, BGR; grey images get three equal channels.

    Raises:
        UnreadableImageError: the file is missing, empty, cut short, or not an image.
    """
    try:
        data = Path(path).read_bytes()
    except FileNotFoundError as error:
        raise UnreadableImageError("the file does not exist") from error
    except OSError as error:
        raise UnreadableImageError(error.strerror or str(error)) from error
    if not data:
        raise UnreadableImageError("the file is empty")
    if cut_short(data):
        raise UnreadableImageError("the file is cut short")
    if (size := _declared_size(data)) is not None and max(size) > _LARGEST:
        raise UnreadableImageError(f"it has {size[0]:,} x {size[1]:,} pixels, and {_LARGEST:,} a side are the most")
    try:
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR)
    except cv2.error as error:
        raise UnreadableImageError(f"the image cannot be decoded ({error.err})") from error
    if image is None:
        raise UnreadableImageError("the file is not an image, or it is damaged")
    return np.asarray(image, dtype=np.uint8)


def _declared_size(data: bytes) -> tuple[int, int] | None:
    """Return the rows and columns in the header of a PNG or JPEG; None for other formats, or without a header."""
    if data.startswith(b"\x89PNG") and len(data) > 24:
        columns, rows = struct.unpack(">II", data[16:24])
        return rows, columns
    at = 2
    while data.startswith(b"\xff\xd8") and at + 9 <= len(data) and data[at] == 0xFF:
        marker, length = data[at + 1], int.from_bytes(data[at + 2 : at + 4], "big")
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            rows, columns = struct.unpack(">HH", data[at + 5 : at + 9])
            return rows, columns
        at += 2 + length
    return None


def cut_short(data: bytes) -> bool:
    """Whether a JPEG or PNG ends before its end marker: some releases of OpenCV fill the rest with grey."""
    if data.startswith(b"\xff\xd8"):
        # The last scan has to be closed; an earlier end marker may belong to an embedded thumbnail.
        return data.rfind(b"\xff\xd9") < data.rfind(b"\xff\xda") or b"\xff\xd9" not in data
    if data.startswith(b"\x89PNG"):
        return b"IEND" not in data
    return False
