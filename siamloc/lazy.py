"""Public names of a package that are loaded on first use; what is not installed is named with the extra that has it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from foundation import lazy as plain
from siamloc.errors import lacking


def lazy(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return the `__getattr__`, `__dir__` and `__all__` of a package; see `foundation.lazy.lazy`."""
    load, names, public = plain.lazy(package, file)

    def loaded(name: str) -> Any:
        try:
            return load(name)
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError(lacking(error) or str(error), name=error.name) from error

    return loaded, names, public
