"""Public names of a package that are loaded on first use, so that importing the package stays light."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

from siamloc.errors import lacking


def lazy(package: str, homes: Mapping[str, str]) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return a package's `__getattr__` and `__dir__`.

    Args:
        package: its name.
        homes: the module of the package in which each name is defined; "" for names that are modules themselves.
    """

    def getattribute(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}", name=name)
        try:
            module = import_module(f"{package}.{homes[name] or name}")
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError(lacking(error) or str(error), name=error.name) from error
        return getattr(module, name) if homes[name] else module

    def names() -> list[str]:
        known = vars(import_module(package))
        return sorted({*known, *homes})

    return getattribute, names
