"""Calls from Python with nonsense arguments: every public function of siamloc's packages."""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any, get_origin

PACKAGES = ("data", "models", "training", "maps", "evaluation", "runtime", "report", "reproduce", "simulate", "runs")
_PLAIN: dict[str, tuple[type, ...]] = {
    "int": (int,),
    "float": (int, float),
    **dict.fromkeys(("Count", "Natural", "Seed", "Thousand", "Workers", "Port"), (int,)),
    **dict.fromkeys(("Positive", "NotNegative", "Share", "Probability", "Pace"), (int, float)),
    "bool": (bool,),
    **dict.fromkeys(("str", "Path", "Text"), (str,)),
    "dict": (Mapping,),
    "Mapping": (Mapping,),
    **dict.fromkeys(("list", "tuple", "Sequence", "Counts", "Radii", "Size"), (list,)),
    "None": (type(None),),
}
_NOT_TOLD = (
    "Any",
    "ArrayLike",
    "Iterable",
    "Callable",
    "Literal",
    "Baselines",
    "Loss",
    "Augment",
    "Precision",
    "Roles",
)
"""Parts of annotations that do not say which plain values are nonsense."""


def call_cases(strange: Mapping[str, Any]) -> Iterator[tuple[str, Callable[[], Any], bool]]:
    """Yield each argument of each public call with each strange value, without the others, and whether it is nonsense.

    Which values are nonsense follows from the text of the annotation. A call that takes the value then lacks its other
    arguments; Python's error about them counts as acceptance. Calls that need no other arguments are not tried.
    """
    for name, function in public_calls():
        needed = [one.name for one in _parameters(function) if one.default is one.empty]
        for parameter in _parameters(function):
            if not [other for other in needed if other != parameter.name]:
                continue
            for value in strange.values():

                def called(function: Any = function, key: str = parameter.name, value: Any = value) -> None:
                    try:
                        function(**{key: value})
                    except TypeError as error:
                        if "missing" not in str(error):
                            raise

                yield f"{name}({parameter.name}={value!r})", called, is_nonsense(str(parameter.annotation), value)


def public_calls() -> Iterator[tuple[str, Callable[..., Any]]]:
    """Yield the public functions of the packages, and what makes and loads objects of their classes, by name."""
    for package in PACKAGES:
        module = importlib.import_module(f"siamloc.{package}")
        for name in getattr(module, "__all__", ["Run"]):
            offered = getattr(module, name)
            if inspect.isfunction(offered):
                yield f"siamloc.{package}.{name}", offered
            elif inspect.isclass(offered) and get_origin(offered) is None:  # dict[str, Any] is a class to Python 3.10
                for made in ("load", "open"):
                    if inspect.ismethod(getattr(offered, made, None)):
                        yield f"siamloc.{package}.{name}.{made}", getattr(offered, made)
                if (
                    "__init__" in vars(offered)
                    and not hasattr(offered, "training_step")
                    and not hasattr(offered, "__dataclass_fields__")
                ):
                    yield f"siamloc.{package}.{name}", offered


def is_nonsense(annotation: str, value: Any) -> bool:
    """Whether a plain value is nonsense for an argument with this annotation.

    >>> is_nonsense("str | Path | None", 3), is_nonsense("str | Path | None", "abc"), is_nonsense("FrameTable", None)
    (True, False, True)
    >>> is_nonsense("Annotated[tuple[float, ...], levels(0, 1)] | None", []), is_nonsense("Annotated[float, up(1)]", [])
    (False, True)
    """
    outer = re.sub(r"(?<!Annotated)\[[^\[\]]*\]", "", annotation)
    outside = re.sub(r"\[[^\[\]]*\]", "", re.sub(r"Annotated\[(\w+),[^\[\]]*\]", r"\1", outer))
    parts = [part.strip() for part in outside.split("|")]
    if any(part in _NOT_TOLD or part.endswith(_NOT_TOLD) or not part[:1].isalpha() for part in parts):
        return False
    if isinstance(value, bool):
        return "bool" not in parts
    if isinstance(value, float) and not abs(value) <= 1e10:
        return True
    if isinstance(value, Mapping) and any(part not in _PLAIN for part in parts):
        return False  # settings can be given as plain values
    kinds = tuple(kind for part in parts for kind in _PLAIN.get(part, ()))
    return not isinstance(value, kinds)


def _parameters(function: Callable[..., Any]) -> list[inspect.Parameter]:
    return [
        one
        for one in inspect.signature(function).parameters.values()
        if one.kind in (one.POSITIONAL_OR_KEYWORD, one.KEYWORD_ONLY)
    ]
