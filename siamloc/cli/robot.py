"""`siamloc localize` and `siamloc live`, which run without torch and read their arguments without Hydra."""

from __future__ import annotations

import math
import re
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

from siamloc.errors import ConfigError, DataError, hint
from siamloc.runs import Run, newest_run
from siamloc.settings import Count, Pace, Port, Rule, Settings, Text, fields_of

if TYPE_CHECKING:
    from siamloc.runtime import Localizer

_ITEM = re.compile(r"""\s*('(?:[^'\\]|\\.)*'|"(?:[^"\\]|\\.)*"|[^,'"\[\]]*[^,'"\[\]\s])\s*(,|$)""")
_PLAIN = {"true": True, "false": False, "null": None}

Threads = Annotated[int, Rule("a whole number from 1 to 1,024", lambda value: 1 <= value <= 1024)]


@dataclass(frozen=True)
class Robot(Settings):
    """Settings that all commands for the robot share.

    Attributes:
        images: files, folders, videos, and cameras such as camera:0.
        run: the run whose bundle is used.
        bundle: another bundle.
        top: number of map frames to list for each image.
        track: follow the robot from image to image; each folder, video and camera is a drive.
        threads: number of onnxruntime threads; onnxruntime chooses if None.
        hierarchical: search the coarse layer first; if None, whenever the bundle has one.
    """

    images: tuple[Text, ...] | Text = ()
    run: Path | None = None
    bundle: Path | None = None
    top: Count = 3
    track: bool = False
    threads: Threads | None = None
    hierarchical: bool | None = None

    def localizer(self) -> Localizer:
        """Return the localizer, after making sure that images are given.

        Raises:
            ConfigError: neither a bundle nor a run is given, or no images.
        """
        if self.bundle is None and self.run is None:
            raise ConfigError(f"no bundle and no run given: give bundle=FOLDER, or {_suggestion()}")
        from siamloc.runtime import Localizer
        from siamloc.runtime.stream import named

        named(self.images)  # refused before the bundle is loaded
        bundle = self.bundle if self.bundle is not None or self.run is None else Run(self.run).bundle
        assert bundle is not None
        return Localizer(bundle, top=self.top, threads=self.threads, hierarchical=self.hierarchical)


@dataclass(frozen=True)
class Localize(Robot):
    """Settings of `siamloc localize`.

    Attributes:
        format: what is printed for each image: a readable line ("table"), a JSON line, or a CSV row.
        out: file of the locations, .csv or .jsonl; if None and `format` is "table", locations.csv next to the run's
            bundle, or in the current folder with `bundle`; otherwise no file.
        on_error: skip images that cannot be read, or stop at the first one.
    """

    format: Literal["table", "jsonl", "csv"] = "table"
    out: Path | None = None
    on_error: Literal["skip", "raise"] = "skip"

    @property
    def target(self) -> Path | None:
        """The file of the locations."""
        if self.out is not None or self.format != "table":
            return self.out
        return Path("locations.csv") if self.bundle is not None or self.run is None else self.run / "locations.csv"


def localize(words: Sequence[str]) -> int:
    """Locate images, and print each location as soon as it is known."""
    settings = Localize.of(values_of(words, Localize))
    localizer = settings.localizer()
    from siamloc.runtime import locate_all, written
    from siamloc.runtime.stream import LINES

    run = None if settings.run is None else Run(settings.run)
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
        except DataError:
            if count and target is not None:
                print(f"{count - faults} of {count} images located before this: {target}", file=sys.stderr)
            raise
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


@dataclass(frozen=True)
class Watch(Robot):
    """Settings of `siamloc live`.

    Attributes:
        host: address to listen on; 0.0.0.0 is all addresses of this machine.
        port: to listen on; 0 picks a free one.
        fps: images per second at most; 0 for full speed.
    """

    host: Text = "127.0.0.1"
    port: Port = 8000
    fps: Pace = 5.0


def live(words: Sequence[str]) -> int:
    """Locate images, and serve a page that shows the locations."""
    settings = Watch.of(values_of(words, Watch))
    localizer = settings.localizer()
    from siamloc.runtime import Live

    page = Live(
        localizer, settings.images, track=settings.track, host=settings.host, port=settings.port, fps=settings.fps
    )
    if settings.host not in ("127.0.0.1", "localhost", "::1"):
        print(f"everybody who can reach {settings.host} can watch: leave host out to keep it on this machine")
    with page:
        print(f"{page.url} shows where the robot is; Ctrl-C stops it", flush=True)
        try:
            page.join()
            print(f"{page.count} images, all done: the page stays until Ctrl-C", flush=True)
            while True:
                time.sleep(60)
        except KeyboardInterrupt:
            return 130
        except DataError:
            time.sleep(1)  # so that the page can show the reason as well
            raise


def values_of(words: Sequence[str], kind: type[Settings]) -> dict[str, Any]:
    """Read words such as "images=[a.jpeg,'b (1).jpeg']" as the values of a settings class.

    Raises:
        ConfigError: a word that is not key=value, an unknown key, a key that is given twice, or a list that cannot be
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


def keys(command: str) -> list[str]:
    """Return the keys of a command."""
    return list(fields_of({"localize": Localize, "live": Watch}[command]))


def _items(word: str, inside: str) -> Iterator[str]:
    at = 0
    while at < len(inside.rstrip()):
        found = _ITEM.match(inside, at)
        if found is None:
            raise ConfigError(f"the list in {word!r} cannot be read: put texts with other symbols in quotes, ['a, b']")
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
    if re.fullmatch(r"[-+]?\d{1,300}", text, re.ASCII):
        return int(text)
    if re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", text, re.ASCII):
        return float(text)
    return _PLAIN.get(text, text)


def _text_only(kind: Any) -> bool:
    """Whether values of an annotation are texts, or lists of texts."""
    if kind in (str, Path):
        return True
    return any(_text_only(part) for part in get_args(kind))


def _suggestion() -> str:
    try:
        return f"run=FOLDER, such as run={newest_run().folder}, the newest one"
    except ConfigError:
        return "run=FOLDER"
