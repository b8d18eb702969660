"""Writing an expanded data set: every frame in several variants, with the parameters of every picture in a table.

Paths go in and pictures come out; which folder layout they form is the caller's business. The parameters of a picture
follow from (seed, frame, variant) and the picture's size alone, so that any order of work, any number of threads
and any interruption give the same files.
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

from augment.base import Params
from augment.errors import AugmentError
from augment.expansion_files import COLUMNS, TABLE, Row, name_in, prepare, write_bytes, write_table
from augment.thesis import Variant, variants

Job = tuple[int, Path, list[Path], list[Variant]]  # frame, source, its outputs, the variants to be made
Progress = Callable[[Iterable[Any], int, str], Iterable[Any]]
Reader = Callable[[Path], NDArray[np.uint8]]


@dataclass(frozen=True)
class Expansion:
    """What `expand` did.

    Attributes:
        table: the CSV with one row for every picture, its columns being COLUMNS.
        written: pictures made.
        kept: pictures that were there already.
        failed: sources that could not be used, each with the reason; none of their pictures was made.
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
        images: the n source pictures.
        outputs: for each source the files to write (n, depth), all inside the folder; their suffix says the format.
        folder: of the expanded data set. The table and the settings are written here; it has to be empty or absent,
            unless `resume`.
        seed: of all parameters.
        circular: whether columns wrap around.
        resume: go on in a folder that an earlier call with the same sources, outputs and seed left; what is there
            and whole stays.
        threads: pictures in work at once.
        on_error: "skip" reports a source that cannot be read and goes on; "raise" stops.
        progress: called with (items, total, what), yields the items; for a bar.
        read: returns the picture (3, H, W), uint8, RGB, of a source, or raises AugmentError; called from several
            threads. The file as it is if None.
        reading: what decides how `read` makes a picture of a source, in values that JSON can hold; resuming with
            another is refused.

    Raises:
        AugmentError: no images, outputs that do not fit or coincide, a folder that is not empty, a resume with other
            settings, or, under "raise", a source that cannot be read.
        OSError: the disk refuses.
    """
    folder, sources = Path(folder), [Path(image) for image in images]
    targets = [[Path(output) for output in row] for row in outputs]
    depth = _checked_depth(sources, targets, folder, on_error)
    if seed < 0:
        raise AugmentError(f"seed must be 0 or more, got {seed}")
    listed = variants(depth, circular)
    options = {"seed": int(seed), "depth": depth, "circular": circular, "reading": dict(reading or {})}
    done = prepare(folder, sources, targets, options, resume)
    work: list[Job] = []
    for frame, (source, row) in enumerate(zip(sources, targets, strict=True)):
        missing = [v for v in listed if name_in(row[v.number], folder) not in done or not row[v.number].is_file()]
        if missing:
            work.append((frame, source, row, missing))
    kept = len(sources) * depth - sum(len(missing) for *_, missing in work)
    rows, failed, written = dict(done), [], 0
    with (folder / TABLE).open("a", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        if not done:
            file.truncate(0)
            table.writeheader()
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


def parameters(variant: Variant, seed: int, frame: int, size: tuple[int, int]) -> Params:
    """Return the parameters of one picture, each of shape (1,).

    Args:
        variant: what is made of the frame.
        seed: of the expansion.
        frame: number of the source among the images.
        size: rows and columns of the picture.
    """
    state = np.random.SeedSequence([seed, frame, variant.number]).generate_state(1, np.uint64)
    generator = torch.Generator().manual_seed(int(state[0] >> np.uint64(1)))
    return variant.policy.draw(generator, torch.empty(1, 3, *size, dtype=torch.uint8))


def headings(frames: int, depth: int, seed: int, size: tuple[int, int], circular: bool = True) -> NDArray[np.float64]:
    """Return what each picture's rotation adds to the robot's heading (frames, depth), rad in (-pi, pi].

    For layouts that carry the heading in the file name: it is known before any picture is made.
    """
    out = np.zeros((frames, depth))
    for variant in variants(depth, circular):
        if any(effect.name == "rotate" for effect in variant.policy.effects):
            for frame in range(frames):
                out[frame, variant.number] = float(parameters(variant, seed, frame, size)["heading"])
    return out


def replay(row: Row, picture: Tensor, circular: bool = True) -> Tensor:
    """Return the picture (1, 3, H, W) that a row of the table describes, made from its source."""
    found = [v for v in variants(int(row["variant"]) + 1, circular) if v.number == int(row["variant"])]
    stored = json.loads(row["parameters"])
    return found[0].policy.apply(picture, {key: [value] for key, value in stored.items()})


def read_picture(path: Path) -> NDArray[np.uint8]:
    """Return the picture (3, H, W), uint8, RGB, of an image file.

    Raises:
        AugmentError: the file is missing or no image.
    """
    image = cv2.imread(str(path), cv2.IMREAD_COLOR) if path.is_file() else None
    if image is None:
        raise AugmentError(f"{path} {'is not a readable image' if path.is_file() else 'does not exist'}")
    return np.ascontiguousarray(image[:, :, ::-1].transpose(2, 0, 1), dtype=np.uint8)


def _expand_frame(folder: Path, seed: int, read: Reader, job: Job) -> tuple[Path, list[Row], str]:
    """Write what is missing of one frame; return its source, the rows of the table, and what went wrong."""
    frame, source, row, missing = job
    try:
        picture = torch.from_numpy(read(source))[None]
    except AugmentError as error:
        return source, [], str(error)
    made = []
    for variant in missing:
        params = parameters(variant, seed, frame, (picture.shape[2], picture.shape[3]))
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
    if len(set(every)) != len(every) or set(every) & set(sources):
        raise AugmentError("outputs must differ from each other and from the images they are made of")
    for path in every:
        if not path.is_relative_to(folder) or ".." in path.relative_to(folder).parts:
            raise AugmentError(f"{path} lies outside the folder {folder}")
        if path.suffix.lower() not in (".jpeg", ".jpg", ".png", ".webp", ".bmp"):
            raise AugmentError(f"{path} has no suffix of a picture: use .jpeg or .png")
    return depth


def _bounded(pool: ThreadPoolExecutor, work: Callable[[Any], Any], items: list[Any], ahead: int) -> Iterable[Any]:
    """Yield results in order with only a few items in work, so that memory stays bounded."""
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
