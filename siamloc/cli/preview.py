"""`siamloc augment preview`: a labelled contact sheet of all effects at several strengths."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from omegaconf import DictConfig

from siamloc.cli.steps import images_named, preprocessing, read_frames
from siamloc.data.decoding import Preprocessing, UnreadableImageError
from siamloc.errors import ConfigError, DataError
from siamloc.files import atomic_path

_SUFFIXES = (".jpg", ".jpeg", ".png", ".webp")


def main(config: DictConfig) -> None:
    """Draw the sheet."""
    target = Path(config.out)
    if target.suffix.lower() not in _SUFFIXES:
        raise ConfigError(f"out={target} must be a picture, with one of the endings {' '.join(_SUFFIXES)}")
    import torch

    import augment

    panoramas = torch.from_numpy(np.stack(_panoramas(config)))
    sheet = augment.preview(panoramas)
    quality = [cv2.IMWRITE_JPEG_QUALITY, 88] if target.suffix.lower() in (".jpg", ".jpeg") else []
    encoded = cv2.imencode(target.suffix.lower(), np.ascontiguousarray(sheet[:, :, ::-1]), quality)[1]
    target.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(target) as temporary:
        temporary.write_bytes(encoded.tobytes())
    print(f"{target}: {len(augment.EFFECTS)} effects on {len(panoramas)} panoramas")


def _panoramas(config: DictConfig) -> list[NDArray[np.uint8]]:
    """Return those of the named files, of frames spread over the data set, or of the made-up building."""
    if not config.images and config.data.get("manifest") is None and config.data.get("root") is None:
        return _rendered(config.count)
    if config.images:
        paths = [str(path) for path in images_named(config.images)]
    else:
        paths = read_frames(config).path.tolist()
    spread = np.linspace(0, len(paths) - 1, min(config.count, len(paths))).round().astype(int)
    decode = preprocessing(config)
    return [_decoded(decode, paths[number]) for number in spread.tolist()]


def _decoded(decode: Preprocessing, path: str) -> NDArray[np.uint8]:
    try:
        return decode.panorama(path)
    except UnreadableImageError as error:
        raise DataError(f"{path} cannot be shown: {error}") from error


def _rendered(count: int) -> list[NDArray[np.uint8]]:
    """Return panoramas of rooms of the simulated building, rendered for this picture."""
    from siamloc.simulate import Run, build_scene, load_building, render
    from siamloc.simulate.preview import viewpoints
    from siamloc.simulate.run import draw_run

    building, run = load_building("freiburg_like", 0), Run()
    track = draw_run(building, run).track
    rows = viewpoints(building, track)[:count]
    return [np.ascontiguousarray(p.transpose(2, 0, 1)) for p in render(build_scene(building, run), track.poses[rows])]
