"""Write an expanded data set: every frame in several variants, with the parameters of every image in a table.

Paths go in and images come out; the caller decides on the folder layout. The parameters of an image depend only on
(seed, frame, variant) and the image's size, so any order of work, any number of threads and any interruption give the
same files.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from augment.combinations import Variant, variants
from augment.errors import AugmentError
from augment.expansion_files import COLUMNS, TABLE, Row, name_in, prepare, write_table
from foundation.files import write_bytes

Job = tuple[int, Path, list[Path], list[Variant]]  # frame, source, its outputs, the variants to be made
Progress = Callable[[Iterable[Any], int, str], Iterable[Any]]
Reader = Callable[[Path], NDArray[np.uint8]]


@dataclass(frozen=True)
class Expansion:
    """The result of `expand`.

    Attributes:
        table: the CSV with one row for every image.
        written: number of images made.
        kept: number of images that existed already.
        failed: sources that could not be used, each with the reason; none of their images were made.
    """

    table: Path
    written: int
    kept: int
    failed: tuple[tuple[Path, str], ...]


def expand(
    images: Sequence[str | Path],
    outputs: Sequence[Sequence[str | Path]],
    folder: str | Path,
    *,
    seed: int = 0,
    circular: bool = True,
    resume: bool = False,
    threads: int = 2,
    on_error: Literal["skip", "raise"] = "skip",
    progress: Progress | None = None,
    read: Reader | None = None,
    reading: Mapping[str, Any] | None = None,
) -> Expansion:
    """Write the variants of images, each file whole or not at all.

    Args:
        images: the n source images.
        outputs: for each source the files to write (n, depth), all inside the folder; the suffix sets the format.
        folder: folder of the expanded data set. The table and the settings are written here; it has to be empty or
            absent, unless `resume`.
        seed: seed of all parameters.
        circular: whether columns wrap around.
        resume: continue what an earlier call with the same sources, outputs and seed left unfinished; images in its
            table stay, and the temporary files it left are removed.
        threads: frames processed at once.
        on_error: "skip" reports a source that cannot be read and continues; "raise" stops.
        progress: for a progress bar; called with (items, total, what), yields the items.
        read: returns the image (3, H, W), uint8, RGB, of a source, or raises AugmentError; called from several
            threads. If None, the image file is read as it is.
        reading: settings that decide what `read` returns, as JSON values; resuming with other ones is refused.

    Raises:
        AugmentError: no images, outputs that do not fit or coincide, a folder that is not empty, a resume with other
            settings, or, under "raise", a source that cannot be read.
        OSError: the disk cannot be read or written.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> folder = Path(tempfile.mkdtemp())
        >>> _ = cv2.imwrite(str(folder / "frame.png"), np.full((32, 128, 3), 90, np.uint8))
        >>> outputs = [[folder / "out" / f"{variant}.png" for variant in range(16)]]
        >>> expand([folder / "frame.png"], outputs, folder / "out", seed=0).written
        16
    """
    folder, sources = Path(folder), [Path(image) for image in images]
    targets = [[output if isinstance(output, Path) else Path(output) for output in row] for row in outputs]
    depth = _checked_depth(sources, targets, folder, on_error)
    if seed < 0:
        raise AugmentError(f"seed must be 0 or more, got {seed}")
    listed = variants(depth, circular)
    options = {"seed": int(seed), "depth": depth, "circular": circular, "reading": dict(reading or {})}
    done = prepare(folder, sources, targets, options, resume)
    work: list[Job] = []
    for frame, (source, row) in enumerate(zip(sources, targets, strict=True)):
        missing = listed
        if done:
            missing = [v for v in listed if name_in(row[v.number], folder) not in done or not row[v.number].is_file()]
        if missing:
            work.append((frame, source, row, missing))
    kept = len(sources) * depth - sum(len(missing) for *_, missing in work)
    rows, failed, written = dict(done), [], 0
    with (folder / TABLE).open("a", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        with ThreadPoolExecutor(max(int(threads), 1)) as pool:
            results = _bounded(
                pool, partial(_expand_frame, folder, int(seed), read or read_picture), work, 2 * max(int(threads), 1)
            )
            for source, made, reason in (
                progress(results, len(work), "augmenting frames") if progress and work else results
            ):
                if reason and on_error == "raise":
                    raise AugmentError(reason)
                if reason:
                    failed.append((source, reason))
                table.writerows(made)
                file.flush()
                rows.update((row["image"], row) for row in made)
                written += len(made)
    order = sorted(rows.values(), key=lambda row: (int(row["frame"]), int(row["variant"])))
    write_table(folder / TABLE, order)
    return Expansion(folder / TABLE, written, kept, tuple(failed))


def headings(
    frames: int,
    depth: int,
    seed: int,
    size: tuple[int, int],
    circular: bool = True,
    progress: Progress | None = None,
) -> NDArray[np.float64]:
    """Return what each image's rotation adds to the robot's heading (frames, depth), rad in (-pi, pi].

    For layouts that carry the heading in the file name: it is known before any image is made.

    Args:
        frames: number of frames.
        depth: number of variants of each frame.
        seed: seed of the expansion.
        size: rows and columns of the images.
        circular: whether columns wrap around; if not, all are 0.
        progress: for a progress bar; called with (items, total, what), yields the items.

    Example:
        >>> headings(2, 17, seed=0, size=(128, 512))[:, 14:].round(2)
        array([[ 0.  , -0.75,  0.97],
               [ 0.  , -2.86, -0.74]])
    """
    out = np.zeros((frames, depth))
    turning = [v for v in variants(depth, circular) if any(effect.name == "rotate" for effect in v.policy.effects)]
    if circular and frames:
        for variant in progress(turning, len(turning), "drawing headings") if progress else turning:
            out[:, variant.number] = variant.parameters(seed, range(frames), size)["heading"]
    return out


def replay(row: Row, picture: Tensor, circular: bool = True) -> Tensor:
    """Make the image (1, 3, H, W) that a row of the table describes from its source (1, 3, H, W).

    Example:
        >>> values = {"0.brighten.on": True, "0.brighten.amount": 40, "heading": 0.0}
        >>> row = {"variant": "7", "parameters": json.dumps(values)}
        >>> replay(row, torch.full((1, 3, 32, 128), 100, dtype=torch.uint8)).unique()
        tensor([140], dtype=torch.uint8)
    """
    variant = variants(int(row["variant"]) + 1, circular)[-1]
    return variant.policy.apply(picture, {key: [value] for key, value in json.loads(row["parameters"]).items()})


def read_picture(path: Path) -> NDArray[np.uint8]:
    """Read an image file as (3, H, W), uint8, RGB.

    Raises:
        AugmentError: the file is missing or not an image.
    """
    image = cv2.imread(str(path), cv2.IMREAD_COLOR) if path.is_file() else None
    if image is None:
        raise AugmentError(f"{path} {'is not a readable image' if path.is_file() else 'does not exist'}")
    return np.ascontiguousarray(image[:, :, ::-1].transpose(2, 0, 1), dtype=np.uint8)


def _expand_frame(folder: Path, seed: int, read: Reader, job: Job) -> tuple[Path, list[Row], str]:
    """Write the missing images of one frame; return its source, their rows in the table, and what went wrong."""
    frame, source, row, missing = job
    try:
        picture = torch.from_numpy(read(source))[None]
    except AugmentError as error:
        return source, [], str(error)
    made = []
    for variant in missing:
        params = variant.parameters(seed, [frame], (picture.shape[2], picture.shape[3]))
        result = variant.policy.apply(picture, params)[0].permute(1, 2, 0).numpy()[:, :, ::-1]
        target = row[variant.number]
        _write_image(target, np.ascontiguousarray(result))
        values = {key: value.item() for key, value in params.items()}
        made.append(
            {
                "image": name_in(target, folder),
                "source": str(source),
                "frame": str(frame),
                "variant": str(variant.number),
                "label": variant.label,
                "heading": repr(values["heading"]),
                "parameters": json.dumps(values),
            }
        )
    return source, made, ""


def _checked_depth(sources: list[Path], targets: list[list[Path]], folder: Path, on_error: str) -> int:
    if on_error not in ("skip", "raise"):
        raise AugmentError(f"on_error must be skip or raise, got {on_error!r}")
    if not sources:
        raise AugmentError("there is no image to expand")
    if len(targets) != len(sources):
        raise AugmentError(f"{len(sources)} images need as many rows of outputs, got {len(targets)}")
    depth = len(targets[0])
    if depth < 1 or any(len(row) != depth for row in targets):
        raise AugmentError("every image needs the same number of outputs, at least one")
    every = [path for row in targets for path in row]
    if len(set(every)) != len(every) or not set(sources).isdisjoint(every):
        raise AugmentError("outputs must differ from each other and from the images they are made of")
    for parent in {path.parent for path in every}:  # far fewer than files
        if not parent.is_relative_to(folder) or ".." in parent.relative_to(folder).parts:
            raise AugmentError(f"{parent} lies outside the folder {folder}")
    for path in every:
        if path.suffix.lower() not in (".jpeg", ".jpg", ".png", ".webp", ".bmp"):
            raise AugmentError(f"{path} does not end like an image: use .jpeg or .png")
    return depth


def _bounded(pool: ThreadPoolExecutor, work: Callable[[Any], Any], items: list[Any], ahead: int) -> Iterable[Any]:
    """Yield results in order with only a few items in progress at once, so that memory stays bounded."""
    waiting = []
    for item in items:
        waiting.append(pool.submit(work, item))
        if len(waiting) >= ahead:
            yield waiting.pop(0).result()
    for future in waiting:
        yield future.result()


def _write_image(path: Path, image: NDArray[np.uint8]) -> None:
    quality = [cv2.IMWRITE_JPEG_QUALITY, 95] if path.suffix.lower() in (".jpeg", ".jpg") else []
    write_bytes(path, cv2.imencode(path.suffix.lower(), image, quality)[1].tobytes())
