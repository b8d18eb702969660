"""`Preprocessing`: how an image becomes a panorama of the working size."""

from __future__ import annotations

import dataclasses
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from foundation.files import plain
from foundation.settings import Size, checked, leaves
from foundation.words import as_words
from siamloc.data.cameras import CAMERAS
from siamloc.data.image_files import UnreadableImageError, read_image, spread
from siamloc.data.levelling import SIZE, tilt_of
from siamloc.data.panorama import OmnidirectionalCamera, PanoramaView, PolarRing, in_pixels, seen, unwrap
from siamloc.data.photo_sphere import stated
from siamloc.data.two_lenses import wrong_lenses
from siamloc.errors import ConfigError, DataError, Policy, hint, leave_out, say_once

_SIZED = 5  # pictures whose sizes are looked at
_ALIKE = 0.01  # by which the shapes of pictures may differ that are scaled


@dataclass(frozen=True)
class Preprocessing:
    """How an image becomes a panorama.

    Attributes:
        view: size of the panorama, and its elevations after unwrapping.
        camera: the camera whose omnidirectional images are unwrapped; None to resize only.
        size: rows and columns of the pictures in whose pixels the camera's parameters count; others of the same shape
            are scaled, and those of another shape refused. Without a camera, the latter are a warning. None for any.
        bits: how many of 16 bits deep images use; found out from the images of the folder if None.
        level: whether pictures without a known tilt are levelled by the edges that stand upright in them.

    Example:
        >>> ring = Preprocessing.checked((64, 256), {"kind": "polar", "inner": 30})
        >>> ring.camera
        PolarRing(centre=None, inner=30, outer=None, forward=0.0, mirrored=True, inside_up=False)
        >>> Preprocessing.of(ring.parameters()) == ring
        True
    """

    view: PanoramaView
    camera: OmnidirectionalCamera | None
    size: tuple[int, int] | None = dataclasses.field(default=None, compare=False)
    bits: int | None = dataclasses.field(default=None, compare=False)
    level: bool = False

    def __post_init__(self) -> None:
        if self.level and self.elevations is None:
            raise ConfigError(
                "unwrap.level=true needs a camera model that knows the elevation of each pixel, which a ring of two "
                "radii and what is only resized do not: choose another unwrap, or leave it out"
            )

    @classmethod
    def checked(
        cls,
        image_size: Sequence[int],
        unwrap: OmnidirectionalCamera | Mapping[str, Any] | None = None,
        elevations: tuple[float, float] | None = None,
        level: bool = False,
    ) -> Preprocessing:
        """Make the preprocessing from settings.

        Args:
            image_size: rows and columns (H, W) of a panorama.
            unwrap: the camera; or plain values: `kind`, a name in `CAMERAS`, "calibrated", or "module:Class" for a
                camera class of your own in a module that is imported; the parameters of the camera, or of
                `read_calibration` (`file`, `camera` and where it looks); the view's `top` and `bottom`, and `level`.
                None or "none" to resize what is a panorama.
            elevations: elevations of the panorama's upper and lower edge in degrees, unless `unwrap` has `top` and
                `bottom`; 30 and -45 if None.
            level: see `Preprocessing`; the one in `unwrap`, if there is one, goes before.

        Raises:
            ConfigError: an impossible size, an unknown kind or parameter, or a camera whose parameters cannot be read.
            DataError: a calibration file that cannot be read.
        """
        size = checked(image_size, Size, "image_size")
        edges: dict[str, Any] = {} if elevations is None else dict(zip(("top", "bottom"), elevations, strict=True))
        if isinstance(unwrap, Mapping):
            options = dict(unwrap)
            kind = checked(options.pop("kind", "none"), str, "unwrap.kind")
            given = {key: options.pop(key, None) for key in ("top", "bottom")}
            own = options.pop("level", None)
            level = level if own is None else checked(own, bool, "unwrap.level")
            edges |= {key: value for key, value in given.items() if value is not None}
            view = PanoramaView(*size, **edges)
            if kind == "none" and options:
                raise ConfigError(f"unwrap.kind={kind} has no parameters, got {next(iter(options))!r}: leave it out")
            return cls(view, _calibrated(options) if kind == "calibrated" else _camera(kind, options), level=level)
        if isinstance(unwrap, type):
            raise ConfigError(
                f"a camera must be an object, got the class {unwrap.__name__}: call it with its parameters"
            )
        if unwrap is not None and not (dataclasses.is_dataclass(unwrap) and hasattr(unwrap, "sampling")):
            raise ConfigError(f"a camera must be a dataclass with a method `sampling`, got {unwrap!r}")
        return cls(PanoramaView(*size, **edges), cast("OmnidirectionalCamera | None", unwrap), level=level)

    @classmethod
    def of(cls, parameters: Mapping[str, Any]) -> Preprocessing:
        """Make a preprocessing again from what `parameters` returned.

        Raises:
            ConfigError: missing values, or a camera of your own whose module is not imported.
        """
        try:
            view = PanoramaView(**{key: value for key, value in parameters.items() if key != "camera"})
            options = dict(parameters["camera"] or {"kind": "none"})
            level = options.pop("level", False)
            return cls(view, _camera(options.pop("kind"), options), level=level)
        except (KeyError, TypeError, ValueError) as error:
            raise ConfigError(f"these values do not say how images become panoramas: {parameters} ({error})") from error

    @property
    def elevations(self) -> tuple[float, float] | None:
        """Elevations in degrees of the panorama's upper and lower edge; None if those of its rows are not known."""
        return None if isinstance(self.camera, PolarRing | None) else (self.view.top, self.view.bottom)

    def parameters(self) -> dict[str, Any]:
        """Return everything that determines the panorama's pixels, as plain values that `of` reads back."""
        if self.camera is None:
            return {"height": self.view.height, "width": self.view.width, "camera": None}
        levels = {"level": True} if self.level else {}
        camera = {"kind": _name(type(self.camera)), **_plain(self.camera), **levels}
        return {**dataclasses.asdict(self.view), "camera": camera}

    def unwrap_settings(self) -> dict[str, Any]:
        """Return the camera and the elevations as plain values, which `checked` reads."""
        if self.camera is None:
            return {"kind": "none"}
        own = type(self.camera)
        kind = next((kind for kind, camera in CAMERAS.items() if camera is own), _name(own))
        edges = {"top": self.view.top, "bottom": self.view.bottom}
        return {"kind": kind, **_plain(self.camera), **edges, "level": self.level}

    def words(self) -> str:
        """Return the camera as words of the command line without defaults, such as "unwrap=polar unwrap.inner=60"."""
        given = self.unwrap_settings()
        plain = CAMERAS.get(kind := given.pop("kind"))
        default = Preprocessing(PanoramaView(), self.camera if plain is None else plain()).unwrap_settings()
        usual = dict(leaves(default, "unwrap."))
        changed = {key: one for key, one in leaves(given, "unwrap.") if one is not None and one != usual.get(key)}
        if plain is not None or self.camera is None:
            return as_words({"unwrap": kind, **changed})
        own = {f"+unwrap.{key}": one for key, one in _plain(self.camera).items() if one is not None}
        return as_words({"unwrap": "own", "unwrap.kind": kind, **changed, **own})

    def sized_by(self, paths: Sequence[str | Path]) -> Preprocessing:
        """Return the preprocessing with the size of most of a few pictures of a list, if sizes matter.

        They do to cameras of siamloc whose parameters count in pixels, and, for their shape, without a camera.
        """
        camera = self.camera
        if self.size is not None or (camera is not None and ":" in _name(type(camera))):  # one's own is told each size
            return self
        with suppress(ConfigError):  # a calibrated camera refuses pictures that mostly have another size
            if (size := self.usual_size(paths)) and (camera is None or in_pixels(camera, self.view, size)):
                return dataclasses.replace(self, size=size)
        return self

    def usual_size(self, paths: Sequence[str | Path]) -> tuple[int, int] | None:
        """Return the rows and columns of most of a few pictures of a list; None if none can be read."""
        sizes = Counter(self._sizes(spread(paths, _SIZED))) or Counter(islice(self._sizes(paths), 1))
        return sizes.most_common(1)[0][0] if sizes else None

    def _sizes(self, paths: Iterable[str | Path]) -> Iterator[tuple[int, int]]:
        """Yield the rows and columns of the pictures that can be read."""
        light = dataclasses.replace(self, bits=16)  # which need not be counted
        for path in paths:
            with suppress(UnreadableImageError, DataError):
                rows, columns = light._read(path).shape[:2]
                yield rows, columns

    def panorama(
        self, path: str | Path, tilt: NDArray[np.float64] | Sequence[float] | None = None
    ) -> NDArray[np.uint8]:
        """Read an image and return its panorama (3, H, W), uint8, RGB.

        Args:
            path: the file; of two pictures of a `DualFisheyeCamera`, the front one.
            tilt: roll and pitch of the robot in rad, which are taken out; see `PanoramaView.tilted`. If None or NaN,
                the tilt that an equirectangular picture says it had is taken out.

        Raises:
            UnreadableImageError: the file is missing, empty, cut short, or not an image.
            ConfigError: the camera does not fit the image.
        """
        known = tilt is not None and bool(np.isfinite(tilt).all())
        try:
            image, own = self._opened(path, levelled=known)
            picture = own._picture(image, tilt)
        except DataError as error:
            raise UnreadableImageError(str(error)) from error
        except cv2.error as error:
            raise UnreadableImageError(f"the image cannot be brought to size ({error.err})") from error
        return np.ascontiguousarray(picture[..., ::-1].transpose(2, 0, 1))

    def panoramas(self, paths: Sequence[str | Path], count: int, on_error: Policy = "skip") -> NDArray[np.uint8]:
        """Read up to `count` images, spread evenly over a list, and return their panoramas (B, 3, H, W), uint8, RGB.

        Args:
            paths: the files, as for `panorama`.
            count: how many of them are read.
            on_error: "skip" leaves unreadable images out and reports them, "raise" stops.

        Raises:
            DataError: an unreadable image under "raise", or nothing but unreadable images.
        """
        sized, chosen = self.sized_by(paths), spread(paths, count)
        read, faults = [], []
        for path in chosen:
            try:
                read.append(sized.panorama(path))
            except UnreadableImageError as error:
                faults.append(f"{path}: {error}")
        leave_out(faults, len(chosen), "images cannot be read", on_error)
        return np.stack(read)

    def prepare(
        self, pixels: NDArray[np.uint8], tilt: NDArray[np.float64] | Sequence[float] | None = None
    ) -> NDArray[np.uint8]:
        """Return the panorama (3, H, W) of an image in memory (rows, columns, 3); both uint8, RGB.

        Args:
            pixels: the image; of two pictures of a `DualFisheyeCamera`, both side by side.
            tilt: as for `panorama`.

        Raises:
            ConfigError, DataError: the camera does not fit the image.
        """
        return np.ascontiguousarray(self._picture(np.ascontiguousarray(pixels), tilt).transpose(2, 0, 1))

    def files(self, path: str | Path) -> list[Path]:
        """Return the files of an image: one, or the two pictures of a `DualFisheyeCamera`."""
        first = Path(path)
        return [first] if self.second is None else [first, first.parent / first.name.replace(*self.second)]

    @property
    def second(self) -> tuple[str, str] | None:
        """How the names of second pictures differ, as in `DualFisheyeCamera`; None if an image is one picture."""
        return getattr(self.camera, "second", None)

    def _opened(self, path: str | Path, *, levelled: bool) -> tuple[NDArray[np.uint8], Preprocessing]:
        """Return an image, and the preprocessing with the camera as the image says that it was placed."""
        image = self._read(path)
        return image, dataclasses.replace(self, camera=stated(self.camera, path, image.shape[:2], levelled=levelled))

    def _read(self, path: str | Path) -> NDArray[np.uint8]:
        if len(files := self.files(path)) > 1 and files[0] == files[1]:
            raise DataError("its name lacks what unwrap.second replaces, so that no second picture is known")
        first = read_image(files[0], self.bits)
        if len(files) == 1:
            return first
        try:
            second = read_image(files[1], self.bits)
        except UnreadableImageError as error:
            raise UnreadableImageError(f"its second picture {files[1].name}: {error}") from error
        if second.shape != first.shape:
            raise DataError(f"its second picture {files[1].name} has another size")
        return np.hstack([first, second])

    def _picture(
        self, image: NDArray[np.uint8], tilt: NDArray[np.float64] | Sequence[float] | None
    ) -> NDArray[np.uint8]:
        image = self._scaled(image)
        if self.camera is None:
            size = (self.view.width, self.view.height)
            return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        if (fault := wrong_lenses(image, self.camera)) is not None:
            raise DataError(fault)
        if self.level and (tilt is None or not np.isfinite(tilt).all()):
            tilt = self._tilt(image)
        view = self.view if tilt is None or not np.nan_to_num(tilt).any() else self.view.tilted(*tilt)
        return unwrap(image, self.camera, view)

    def tilts(self, paths: Sequence[str | Path], count: int) -> NDArray[np.float64]:
        """Return the roll and pitch (n, 2) in rad of up to `count` images that can be used, spread evenly over a list.

        They are found by upright edges; what a picture says of its own tilt is taken out before.
        """
        found, sized = [], self.sized_by(paths)
        for path in spread(paths, count):
            with suppress(UnreadableImageError, DataError, ConfigError):
                image, own = sized._opened(path, levelled=False)
                found.append(own._tilt(own._scaled(image)))
        return np.reshape(found, (-1, 2))

    def _tilt(self, image: NDArray[np.uint8]) -> NDArray[np.float64]:
        assert self.camera is not None
        fine = dataclasses.replace(self.view, height=SIZE[0], width=SIZE[1])
        return tilt_of(unwrap(image, self.camera, fine), fine, seen(self.camera, fine, image.shape[:2]))

    def _scaled(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return an image of the size in whose pixels the camera's parameters count."""
        if self.size is None or image.shape[:2] == self.size:
            return image
        (rows, columns), (height, width) = self.size, image.shape[:2]
        alike = abs(width * rows / (height * columns) - 1) <= _ALIKE
        if self.camera is None:
            if not alike:
                say_once(
                    f"there are pictures of another shape than {columns} x {rows} px: they look different when resized"
                )
            return image
        sizes = f"{width} x {height} px, and the camera's parameters count in those of {columns} x {rows}"
        if not alike:
            raise DataError(f"the picture has {sizes}: give pictures of that size")
        say_once(f"the pictures have {sizes}: they are scaled, which is right if they show the same")
        way = cv2.INTER_AREA if height > rows else cv2.INTER_LINEAR
        return np.asarray(cv2.resize(image, (columns, rows), interpolation=way), dtype=np.uint8)


def _name(kind: type) -> str:
    """Return the name of a camera class in files: of one's own, with its module."""
    return kind.__name__ if kind in CAMERAS.values() else f"{kind.__module__}:{kind.__qualname__}"


def _plain(camera: Any) -> dict[str, Any]:
    return cast("dict[str, Any]", plain(dataclasses.asdict(camera)))


def _calibrated(options: Mapping[str, Any]) -> OmnidirectionalCamera:
    from siamloc.data.calibration import read_calibration

    given = {key: value for key, value in options.items() if value is not None}
    return read_calibration(checked(given.pop("file", None), Path, "unwrap.file"), **given)


def _camera(kind: str, options: Mapping[str, Any]) -> OmnidirectionalCamera | None:
    """Make a camera from its kind, in settings or in files, and its parameters.

    A class of the user's own is taken from a module that is imported already: files must not make siamloc import code.
    """
    known = {**CAMERAS, **{one.__name__: one for one in CAMERAS.values() if one is not None}}
    if kind in known:
        built_in = known[kind]
        return None if built_in is None else built_in.of(options)
    if ":" not in kind:
        raise ConfigError(f"unknown unwrap.kind {kind!r}: {hint(kind, [*CAMERAS, 'calibrated', 'module:Class'])}")
    if (own := _imported(kind)) is None:
        raise ConfigError(
            f"the camera {kind} is a class of your own: import the module {kind.partition(':')[0]} first, which must "
            "have this dataclass with a method `sampling`, or give the camera object itself; a command imports it by "
            f"unwrap.kind={kind}"
        )
    try:
        return cast("OmnidirectionalCamera", own(**{key: _hashable(value) for key, value in options.items()}))
    except TypeError as error:
        raise ConfigError(f"the camera {kind} cannot be made from {dict(options)}: {error}") from error


def is_known(kind: str) -> bool:
    """Return whether cameras of a kind, as in `Preprocessing.parameters`, can be made in this process."""
    return ":" not in kind or _imported(kind) is not None


def _imported(kind: str) -> Any:
    """Return the camera class of a name such as "module:Class"; None if it is not imported, or no such class."""
    module, _, name = kind.partition(":")
    found: Any = sys.modules.get(module)
    for part in name.split("."):
        found = getattr(found, part, None)
    is_camera = isinstance(found, type) and dataclasses.is_dataclass(found) and hasattr(found, "sampling")
    return found if is_camera else None


def _hashable(value: Any) -> Any:
    return tuple(map(_hashable, value)) if isinstance(value, list) else value
