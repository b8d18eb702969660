"""`siamloc localize`, which runs where only numpy, OpenCV and onnxruntime are installed: no Hydra reads its words."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from siamloc.errors import ConfigError, DataError, hint
from siamloc.runs import Run, newest_run
from siamloc.settings import Count, Many, Settings, Text, fields_of

_ITEM = re.compile(r"""\s*('(?:[^'\\]|\\.)*'|"(?:[^"\\]|\\.)*"|[^,'"\[\]]*[^,'"\[\]\s])\s*(,|$)""")
_PLAIN = {"true": True, "false": False, "null": None}


@dataclass(frozen=True)
class Localize(Settings):
    """What `siamloc localize` takes.

    Attributes:
        images: files, folders, videos, and cameras such as camera:0.
        run: the run whose bundle is used.
        bundle: another bundle.
        top: map frames to list for each image.
        track: follow the robot from image to image; each folder, video and camera is a drive.
        format: what is printed: a line to read, of JSON, or of a table.
        out: file of the locations, .csv or .jsonl; if None, locations.csv beside the run's bundle, or here with
            `bundle`, where lines to read are printed, and no file otherwise.
        on_error: go on after an image that cannot be read, or stop there.
        threads: of onnxruntime; its own choice if None.
    """

    images: tuple[Text, ...] | Text = ()
    run: Path | None = None
    bundle: Path | None = None
    top: Many = 3
    track: bool = False
    format: Literal["table", "jsonl", "csv"] = "table"
    out: Path | None = None
    on_error: Literal["skip", "raise"] = "skip"
    threads: Count | None = None

    @property
    def target(self) -> Path | None:
        """The file of the locations."""
        if self.out is not None or self.format != "table":
            return self.out
        return Path("locations.csv") if self.bundle is not None or self.run is None else self.run / "locations.csv"


def localize(words: Sequence[str]) -> int:
    """Locate images, and print where each was taken as soon as that is known."""
    settings = Localize.of(values_of(words, Localize))
    if settings.bundle is None and settings.run is None:
        raise ConfigError(f"no bundle and no run are named: give bundle=FOLDER, or {_suggestion()}")
    from siamloc.runtime import Localizer, locate_all, written
    from siamloc.runtime.stream import LINES, named

    named(settings.images)  # refused before the bundle is loaded
    run = None if settings.run is None else Run(settings.run)
    bundle = settings.bundle if settings.bundle is not None or run is None else run.bundle
    assert bundle is not None
    localizer = Localizer(bundle, top=settings.top, threads=settings.threads)
    located = locate_all(localizer, settings.images, on_error=settings.on_error, track=settings.track)
    target = settings.target
    off, faults, count, stopped = list[float](), 0, 0, False
    line = None if settings.format == "table" else LINES[f".{settings.format}"]()
    print(line.head if line else "", end="")
    with closing(located if target is None else written(target, located)) as passing:
        try:
            for one in passing:
                print(line(one) if line else f"{one.describe(localizer.unit)}\n", end="", flush=True)
                count += 1
                faults += one.location is None
                if not math.isnan(one.off_by):
                    off.append(one.off_by)
        except KeyboardInterrupt:
            stopped = True
    if count == faults and not stopped:
        raise DataError(f"none of the {count} images could be read")
    if target is not None and run is not None and target.parent == run.folder:
        run.record_written([target])
    said = sys.stderr if line else sys.stdout
    where = "" if target is None else f": {target}"
    print(f"{count - faults} of {count} images located{', then interrupted' if stopped else ''}{where}", file=said)
    if off:
        middle = sorted(off)[len(off) // 2]
        print(
            f"from the poses in their names: mean {sum(off) / len(off):.2f} {localizer.unit}, median {middle:.2f} "
            f"{localizer.unit}, largest {max(off):.2f} {localizer.unit}",
            file=said,
        )
    return 130 if stopped else 0


def values_of(words: Sequence[str], kind: type[Settings]) -> dict[str, Any]:
    """Read words such as "images=[a.jpeg,'b (1).jpeg']" as the values of a settings class.

    Raises:
        ConfigError: a word that is no key=value, an unknown key, one that is there twice, or a list that cannot be
            read.
    """
    known, values = fields_of(kind), dict[str, Any]()
    for word in words:
        key, equals, text = word.lstrip("+").partition("=")
        if not equals:
            raise ConfigError(f"{word!r} is not of the form key=value, such as images=[photo.jpeg]")
        if key not in known:
            raise ConfigError(f"unknown key {key!r}: {hint(key, known)}")
        if key in values:
            raise ConfigError(f"{key} is given twice: leave one out")
        texts = _text_only(known[key])
        if text.startswith("[") and text.endswith("]"):
            values[key] = [_value(item, texts) for item in _items(word, text[1:-1])]
        else:
            values[key] = _value(text, texts)
    return values


def keys() -> list[str]:
    """Return the keys of the command."""
    return list(fields_of(Localize))


def _items(word: str, inside: str) -> Iterator[str]:
    at = 0
    while at < len(inside.rstrip()):
        found = _ITEM.match(inside, at)
        if found is None:
            raise ConfigError(f"the list in {word!r} cannot be read: put texts with other signs in quotes, ['a, b']")
        yield found[1]
        at = found.end()


def _value(text: str, texts: bool) -> Any:
    text = text.strip()
    if len(text) > 1 and text[0] == text[-1] and text[0] in "'\"":
        return re.sub(r"\\(.)", r"\1", text[1:-1])
    if text in ("null", "None"):
        return None
    if texts:  # a folder may be called 2024
        return text
    if re.fullmatch(r"[-+]?\d+", text):
        return int(text)
    return _PLAIN.get(text, text)


def _text_only(kind: Any) -> bool:
    """Say whether values of an annotation are texts, or lists of them."""
    if kind in (str, Path):
        return True
    return any(_text_only(part) for part in get_args(kind))


def _suggestion() -> str:
    try:
        return f"run=FOLDER, such as run={newest_run().folder}, the newest one"
    except ConfigError:
        return "run=FOLDER"
