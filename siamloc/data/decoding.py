"""From an image file to a panorama of the working size."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from siamloc.data.panorama import OmnidirectionalCamera, PanoramaView, unwrap
from siamloc.errors import ConfigError, DataError


class UnreadableImageError(Exception):
    """An image file that gives no picture; the text says why."""


@dataclass(frozen=True)
class Preprocessing:
    """How an image becomes a panorama.

    Attributes:
        view: size of the panorama, and the elevations that unwrapping gives it.
        camera: the camera whose omnidirectional images are unwrapped; None to resize only.
    """

    view: PanoramaView
    camera: OmnidirectionalCamera | None

    @classmethod
    def checked(
        cls, image_size: tuple[int, int], camera: OmnidirectionalCamera | None, view: PanoramaView | None
    ) -> Preprocessing:
        """Check the three against each other.

        Raises:
            ConfigError: an impossible size, a view of another size, or a camera whose parameters cannot be told.
        """
        size = tuple(image_size)
        if len(size) != 2 or any(int(side) != side for side in size):
            raise ConfigError(f"image_size is (rows, columns) in whole pixels, got {image_size}")
        height, width = (int(side) for side in size)
        if view is None:
            view = PanoramaView(height, width)
        elif (view.height, view.width) != (height, width):
            raise ConfigError(f"image_size is {height} x {width}, but the view has {view.height} x {view.width} pixels")
        if camera is not None and not dataclasses.is_dataclass(camera):
            raise ConfigError(f"a camera must be a dataclass, so that its parameters can be told; got {camera!r}")
        return cls(view, camera)

    def parameters(self) -> dict[str, Any]:
        """Return what decides the panorama's pixels, as plain values."""
        if self.camera is None:
            return {"height": self.view.height, "width": self.view.width, "camera": None}
        camera = {"kind": type(self.camera).__name__, **dataclasses.asdict(self.camera)}  # type: ignore[call-overload]
        return {**dataclasses.asdict(self.view), "camera": camera}

    def panorama(self, path: str | Path) -> NDArray[np.uint8]:
        """Read an image and return its panorama (3, H, W), uint8, RGB.

        Raises:
            UnreadableImageError: the file is missing, empty, cut short, or no image.
            ConfigError: the camera does not fit the image.
        """
        try:
            picture = self._picture(read_image(path))
        except DataError as error:
            raise UnreadableImageError(str(error)) from error
        except cv2.error as error:
            raise UnreadableImageError(f"the image cannot be brought to size ({error.err})") from error
        return np.ascontiguousarray(picture[..., ::-1].transpose(2, 0, 1))

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


def read_image(path: str | Path) -> NDArray[np.uint8]:
    """Read an image file as (rows, columns, 3), uint8, BGR; grey images get three equal channels.

    Raises:
        UnreadableImageError: the file is missing, empty, cut short, or no image.
    """
    try:
        data = Path(path).read_bytes()
    except FileNotFoundError as error:
        raise UnreadableImageError("the file does not exist") from error
    except OSError as error:
        raise UnreadableImageError(error.strerror or str(error)) from error
    if not data:
        raise UnreadableImageError("the file is empty")
    if _cut_short(data):
        raise UnreadableImageError("the file is cut short")
    try:
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR)
    except cv2.error as error:
        raise UnreadableImageError(f"the image cannot be decoded ({error.err})") from error
    if image is None:
        raise UnreadableImageError("the file is no image, or a damaged one")
    return np.asarray(image, dtype=np.uint8)


def _cut_short(data: bytes) -> bool:
    """Tell whether a JPEG or PNG ends before its end marker: some releases of OpenCV fill the rest with grey."""
    if data.startswith(b"\xff\xd8"):
        # The last scan has to be closed; an end marker further up may belong to an embedded thumbnail.
        return data.rfind(b"\xff\xd9") < data.rfind(b"\xff\xda") or b"\xff\xd9" not in data
    if data.startswith(b"\x89PNG"):
        return b"IEND" not in data
    return False
