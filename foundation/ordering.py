"""The order of names with numbers in them."""

from __future__ import annotations

import re
from decimal import Decimal
from pathlib import Path
from typing import Any


def by_numbers(path: str | Path) -> list[Any]:
    """Return a sort key that orders paths by the numbers in their names; equal ones, such as 1 and 01, by their text.

    Example:
        >>> [path.name for path in sorted([Path("bins-16"), Path("bins-4")], key=by_numbers)]
        ['bins-4', 'bins-16']
    """
    split = [(re.split(r"(\d+(?:\.\d+)?(?:e[+-]\d{1,3}(?!\d))?)", name), name) for name in Path(path).parts]
    return [
        ([(Decimal(part), "") if place % 2 else (Decimal(0), part) for place, part in enumerate(parts)], name)
        for parts, name in split
    ]
