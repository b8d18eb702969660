"""`fetch`: load archives of a public data set, check them, and unpack them into the layout that its reader knows."""

from __future__ import annotations

import sys
import tarfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from http.client import HTTPException
from pathlib import Path
from typing import BinaryIO, Literal
from urllib.error import HTTPError, URLError
from urllib.parse import urlsplit
from urllib.request import Request, urlopen

from foundation.calls import typed
from foundation.files import (
    expanded,
    file_hash,
    first_names,
    read_text,
    real_path,
    scratch_folder,
    storage_errors,
    write_text,
)
from foundation.locks import alone
from foundation.settings import Count, Positive, shortened
from siamloc.data.archives import ADDRESS, Archive, archives
from siamloc.data.cold import CAMERAS, Stored, stored
from siamloc.data.names import BUILDINGS, name_sequence
from siamloc.data.protocol import ROLES, Protocol
from siamloc.errors import ConfigError, DataError, logger
from siamloc.progress import track

SUMS = "SHA256SUMS"
"""File next to the sequences with the check sum of each fetched archive, which `sha256sum --check` reads."""
_LATER = (408, 425, 429)  # besides 500 and above: the server asks for another attempt
_LONGEST_PAUSE = 30.0  # s, between two attempts
_BLOCK = 1 << 18
_SMALL = 10_000_000  # bytes, below which progress counts kB


class _Broken(Exception):
    """A connection that ended early; the next attempt continues."""


class _Unreachable(DataError):
    """No attempt reached the server at all: it will not answer for other files either."""


@dataclass(frozen=True)
class Fetched:
    """Which sequences are there.

    Attributes:
        folder: the database, which `siamloc.data.read("cold", root=folder)` reads.
        there: number of frames of each sequence in the folder.
        missing: sequences that are not in the folder as a whole.
        notes: a sentence for each peculiarity of a sequence, such as another number of frames than expected, or images
            that are missing.
    """

    folder: Path
    there: dict[str, int]
    missing: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def table(self) -> str:
        """Return a line for each sequence."""
        lines = [f"{name}: {count} frames" for name, count in self.there.items()]
        return "\n".join([*lines, *(f"{name}: missing" for name in self.missing)])


@typed
def fetch(
    kind: Literal["cold"] = "cold",
    sequences: str | Sequence[str] | Protocol = (),
    out: str | Path = "data/COLD",
    *,
    mirror: str = ADDRESS,
    keep: bool = False,
    only_list: bool = False,
    timeout: Positive = 60.0,
    tries: Count = 5,
) -> Fetched:
    """Load sequences of a data set that are not in a folder yet, check them, and unpack them.

    A sequence is there if the folder holds it with a list `places.lst` and the listed images, in any layout that
    `read("cold")` knows. Nothing that lies in the place of another one is replaced. A download that breaks is
    continued, also by a later call. An archive is used if it has the announced size, holds nothing but files and
    folders inside its own folder, and this one sequence as a whole; one that fails these checks is kept, unless what
    was loaded is no tar archive at all, such as a page that asks to log in.

    Args:
        kind: the data set: "cold".
        sequences: names or shell patterns such as "freiburg_a_seq2_*"; or a protocol of COLD, for the sequences of its
            roles, whose patterns begin with a building.
        out: folder of the database. Archives that already lie there, as `cold-freiburg/part_a/seq2_cloudy3.tar`, are
            unpacked without loading them.
        mirror: address of the database, or of a copy with the same folders.
        keep: whether to keep the archives next to the folders.
        only_list: whether to load nothing, and only return which sequences are there.
        timeout: seconds without any data after which an attempt ends.
        tries: number of attempts in a row that bring nothing before it gives up.

    Returns:
        Which sequences are there. `SHA256SUMS` in the folder has the check sums of the archives.

    Raises:
        ConfigError: no sequences, one that the data set does not have, a protocol whose names or patterns do not
            begin with a building of it, or an address that is not http or https.
        DataError: archives that are not at the address, cannot be loaded, or fail the checks, or places that hold
            something else; all others are fetched.
        StorageError: the disk is full or refuses.
    """
    wanted = archives(_names(sequences))
    folder = expanded(out)
    if not _is_address(mirror):
        raise ConfigError(f"mirror must be an address such as {ADDRESS}, got {mirror!r}")
    lost: dict[str, str] = {}
    there, blocked, twice = _inventory(folder, wanted)
    absent = [] if only_list else [one for one in wanted if one.sequence not in there]
    absent.sort(key=lambda one: one.sequence not in blocked)  # what is in the way is said before the loading
    if absent:
        with alone(folder):
            unreachable = ""
            for one in absent:
                if unreachable and not (folder / f"{one.folder}.tar").is_file():
                    lost[one.sequence] = unreachable
                    continue
                try:
                    if one.sequence in blocked:
                        raise DataError(blocked[one.sequence])
                    _obtain(one, folder, f"{mirror.rstrip('/')}/{one.folder}.tar", keep, timeout, tries)
                except DataError as error:  # the others may still be there
                    lost[one.sequence] = str(error)
                    if len(wanted) > 1:
                        logger.warning("%s cannot be fetched: %s", one.sequence, error)
                    unreachable = str(error) if isinstance(error, _Unreachable) else ""
        there, _, twice = _inventory(folder, wanted)
    if lost:
        names = shortened(", ".join(lost), 200)
        what = f"{len(lost)} of {len(wanted)} sequences could not be fetched ({names}): " if len(wanted) > 1 else ""
        raise DataError(f"{what}{next(iter(lost.values()))}")
    notes = [
        f"{one.sequence} has {there[one.sequence]} frames, and {one.frames} are known from the literature"
        for one in wanted
        if one.frames is not None and there.get(one.sequence, one.frames) != one.frames
    ]
    missing = [one.sequence for one in wanted if one.sequence not in there]
    return Fetched(folder, there, missing, [*notes, *blocked.values(), *twice])


def _is_address(mirror: str) -> bool:
    try:
        return urlsplit(mirror).scheme in ("http", "https")
    except ValueError:  # brackets that hold no address
        return False


def _names(sequences: str | Sequence[str] | Protocol) -> list[str]:
    if isinstance(sequences, Protocol):
        found = list(dict.fromkeys(name for role in ROLES for name in getattr(sequences, role).sequences or ()))
        if others := [name for name in found if not name.startswith(BUILDINGS)]:
            raise ConfigError(
                f"the protocol takes {others[0]!r}, which begins with no building of COLD ({', '.join(BUILDINGS)}): "
                "choose another, such as protocol=freiburg, or give sequences=[...]"
            )
    else:
        found = [sequences] if isinstance(sequences, str) else list(sequences)
    if not found:
        raise ConfigError("no sequences given: name them, as sequences=[freiburg_a_seq2_cloudy3], or a protocol")
    return found


def _inventory(folder: Path, wanted: list[Archive]) -> tuple[dict[str, int], dict[str, str], list[str]]:
    """Return the number of frames of each sequence that is there.

    Also returns a sentence for each sequence whose place is taken, and for each that is there but appears twice.
    """
    whole_last = sorted(stored(folder), key=lambda held: not held.lack)
    found = {held.name.sequence: held for held in whole_last}
    there: dict[str, int] = {}
    blocked: dict[str, str] = {}
    twice: list[str] = []
    for one in wanted:
        place, held = folder / one.folder, found.get(one.sequence)
        if held is not None and not held.lack:
            there[one.sequence] = held.frames
            twice += [
                f"sequence {one.sequence} appears twice, as {_place(held)} and as {_place(copy)}: remove one, or "
                "data=cold refuses both"
                for copy in whole_last
                if copy.name.sequence == one.sequence and copy is not held and _share_camera(copy, held)
            ]
        elif held is not None:
            blocked[one.sequence] = f"{_place(held)} {held.lack}"
        elif place.is_file():
            blocked[one.sequence] = f"{place} is a file"
        elif place.is_dir() and (names := first_names(place)):
            blocked[one.sequence] = f"{place} holds {names}, and no sequence"
    advice = "it is not replaced; move it away, or choose another folder with out="
    return there, {name: f"{what}: {advice}" for name, what in blocked.items()}, twice


def _place(held: Stored) -> Path | None:
    return held.folder if held.folder.is_dir() else held.list


def _share_camera(first: Stored, second: Stored) -> bool:
    """Return whether there is a camera for which the reader takes both copies of a sequence."""
    cameras = [{name for name in CAMERAS if (held.folder / name).is_dir()} for held in (first, second)]
    return not all(cameras) or bool(set.intersection(*cameras))


def _obtain(one: Archive, out: Path, address: str, keep: bool, timeout: float, tries: int) -> None:
    """Load an archive, unless it lies in the folder, unpack it, and note its check sum."""
    folder = out / one.folder
    archive, part = (folder.with_name(f"{folder.name}.tar{end}") for end in ("", ".part"))
    loaded = not archive.is_file()
    if loaded:
        with storage_errors(part):
            folder.parent.mkdir(parents=True, exist_ok=True)
            _load(address, part, one.sequence, timeout, tries)
    source = part if loaded else archive
    try:
        _unpack(source, folder, one)
    except DataError as error:
        what = f"{address if loaded else archive} {error}"
        if loaded and not tarfile.is_tarfile(part):  # such as a page that asks to log in
            _discard(part)
            raise DataError(f"{what}: the same command loads it again") from error
        if loaded:
            part.replace(archive)
            _discard(part)
        raise DataError(f"{what}: not used; look at {archive}, and remove it to load it again") from error
    _note_sum(out / SUMS, f"{one.folder}.tar", file_hash(source))
    if loaded and keep:
        part.replace(archive)
    _discard(part)


def _load(address: str, part: Path, name: str, timeout: float, tries: int) -> None:
    """Load a file, attempt after attempt, each of which continues the one before.

    Raises:
        DataError: the server refuses, or several attempts in a row bring nothing.
    """
    failed, before, answered = 0, _size(part), False
    while True:
        try:
            _attempt(address, part, name, timeout)
            return
        except HTTPError as error:
            if error.code < 500 and error.code not in _LATER:
                raise DataError(
                    f"{address} cannot be fetched: the server answers {error.code} {error.reason}; give the address "
                    "of a mirror, or correct the table in siamloc/data/archives.py"
                ) from error
            answered, reason = True, f"the server answers {error.code} {error.reason}"
        except (_Broken, URLError, HTTPException, TimeoutError, ConnectionError) as error:
            answered |= not isinstance(error, URLError)
            reason = str(getattr(error, "reason", error)) or "the connection broke"
        failed = 0 if _size(part) > before else failed + 1
        before = _size(part)
        if failed >= tries:
            raise (DataError if answered else _Unreachable)(
                f"{address} cannot be fetched ({reason}): {before:,} bytes are here, and the same command continues"
            )
        pause = min(2.0**failed - 1, _LONGEST_PAUSE)
        print(f"fetching {name}: {reason}; trying again in {pause:.0f} s", file=sys.stderr, flush=True)
        time.sleep(pause)


def _attempt(address: str, part: Path, name: str, timeout: float) -> None:
    """Load the rest of a file.

    Raises:
        _Broken: the connection ended before the announced size.
        HTTPError, URLError, HTTPException, OSError: no answer, or a refusal.
    """
    have, validator = _size(part), _validator(part)
    headers = {"User-Agent": "siamloc", "Accept-Encoding": "identity"}
    if have:
        headers["Range"] = f"bytes={have}-"
        if validator.is_file() and (known := read_text(validator)):
            headers["If-Range"] = known  # a file that changed is sent from its beginning
    try:
        response = urlopen(Request(address, headers=headers), timeout=timeout)
    except HTTPError as error:
        if error.code != 416:
            raise
        if (error.headers.get("Content-Range") or "").endswith(f"/{have}"):
            return  # all of it is here
        _discard(part)
        raise _Broken("the file here is longer than the server's") from error
    with response:
        if (encoding := response.headers.get("Content-Encoding", "identity")) != "identity":
            raise DataError(
                f"{address} cannot be fetched: the server sends it encoded as {encoding}, and was asked for the file "
                "as it is; give the address of a mirror"
            )
        if response.status != 206:
            have = 0
            tag = response.headers.get("ETag") or ""  # a weak one begins with W and does not say that bytes are equal
            write_text(validator, tag if tag.startswith('"') else response.headers.get("Last-Modified") or "")
        elif not (response.headers.get("Content-Range") or "").startswith(f"bytes {have}-"):
            _discard(part)
            raise _Broken("the server sends another part of the file")
        rest = response.length
        with part.open("ab" if have else "wb") as file:
            size, unit = (1_000, "kB") if rest is not None and rest < _SMALL else (1_000_000, "MB")
            copied = _copied(response, file, size)
            for _ in track(copied, (rest or 0) // size, f"fetching {name}, {unit}", size=int):
                pass
    if rest is not None and _size(part) != have + rest:
        raise _Broken(f"{_size(part):,} of {have + rest:,} bytes arrived")


def _copied(response: BinaryIO, file: BinaryIO, size: int) -> Iterator[int]:
    """Copy a response to a file, and yield how many full units of this size each piece completes."""
    done = 0
    while block := _read(response):
        file.write(block)
        yield (done + len(block)) // size - done // size
        done += len(block)


def _read(response: BinaryIO) -> bytes:
    try:
        return response.read1(_BLOCK)  # type: ignore[attr-defined, no-any-return]
    except OSError as error:  # not one of the disk
        raise _Broken(error.strerror or str(error) or "the connection broke") from error


def _size(path: Path) -> int:
    return path.stat().st_size if path.is_file() else 0


def _discard(part: Path) -> None:
    for path in (part, _validator(part)):
        path.unlink(missing_ok=True)


def _validator(part: Path) -> Path:
    """Return the file next to a part that keeps the ETag, or the date, of the server's file."""
    return part.with_name(f"{part.name}.etag")


def _unpack(archive: Path, folder: Path, one: Archive) -> None:
    """Unpack the archive of a sequence; nothing but the archive remains of one that fails a check.

    Raises:
        DataError: it is not a tar archive or cut short, leads out of its folder, or is not that of the whole sequence;
            the words follow its name.
    """
    folder = real_path(folder)
    with scratch_folder(folder) as scratch:
        try:
            with tarfile.open(archive, "r:") as tar:
                tar.extraction_filter = getattr(tarfile, "data_filter", None)  # since Python 3.10.12 and 3.11.4
                members = tar.getmembers()
                for member in members:
                    if not (member.isreg() or member.isdir()) or member.issparse():
                        raise DataError(f"holds {member.name}, which is neither a file nor a folder")
                    if not (scratch / member.name).resolve().is_relative_to(scratch.resolve()):
                        raise DataError(f"holds {member.name}, which lies outside of its own folder")
                files = [member for member in members if member.isreg()]  # their folders get the usual permissions
                for member in track(files, len(files), f"unpacking {folder.name}"):
                    tar.extract(member, scratch, set_attrs=False)
        except (tarfile.TarError, EOFError) as error:
            raise DataError(f"is not a whole tar archive ({error})") from error
        sequence = _checked(scratch, one)
        if folder.is_dir():
            folder.rmdir()  # which refuses if it is not empty
        sequence.replace(folder)


def _checked(scratch: Path, one: Archive) -> Path:
    """Return the folder of the sequence that was unpacked.

    Raises:
        DataError: there is none with a list, or several, or it is another one, or lacks images of the list.
    """
    found = [each for each in stored(scratch) if each.list is not None]
    if not found:
        raise DataError(f"holds no list localization/places.lst, but {first_names(scratch) or 'nothing'}")
    inside = ", ".join(sorted(each.folder.relative_to(scratch).as_posix() for each in found))
    if len(found) > 1:
        raise DataError(f"holds {len(found)} sequences: {shortened(inside)}")
    folder, _, name, _, lack = found[0]
    other_building = name.building.startswith(BUILDINGS) and not one.sequence.startswith(name.building)
    run = name_sequence(Path("/", inside), "", ()).sequence  # as the folders in the archive say, and not those above it
    if other_building or (run and not run.endswith(one.folder.rpartition("/")[2])):
        raise DataError(f"holds another sequence, {inside}")
    if lack:
        raise DataError(lack.replace(f"{scratch}/", ""))
    return folder


def _note_sum(path: Path, name: str, digest: str) -> None:
    lines = read_text(path).splitlines() if path.is_file() else []
    sums = {line.partition("  ")[2]: line for line in (*lines, f"{digest}  {name}")}
    write_text(path, "".join(f"{sums[file]}\n" for file in sorted(sums)))
