"""Read words such as "images=[a.jpeg,'b (1).jpeg']" without Hydra, for the commands of the robot."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, get_args

from foundation.errors import known
from foundation.settings import fields_of
from foundation.words import unquoted
from siamloc.errors import ConfigError
from siamloc.jobs.job import Job

_ITEM = re.compile(r"""\s*('(?:[^'\\]|\\.)*'|"(?:[^"\\]|\\.)*"|[^,'"\[\]]*[^,'"\[\]\s])\s*(,|$)""")
_PLAIN = {"true": True, "false": False, "null": None}


def values_of(words: Sequence[str], kind: type[Job]) -> dict[str, Any]:
    """Read words such as "images=[a.jpeg,'b (1).jpeg']" as the values of a job.

    Raises:
        ConfigError: a word that is not key=value, an unknown key, a key that is given twice, or a list that cannot be
            read.
    """
    kinds, values = dict(zip(kind.key_names(), fields_of(kind).values(), strict=True)), dict[str, Any]()
    for word in words:
        if not kinds:
            raise ConfigError(f"leave {word!r} out: this command has no settings")
        key, equals, text = word.lstrip("+").partition("=")
        if not equals:
            raise ConfigError(f"{word!r} is not of the form key=value, such as images=[photo.jpeg]")
        known(key, kinds, "key")
        if key in values:
            raise ConfigError(f"{key} is given twice: leave one out")
        texts = _text_only(kinds[key])
        if text.startswith("[") and text.endswith("]"):
            values[key] = [_value(item, texts) for item in _items(word, text[1:-1])]
        else:
            values[key] = _value(text, texts)
    return values


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
    if (inside := unquoted(text)) != text:
        return inside
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
    return kind in (str, Path) or any(map(_text_only, get_args(kind)))
