"""`Learned`: plain values that were learned on a map, stored in a JSON file next to it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from foundation.calls import typed
from foundation.files import check_version, read_json, write_json
from foundation.settings import Settings
from siamloc.errors import FormatError

if TYPE_CHECKING:
    from siamloc.maps.visual_map import VisualMap

Kind = TypeVar("Kind", bound="Learned")


class Learned(Settings):
    """Base of dataclasses of plain values learned on a map, with a field `map_digest`; types are checked.

    Attributes:
        FORMAT: name by which a stored file is recognized, such as "siamloc-error-model".
        VERSION: version of the stored fields; files of other versions are refused.
        NOUN: name of the class in messages, such as "error model".
        map_digest: digest of the map's frames with positions, on which the values were learned.
    """

    FORMAT: ClassVar[str]
    VERSION: ClassVar[int]
    NOUN: ClassVar[str]
    map_digest: str

    def learned_on(self, known: VisualMap) -> bool:
        """Whether the values were learned on the frames of a map that have a position."""
        return bool(known.frames.has_position.any()) and self.map_digest == known.placed().digest

    def as_dict(self) -> dict[str, Any]:
        """Return the fields as plain values, with format and version."""
        return {"format": self.FORMAT, "version": self.VERSION, **self.plain()}

    @classmethod
    def from_dict(cls: type[Kind], values: Any, source: str | None = None) -> Kind:
        """Create an instance from what `as_dict` returned.

        Args:
            values: plain values, as read from JSON.
            source: name of the values' origin, such as a path, for error messages.

        Raises:
            FormatError: values of another kind, or of another version.
        """
        source = f"the {cls.NOUN}" if source is None else source
        if not isinstance(values, Mapping) or values.get("format") != cls.FORMAT:
            raise FormatError(f"{source} is not a siamloc {cls.NOUN}: make it with `siamloc evaluate`")
        check_version(values.get("version"), cls.VERSION, source, "make it again")
        try:
            return cls.of({key: value for key, value in values.items() if key not in ("format", "version")})
        except ValueError as error:
            raise FormatError(f"{source} is not a whole {cls.NOUN} ({error}): make it again") from error

    @typed
    def save(self, path: str | Path) -> None:
        """Write the values as JSON, atomically.

        Raises:
            StorageError: the disk is full or cannot be written to.
        """
        write_json(path, self.as_dict())

    @classmethod
    @typed
    def load(cls: type[Kind], path: str | Path) -> Kind:
        """Read what `save` wrote.

        Raises:
            FormatError: the file is missing, truncated, of another kind, or of another version.
        """
        return cls.from_dict(read_json(path), str(path))

    @classmethod
    def saved(cls: type[Kind], path: str | Path, known: VisualMap | None = None) -> Kind | None:
        """Read what `save` wrote; None if the file is missing or, if a map is given, was not learned on it.

        Raises:
            FormatError: the file is truncated, of another kind, or of another version.
        """
        if not Path(path).is_file():
            return None
        found = cls.load(path)
        return found if known is None or found.learned_on(known) else None
