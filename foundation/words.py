"""Write settings as the words of a command line, and read such words."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def as_words(values: Mapping[str, Any]) -> str:
    """Write settings as words of a command line, in quotes where the shell or the reading of values needs them.

    Example:
        >>> print(as_words({"data.root": "my data", "protocol.leave_one_out": True}))
        'data.root=my data' protocol.leave_one_out=true
        >>> print(as_words({"run": "runs/a (1)", "images": ["b, c.jpg"]}))
        'run="runs/a (1)"' 'images=["b, c.jpg"]'
    """
    return shlex.join([f"{key}={_in_words(value)}" for key, value in values.items()])


def _in_words(value: Any, bare: bool = True) -> str:
    if isinstance(value, list | tuple):
        return f"[{', '.join(_in_words(item, bare=False) for item in value)}]"
    if not isinstance(value, str | Path):
        return json.dumps(value, ensure_ascii=False)
    text = str(value)
    if bare and _BARE.fullmatch(text) and not _NO_TEXT.fullmatch(text):
        return text
    return quoted(text)


_BARE = re.compile(r"[\w./:@%*?+-]([\w ./:@%*?+-]*[\w./:@%*?+-])?")
_NO_TEXT = re.compile(r"None|(?i:null|true|false|[+-]?(nan|inf|[\d_.]+(e[+-]?[\d_]+)?))")
"""Texts that a command line reads as numbers and other values."""


def quoted(text: object) -> str:
    """Quote a text so that a command line reads it as one value, whatever characters it holds.

    Backslashes are doubled only before a quote, as Hydra reads them, and before what would name another value.
    """
    text = re.sub(r"(\\*)\$\{", r"\1\1\\${", str(text))
    return '"' + re.sub(r'(\\+)(?="|\Z)', r"\1\1", text).replace('"', '\\"') + '"'


def unquoted(text: str) -> str:
    """Return the text that a value of a command line stands for, with quotes or without."""
    text = text.strip()
    if len(text) < 2 or text[0] != text[-1] or text[0] not in "'\"":
        return text
    return re.sub(rf"(\\+)(?={text[0]}|\Z|\$\{{)", lambda found: "\\" * (len(found[1]) // 2), text[1:-1])
