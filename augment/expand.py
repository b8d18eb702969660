"""Write an expanded data set: every frame in several variants, with the parameters of every image in a table.

Paths go in and images come out; the caller decides on the folder layout. The parameters of an image depend only on
(seed, frame, variant) and the image's size, so any order of work, any number of threads and any interruption give the
same files. A run that was killed may leave a table with an incomplete last line; resuming removes it.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from augment.combinations import Variant, variants
from augment.errors import AugmentError
from foundation.files import csv_text, is_temporary, read_json, write_json, write_picture, write_text
from foundation.locks import LOCK
from foundation.threads import in_order

TABLE = "augmentation.csv"
SETTINGS = "augmentation.json"
COLUMNS = ("image", "source", "frame", "variant", "label", "heading", "parameters")
VERSION = 1

Row = dict[str, str]
Job = tuple[int, Path, list[Path], list[Variant]]
"""Number of a frame, its image, its outputs, and the variants to be made."""
Progress = Callable[[Iterable[Any], int, str], Iterable[Any]]
Reader = Callable[[Path], NDArray[np.uint8]]


class Expansion(NamedTuple):
    """The result of `expand`.

    Attributes:
        written: number of images made.
        kept: number of images that existed already.
        failed: source images that could not be used, each with the reason; no variant of them was made.
    """

    written: int
    kept: int
    failed: list[tuple[Path, str]]


def expand(
    images: Sequence[str | Path],
    outputs: Sequence[Sequence[Path]],
    folder: str | Path,
    read: Reader,
    *,
    seed: int = 0,
    circular: bool = True,
    resume: bool = False,
    threads: int = 2,
    on_error: str = "skip",
    progress: Progress | None = None,
    reading: Mapping[str, Any] | None = None,
) -> Expansion:
    """Write the variants of images, each file whole or not at all.

    `augment.variants(depth, circular)[variant].policy.apply(image, {key: [value] for key, value in row.items()})`, with
    the parameters in the row of an image in the table, makes that image again.

    Args:
        images: the n source images, at least one.
        outputs: for each source the files to write (n, depth), all different, and inside the folder; the suffix sets
            the format.
        folder: folder of the expanded data set. The table and the settings are written here; it has to be empty or
            absent, unless `resume`.
        read: returns the image (3, H, W), uint8, RGB, of a source, or raises AugmentError; called from several threads.
        seed: seed of all parameters.
        circular: whether columns wrap around.
        resume: continue what an earlier call with the same sources, outputs and seed left unfinished; images in its
            table stay, and the temporary files it left are removed.
        threads: frames processed at once.
        on_error: "skip" reports a source that cannot be read and continues; "raise" stops.
        progress: for a progress bar; called with (items, total, what), yields the items.
        reading: settings that decide what `read` returns, as JSON values; resuming with other ones is refused.

    Raises:
        AugmentError: a folder that is not empty, a resume with other settings, or, under "raise", a source that cannot
            be read.
        FormatError: a folder to resume whose settings are damaged.
        StorageError: the disk is full or cannot be written to.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> folder = Path(tempfile.mkdtemp())
        >>> outputs = [[folder / f"{variant}.png" for variant in range(16)]]
        >>> expand(["frame"], outputs, folder, read=lambda path: np.full((3, 32, 128), 90, np.uint8)).written
        16
    """
    folder, sources, depth = Path(folder), [Path(image) for image in images], len(outputs[0])
    listed = variants(depth, circular)
    options = {"seed": int(seed), "depth": depth, "circular": circular, "reading": dict(reading or {})}
    rows = _prepared(folder, sources, outputs, options, resume)
    work: list[Job] = []
    for frame, (source, row) in enumerate(zip(sources, outputs, strict=True)):
        missing = [v for v in listed if _name(row[v.number], folder) not in rows or not row[v.number].is_file()]
        if missing:
            work.append((frame, source, list(row), missing))
    written, failed = 0, []
    with (folder / TABLE).open("a", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        results: Iterable[Any] = in_order(partial(_expand_frame, folder, int(seed), read), work, int(threads))
        for source, made, reason in progress(results, len(work), "augmenting frames") if progress else results:
            if reason and on_error == "raise":
                raise AugmentError(reason)
            if reason:
                failed.append((source, reason))
            table.writerows(made)
            file.flush()
            rows.update((row["image"], row) for row in made)
            written += len(made)
    _write_table(folder / TABLE, sorted(rows.values(), key=lambda row: (int(row["frame"]), int(row["variant"]))))
    kept = len(sources) * depth - sum(len(missing) for *_, missing in work)
    return Expansion(written, kept, failed)


def headings(frames: int, depth: int, seed: int, size: tuple[int, int], circular: bool = True) -> NDArray[np.float64]:
    """Return what each image's rotation adds to the robot's heading (frames, depth), rad in (-pi, pi].

    For layouts that carry the heading in the file name: it is known before any image is made.

    Args:
        frames: number of source images.
        depth: number of variants of each source image.
        seed: seed that `expand` gets, from which the rotations follow.
        size: rows and columns of the images.
        circular: whether columns wrap around; if not, all are 0.

    Example:
        >>> headings(2, 17, seed=0, size=(128, 512))[:, 14:].round(2)
        array([[ 0.  , -0.75,  0.97],
               [ 0.  , -2.86, -0.74]])
    """
    out = np.zeros((frames, depth))
    for variant in variants(depth, circular) if circular and frames else []:
        if any(effect.name == "rotate" for effect in variant.policy.effects):
            out[:, variant.number] = variant.parameters(seed, range(frames), size)["heading"].numpy()
    return out


def read_table(path: str | Path) -> list[Row]:
    """Return the rows of an expansion's table; a last line cut short by an interruption is left out.

    Raises:
        AugmentError: the file is not such a table.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "augmentation.csv"
        >>> lines = [",".join(COLUMNS), "a.png,in.png,0,0,original,0.0,{}", "b.png,in.p"]
        >>> _ = path.write_text("\\n".join(lines))
        >>> [row["image"] for row in read_table(path)]
        ['a.png']
    """
    content = Path(path).read_bytes()
    if (",".join(COLUMNS) + "\n").encode().startswith(content):  # killed before the header was written
        return []
    whole = content[: content.rfind(b"\n") + 1].decode("utf-8", errors="replace")
    reader = csv.DictReader(StringIO(whole, newline=""))
    if tuple(reader.fieldnames or ()) != COLUMNS:
        raise AugmentError(f"{path} is not a table of augment.expand: its columns must be {', '.join(COLUMNS)}")
    return [row for row in reader if None not in row.values()]


def _prepared(
    folder: Path, sources: list[Path], outputs: Sequence[Sequence[Path]], options: dict[str, Any], resume: bool
) -> dict[str, Row]:
    """Prepare the folder and return the rows of the images that an earlier call finished, by image."""
    wanted = json.loads(json.dumps({"schema": VERSION, **options, "frames": len(sources)}))  # as it will be read again
    table, settings = folder / TABLE, folder / SETTINGS
    if folder.exists() and not all(is_temporary(path) or path.name == LOCK for path in folder.iterdir()):
        if not resume:
            raise AugmentError(f"{folder} is not empty: choose another folder, or go on with resume=true")
        if not settings.is_file():
            raise AugmentError(f"{folder} has no {SETTINGS}, so there is nothing to resume: choose another folder")
        there = read_json(settings)
        before = there if isinstance(there, dict) else {}
        differing = [key for key, value in wanted.items() if before.get(key) != value]
        if differing:
            changed = "; ".join(f"{key}={before.get(key)}, now asked for {wanted[key]}" for key in differing)
            raise AugmentError(f"{folder} was expanded with {changed}: use the same settings, or another folder")
    rows = read_table(table) if table.is_file() else []
    named = zip(sources, outputs, strict=True)
    asked = {_name(target, folder): str(source) for source, row in named for target in row} if rows else {}
    for row in rows:
        if asked.get(row["image"]) != row["source"]:
            raise AugmentError(
                f"{table} says that {row['image']} was made of {row['source']}, which is not what is asked for now: "
                "resume with the same images and outputs, or choose another folder"
            )
    write_json(settings, wanted)
    _write_table(table, rows)  # drops an incomplete line, so that further lines can be appended
    return {row["image"]: row for row in rows}


def _expand_frame(folder: Path, seed: int, read: Reader, job: Job) -> tuple[Path, list[Row], str]:
    """Write the missing images of one frame; return its source, their rows in the table, and what went wrong."""
    frame, source, outputs, missing = job
    try:
        picture = torch.from_numpy(read(source))[None]
    except AugmentError as error:
        return source, [], str(error)
    made = []
    for variant in missing:
        params = variant.parameters(seed, [frame], (picture.shape[2], picture.shape[3]))
        output = outputs[variant.number]
        write_picture(output, variant.policy.apply(picture, params)[0].permute(1, 2, 0).numpy(), quality=95)
        values = {key: value.item() for key, value in params.items()}
        heading, parameters = repr(values["heading"]), json.dumps(values)
        cells = (_name(output, folder), source, frame, variant.number, variant.label, heading, parameters)
        made.append(dict(zip(COLUMNS, map(str, cells), strict=True)))
    return source, made, ""


def _name(path: Path, folder: Path) -> str:
    """Return the name of an image in the table: its path inside the folder."""
    return path.relative_to(folder).as_posix()


def _write_table(path: Path, rows: Iterable[Row]) -> None:
    write_text(path, csv_text([COLUMNS, *([row[column] for column in COLUMNS] for row in rows)]))
