"""The order of names with numbers in them."""

from __future__ import annotations

import re
from decimal import Decimal
from pathlib import Path
from typing import Any


def by_numbers(path: Path) -> list[Any]:
    """Return what sorts paths by the numbers in their names, and those with equal numbers, such as 1 and 01, as texts.

    Example:
        >>> [path.name for path in sorted([Path("bins-16"), Path("bins-4")], key=by_numbers)]
        ['bins-4', 'bins-16']
    """
    split = [(re.split(r"(\d+(?:\.\d+)?)", name), name) for name in path.parts]
    return [
        ([(Decimal(part), "") if place % 2 else (Decimal(0), part) for place, part in enumerate(parts)], name)
        for parts, name in split
    ]
