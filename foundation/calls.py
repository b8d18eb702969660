"""`typed`: check the arguments of a public call against its annotations, as settings are checked.

    >>> from foundation.settings import Count
    >>> @typed
    ... def cut(frames: FrameTable, k: Count = 2, folder: str | Path | None = None) -> None: ...
    >>> cut("abc")
    Traceback (most recent call last):
    foundation.errors.ConfigError: frames must be a FrameTable, got 'abc'

The names in an annotation are looked up when the call is made. A class that is only imported for type checking is
recognized by its name. Arguments pass if their annotations cannot be checked by value (array-likes, type variables).
"""

from __future__ import annotations

import builtins
import dataclasses
import inspect
import re
import types
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial, wraps
from textwrap import dedent, indent
from typing import (
    Annotated,
    Any,
    Concatenate,
    ParamSpec,
    Protocol,
    TypeVar,
    Union,
    get_args,
    get_origin,
    overload,
)

import numpy as np

from foundation.errors import ConfigError, hint
from foundation.settings import Absent, Settings, checked, default_of

_ATTRIBUTES = re.compile(r"^Attributes:\n((?:    .*\n?|\n)+)", flags=re.MULTILINE)
_SETTINGS = re.compile(r"^    settings: .*\n(?:        .*\n)*", flags=re.MULTILINE)

Result = TypeVar("Result")
Owner = TypeVar("Owner")
Group = TypeVar("Group")
Group_co = TypeVar("Group_co", covariant=True)
Arguments = ParamSpec("Arguments")
Fields = ParamSpec("Fields")


OF_FIELDS: Any = None
"""Default of the argument `settings` of a function that `takes` decorates: settings made of the fields in the call."""


class Taking(Protocol[Fields, Group_co]):
    """The type of the decorator that `takes` returns."""

    @overload
    def __call__(
        self, function: Callable[[Owner, Group_co], Result]
    ) -> Callable[Concatenate[Owner, Fields], Result]: ...

    @overload
    def __call__(self, function: Callable[Arguments, Result]) -> Callable[Arguments, Result]: ...


def takes(kind: Callable[Fields, Group]) -> Taking[Fields, Group]:
    """Let a function be called with the fields of a settings class as keywords.

    The function itself has one argument for them, `settings`. A caller gives either that, as an object or as plain
    values, or the fields. `help` and notebook completion show the fields one by one; in the docstring they replace the
    line about `settings`.

    A type checker knows the fields of a method with no other argument than `settings`; other functions end in
    `**fields: Any`, and check them when they are called.

    Args:
        kind: the class, a subclass of `Settings`.
    """

    return partial(_taking, kind=kind)  # type: ignore[return-value, arg-type]


def _taking(function: Callable[..., Result], kind: type[Settings]) -> Callable[..., Result]:
    own = inspect.signature(function)
    # Keywords that are fields become `settings`; the rest are the function's own.
    parameters = [one for one in own.parameters.values() if one.name != "settings" and one.kind is not one.VAR_KEYWORD]
    fields = {field.name: field for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    check = _check_of(function)
    own_names = {one.name for one in parameters}
    named = [*(one.name for one in parameters if one.kind is one.KEYWORD_ONLY), *fields]
    called = function.__qualname__.removesuffix(".__init__").rpartition(".")[2]

    @wraps(function)
    def call(*arguments: Any, settings: Settings | Mapping[str, Any] | None = None, **keywords: Any) -> Result:
        given = {name: keywords.pop(name) for name in list(keywords) if name in fields}
        for name in keywords:
            if name not in own_names:
                raise ConfigError(f"{called} has no setting {name!r}: {hint(name, named)}")
        if settings is not None and given:
            raise ConfigError(f"{called} takes settings=... or {', '.join(given)}, not both")
        arguments, keywords = check(arguments, keywords)
        chosen = kind.of(given) if settings is None else checked(settings, kind, "settings")
        return function(*arguments, settings=chosen, **keywords)

    shown = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=_shown(field), annotation=field.type)
        for name, field in fields.items()
    ]
    call.__signature__ = own.replace(parameters=[*parameters, *shown])  # type: ignore[attr-defined]
    if listed := _described(kind):
        text = inspect.cleandoc(function.__doc__ or "")
        call.__doc__ = _SETTINGS.sub(lambda _: f"{indent(listed, '    ')}\n", text, count=1)
    return call


def typed(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Make a function or method refuse arguments that its annotations do not allow, before it does anything.

    Arguments are passed on as given, except that plain values for a group of settings become the group, and whole
    numbers of numpy become plain ones.

    Raises:
        ConfigError: from the call, naming the argument, what it should be, and what it is.
    """
    check = _check_of(function)

    @wraps(function)
    def call(*arguments: Arguments.args, **keywords: Arguments.kwargs) -> Result:
        given, named = check(arguments, keywords)
        return function(*given, **named)

    return call


def _check_of(function: Callable[..., Any]) -> Callable[[tuple[Any, ...], dict[str, Any]], Any]:
    """Return the function that checks the arguments of a call, and returns them as described for `typed`.

    Missing and unknown arguments are left to Python.
    """
    signature = inspect.signature(function)
    kinds = cache(partial(kinds_of, function))

    def check(arguments: tuple[Any, ...], keywords: dict[str, Any]) -> tuple[tuple[Any, ...], dict[str, Any]]:
        try:
            given = signature.bind_partial(*arguments, **keywords)
        except TypeError:
            return arguments, keywords
        for name, value in given.arguments.items():
            if name in kinds() and value is not signature.parameters[name].default:
                fitting = checked(value, kinds()[name], name)
                if isinstance(fitting, Settings) or isinstance(value, np.integer):
                    given.arguments[name] = fitting
        return given.args, given.kwargs

    return check


def kinds_of(function: Callable[..., Any]) -> dict[str, Any]:
    """Return the annotations of a function's parameters that a value can be checked against, by name."""
    space = _Space(inspect.unwrap(function).__globals__)
    found: dict[str, Any] = {}
    for name, parameter in inspect.signature(function).parameters.items():
        if parameter.kind in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL):
            continue
        annotation = parameter.annotation
        try:
            kind = eval(annotation, {}, space) if isinstance(annotation, str) else annotation
        except TypeError:  # brackets after a name that only exists for type checking
            continue
        if kind is not inspect.Parameter.empty and _can_be_told(kind):
            found[name] = kind
    return found


def _described(kind: type[Settings]) -> str:
    """Return the field descriptions from the docstrings of a settings class and its bases."""
    texts = [
        inspect.cleandoc(one.__doc__) for one in reversed(kind.__mro__) if issubclass(one, Settings) and one.__doc__
    ]
    found = [_ATTRIBUTES.search(text) for text in texts[1:]]
    return "\n".join(dedent(one[1]).rstrip("\n") for one in found if one)


def _shown(field: dataclasses.Field[Any]) -> Any:
    default = default_of(field)
    return inspect.Parameter.empty if default is dataclasses.MISSING else default


class _Space(dict[str, Any]):
    """The names of a module; a class stands in for each name that is only imported for type checking."""

    def __missing__(self, name: str) -> Any:
        return getattr(builtins, name) if hasattr(builtins, name) else type(name, (Absent,), {})


def _can_be_told(kind: Any) -> bool:
    """Whether a value can be checked against an annotation: any but numpy's array-likes, which can be anything."""
    origin, parts = get_origin(kind), get_args(kind)
    if origin in (Annotated, Union, types.UnionType, tuple, list, Sequence):
        return all(map(_can_be_told, parts))
    return origin is np.ndarray or not getattr(origin or kind, "__module__", "").startswith("numpy")
