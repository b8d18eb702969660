"""Settings: the names, types and ranges of the arguments of a call, defined once.

A group of settings is a frozen dataclass. Its annotations say what each value may be. They are checked when the object
is created, and a mistake gives a one-sentence error. The same class gives a function its keywords
(`foundation.calls.takes`) and the command line its defaults (`defaults_of`).

    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True)
    ... class Filter(Settings):
    ...     WHERE = "task.filter"
    ...     window: Count = 5
    ...     share: Share | None = None
    >>> Filter(window=7)
    Filter(window=7, share=None)
    >>> Filter(window=0)
    Traceback (most recent call last):
    foundation.errors.ConfigError: task.filter.window must be a whole number from 1 to 10 million, got 0
"""

from __future__ import annotations

import dataclasses
import types
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import SequenceMatcher
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from foundation.errors import ConfigError, hint
from foundation.files import expanded, plain

Result = TypeVar("Result")
Kind = TypeVar("Kind", bound="Settings")


@dataclass(frozen=True)
class Rule:
    """A condition on a value beyond its type.

    Attributes:
        words: what is expected, replacing the description of the type.
        holds: returns whether a value of the right type is valid.
    """

    words: str
    holds: Callable[[Any], bool]


LARGEST = 10**10
"""Largest absolute value of any number in a setting; whole numbers have rules of their own."""
SMALLEST = 1e-12
"""Smallest value of a `Positive`: dividing by anything smaller would give numbers too large to calculate with."""

Natural = Annotated[int, Rule("a whole number from 0 to 10 million", lambda value: 0 <= value <= 10_000_000)]
Count = Annotated[int, Rule("a whole number from 1 to 10 million", lambda value: 1 <= value <= 10_000_000)]
Thousand = Annotated[int, Rule("a whole number from 1 to 1,000", lambda value: 1 <= value <= 1000)]
Seed = Annotated[int, Rule("a whole number from 0 to 4,294,967,295", lambda value: 0 <= value < 2**32)]
Positive = Annotated[float, Rule("a number above 0", lambda value: value >= SMALLEST)]
NotNegative = Annotated[float, Rule("a number from 0", lambda value: value >= 0)]
Share = Annotated[float, Rule("a number from 0 to 1", lambda value: 0 <= value <= 1)]
Probability = Annotated[float, Rule("a number between 0 and 1", lambda value: 0 < value < 1)]
Size = Annotated[
    tuple[Count, Count],
    Rule("[rows, columns], each from 1 to 16,384 pixels", lambda value: max(value) <= 16_384),
]
Text = Annotated[str, Rule("a text that is not empty", lambda value: bool(value.strip()))]
Workers = Annotated[int, Rule("a whole number from 0 to 1,024", lambda value: 0 <= value <= 1024)]
Pace = Annotated[float, Rule("0, or a number from 0.001 to 1,000", lambda value: value == 0 or 0.001 <= value <= 1000)]
Port = Annotated[int, Rule("a whole number from 0 to 65,535", lambda value: 0 <= value <= 65_535)]


class _Named(type):
    def __getattr__(cls, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return _Named(name, (Absent,), {})


class Absent(metaclass=_Named):
    """Stand-in for a class that is not loaded: a value is an instance if one of its bases has that name."""


class Settings:
    """Base of a group of settings: a frozen dataclass whose fields are checked on creation.

    Attributes:
        WHERE: name of the group on the command line, such as "pairs"; error messages put it before the key.
        ERROR: class of the errors that values raise.
    """

    WHERE: ClassVar[str] = ""
    ERROR: ClassVar[type[Exception]] = ConfigError

    def __post_init__(self) -> None:
        for name, kind in fields_of(type(self)).items():
            object.__setattr__(self, name, checked(getattr(self, name), kind, self._key(name), self.ERROR))

    @classmethod
    def of(cls: type[Kind], values: Mapping[str, Any]) -> Kind:
        """Make the settings from plain values, such as those of a configuration file; missing ones get their defaults.

        Raises:
            ConfigError: an unknown key, with the nearest valid one; a missing key without a default; or a value of the
                wrong type or out of range.
        """
        known = fields_of(cls)
        for key in values:
            if key not in known:
                raise cls.ERROR(f"unknown key {cls._key(str(key))}: {hint(str(key), known)}")
        for field in dataclasses.fields(cls):  # type: ignore[arg-type]
            if field.name not in values and default_of(field) is dataclasses.MISSING:
                key = cls._key(field.name)
                raise cls.ERROR(f"{key} is not set: give it as {key}=VALUE")
        return cls(**values)

    def plain(self) -> dict[str, Any]:
        """Return the settings as plain values, which `of` can read."""
        return {name: plain(getattr(self, name)) for name in fields_of(type(self))}

    def narrowed(self, kind: type[Kind]) -> Kind:
        """Return the settings of a base class: without the fields that only this class and its groups have."""
        values = {name: getattr(self, name) for name in fields_of(kind)}
        for name, part in fields_of(kind).items():
            if isinstance(part, type) and issubclass(part, Settings):
                values[name] = values[name].narrowed(part)
        return kind(**values)

    @classmethod
    def _key(cls, name: str) -> str:
        return f"{cls.WHERE}.{name}" if cls.WHERE else name


def fields_of(kind: type) -> dict[str, Any]:
    """Return the names of a settings class's fields with their annotations."""
    hints = _hints(kind)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind)}


_hints: Callable[[Any], dict[str, Any]] = cache(partial(get_type_hints, include_extras=True))


def defaults_of(kind: type[Settings]) -> dict[str, Any]:
    """Return the defaults of a settings class as plain values; fields without one are left out."""
    values = {field.name: default_of(field) for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    return {name: plain(value) for name, value in values.items() if value is not dataclasses.MISSING}


def checked(value: Any, kind: Any, key: str, error: type[Exception] = ConfigError) -> Any:
    """Return a value in the form of its annotation: lists become tuples, numpy numbers and arrays plain values.

    Args:
        value: the value.
        kind: annotation that the value must fit, such as `Positive` or `tuple[int, int]`.
        key: name of the value in the error message.
        error: class of the error.

    Raises:
        ConfigError: naming the key, what it should be, and what it is; or another `error`.
    """
    if wrong := complaint(value, kind):
        raise error(f"{key} {wrong}")
    return _fit(value, kind)[1]


def complaint(value: Any, kind: Any) -> str:
    """Return the end of a sentence about a value that does not fit its annotation; an empty text if it fits.

    >>> complaint(-1, Positive)
    'must be a number above 0, got -1'
    """
    if _fit(value, kind)[0]:
        return ""
    only_too_large = _beyond(value) and _fit(_within(value), kind)[0]
    most = f", at most {LARGEST:,} in size" if only_too_large else ""
    only_too_small = isinstance(value, float) and 0 < value < SMALLEST and _fit(SMALLEST, kind)[0]
    least = f", at least {SMALLEST:g}" if only_too_small else ""
    numbers = isinstance(value, list | tuple) and any(type(one) in (int, float) for one in value)
    texts = numbers and _fit([str(one) for one in value], kind)[0]
    quotes = ": put texts that look like numbers in quotes, such as '[\"2024_01_05\"]'" if texts else ""
    return f"must be {words_for(kind)}{most or least}, got {shortened(repr(value))}{quotes}"


def misfit(values: Mapping[str, Any], kinds: Mapping[str, Any], prefix: str = "") -> str | None:
    """Return the dotted name of the first value in a file that does not fit its annotation; None if all fit.

    Args:
        values: content of the file; it may have more keys.
        kinds: annotations by key; for a mapping inside the mapping, annotations of its keys.

    >>> misfit({"name": "a", "size": {"rows": 2.5}}, {"name": str, "size": {"rows": int}})
    'size.rows'
    """
    for key, kind in kinds.items():
        value, name = values.get(key), prefix + key
        if complaint(value, Mapping if isinstance(kind, Mapping) else kind):
            return name
        if isinstance(kind, Mapping) and (inner := misfit(value or {}, kind, f"{name}.")):
            return inner
    return None


def merged(values: Mapping[str, Any], others: Mapping[str, Any]) -> dict[str, Any]:
    """Return nested values with other values merged over them; paths, alone and in lists, become texts."""
    result = dict(values)
    for key, value in others.items():
        if isinstance(value, Mapping):
            before = result.get(key)
            result[key] = merged(before if isinstance(before, Mapping) else {}, value)
        else:
            result[key] = _without_paths(value)
    return result


def _without_paths(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return [_without_paths(item) for item in value]
    return str(value) if isinstance(value, Path) else value


def within(key: str, sections: Iterable[str]) -> bool:
    """Return whether a dotted key is the name of a section, or of a part of one.

    Example:
        >>> within("model.branch.name", ["data", "model"]), within("models", ["model"])
        (True, False)
    """
    return any(key == section or key.startswith(f"{section}.") for section in sections)


def leaves(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the dotted key and the value of each leaf of nested values."""
    for key, value in values.items():
        if isinstance(value, Mapping) and value:
            yield from leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def shortened(text: str, most: int = 120) -> str:
    """Put a text on one line for an error message: a long one is cut in the middle.

    >>> shortened("x" * 200, 20)
    'xxxxxxxx ... xxxxxxx'
    """
    text = " ".join(text.split())
    if len(text) <= most:
        return text
    left = (most - 4) // 2
    return f"{text[:left]} ... {text[len(text) - (most - 5 - left) :]}"


def words_for(kind: Any) -> str:
    """Describe the values that an annotation allows, for an error message."""
    origin, parts = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return next((part.words for part in parts[1:] if isinstance(part, Rule)), words_for(parts[0]))
    if origin in (Union, types.UnionType):
        return ", or ".join(dict.fromkeys(map(words_for, parts)))
    if origin is Literal:
        return " or ".join(str(part) for part in parts)
    if origin in _LISTS:
        if origin is tuple and parts[-1] is not Ellipsis:
            return f"a list of {len(parts)}: {', '.join(words_for(part) for part in parts)}"
        return f"a list, each item {words_for(parts[0])}"
    if origin is Callable:
        return "a function"
    if getattr(origin, "__module__", "") == "numpy":
        return "an array"
    if origin in (dict, Mapping) or kind in (dict, Mapping):
        return "a mapping of keys to values"
    if isinstance(kind, type) and issubclass(kind, Settings):
        return f"a group with the keys {', '.join(fields_of(kind))}"
    name = getattr(kind, "__name__", str(kind))
    return _WORDS.get(kind, f"{'an' if name[0] in 'AEIOU' else 'a'} {name}")


_LISTS = (tuple, list, Sequence)
_WORDS = {
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    str: "a text",
    Path: "a path",
    type(None): "null",
}


def _fit(value: Any, kind: Any) -> tuple[bool, Any]:
    """Return whether a value fits an annotation, and the value in that form."""
    origin, parts = get_origin(kind), get_args(kind)
    if kind is Any:
        return True, value
    if origin is Annotated:
        fits, found = _fit(value, parts[0])
        return fits and all(rule.holds(found) for rule in parts[1:] if isinstance(rule, Rule)), found
    if origin in (Union, types.UnionType):
        for part in _by_keys(parts, value):
            fits, found = _fit(value, part)
            if fits:
                return True, found
        return False, value
    if isinstance(origin, type) and origin not in (*_LISTS, dict, Mapping):
        return isinstance(value, origin), value  # an array, a function: its contents cannot be checked
    if type(value).__module__ == "numpy" and hasattr(value, "tolist"):
        if value.ndim and kind in (str, Path):
            return False, value  # without a list of all its pixels
        value = value.tolist()
    if origin is Literal:
        return any(type(value) is type(part) and value == part for part in parts), value
    if origin in _LISTS:
        return _fit_list(value, origin, parts)
    if origin in (dict, Mapping) or kind in (dict, Mapping):
        return isinstance(value, Mapping), dict(value) if isinstance(value, Mapping) else value
    if isinstance(kind, type) and issubclass(kind, Settings):
        return (True, kind.of(value)) if isinstance(value, Mapping) else (isinstance(value, kind), value)
    return _fit_plain(value, kind)


def _by_keys(parts: tuple[Any, ...], value: Any) -> list[Any]:
    """Return the types that a value may have; of several groups of settings only the one that knows most of its keys.

    In a tie, it is the group whose keys look most like the unknown ones.
    """
    groups = [part for part in parts if isinstance(part, type) and issubclass(part, Settings)]
    if len(groups) < 2 or not isinstance(value, Mapping):
        return list(parts)

    def known(group: type[Settings]) -> tuple[int, float]:
        names = fields_of(group)
        alike = (max(SequenceMatcher(None, str(key), name).ratio() for name in names) for key in value)
        return len(set(value) & set(names)), sum(alike)

    best = max(groups, key=known)
    return [part for part in parts if part is best or part not in groups]


def _fit_list(value: Any, origin: Any, parts: tuple[Any, ...]) -> tuple[bool, Any]:
    if isinstance(value, str | bytes) or not isinstance(value, Sequence):
        return False, value
    fixed = origin is tuple and parts[-1] is not Ellipsis
    kinds = parts if fixed else [parts[0]] * len(value)
    if len(kinds) != len(value):
        return False, value
    found = [_fit(item, kind) for item, kind in zip(value, kinds, strict=True)]
    return all(fits for fits, _ in found), tuple(item for _, item in found)


def _fit_plain(value: Any, kind: Any) -> tuple[bool, Any]:
    if getattr(kind, "_is_protocol", False):  # any object that can do the same
        return value is not None and not isinstance(value, str | bytes | int | float | list | tuple | Mapping), value
    if isinstance(kind, type) and issubclass(kind, Absent):
        return any(one.__name__ == kind.__name__ for one in type(value).__mro__), value
    if isinstance(value, bool) and kind is not bool:
        return False, value
    if kind is float:
        return isinstance(value, int | float) and not _beyond(value), value
    if kind is Path and isinstance(value, str):
        return bool(value.strip()), expanded(value)
    return not isinstance(kind, type) or isinstance(value, kind), value


def _beyond(value: Any) -> bool:
    """Whether a value, or an item of a list, is a number that cannot be calculated with: too large, or NaN."""
    if isinstance(value, list | tuple):
        return any(map(_beyond, value))
    return isinstance(value, int | float) and not abs(value) <= LARGEST


def _within(value: Any) -> Any:
    """Return a value with each number clipped to the largest allowed size."""
    if isinstance(value, list | tuple):
        return [_within(item) for item in value]
    if not isinstance(value, int | float) or value != value:
        return value
    return type(value)(min(max(value, -LARGEST), LARGEST))


def default_of(field: dataclasses.Field[Any]) -> Any:
    """Return the default of a field; dataclasses.MISSING if it has none."""
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return field.default
