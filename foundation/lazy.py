"""Public names of a package that are loaded on first use, so that importing the package stays light.

What is not installed is named with the extra that has it.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import lazy_loader

from foundation.extras import lacking


def lazy(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return the `__getattr__`, `__dir__` and `__all__` of a package, whose public names its `__init__.pyi` lists.

    The modules of the package can be reached without importing them first, too.

    Args:
        package: the name of the package.
        file: the path of its `__init__.py`.
    """
    load, names, public = lazy_loader.attach_stub(package, file)

    def loaded(name: str) -> Any:
        try:
            if name not in public and not name.startswith("_") and find_spec(f"{package}.{name}") is not None:
                return import_module(f"{package}.{name}")
            return load(name)
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError(lacking(error) or str(error), name=error.name) from error

    return loaded, names, public
