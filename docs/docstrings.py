"""Make docstrings ready for the reference: examples as code, and settings as the keywords that they are."""

from __future__ import annotations

import re
from typing import Any

import griffe

_EXAMPLE = re.compile(r"^Example:$", flags=re.MULTILINE)
_BARE = re.compile(r"^>>> .*(?:\n.+)*", flags=re.MULTILINE)
_ATTRIBUTES = re.compile(r"^Attributes:\n((?:    .*\n?|\n)+)", flags=re.MULTILINE)
_SETTINGS = re.compile(r"^    settings: .*\n(?:        .*\n?)*", flags=re.MULTILINE)


class Docstrings(griffe.Extension):
    """Turn "Example:" into "Examples:", and let functions decorated by `takes(Settings)` show the fields they take."""

    def on_object(self, *, obj: griffe.Object, **others: Any) -> None:
        """Change the docstring of one object."""
        if obj.docstring is not None:
            obj.docstring.value = _BARE.sub(_under_heading, _EXAMPLE.sub("Examples:", obj.docstring.value))

    def on_package(self, *, pkg: griffe.Module, **others: Any) -> None:
        """Change the functions of a package, whose settings are all known by then, and what its stubs make public."""
        for module in _modules(pkg):
            listed = [name for name, one in module.members.items() if one.is_alias and _within(one, module)]
            if module.exports is None and module.is_init_module and listed:
                module.exports = listed
        for function in _functions(pkg):
            for decorator in function.decorators:
                if found := re.fullmatch(r"takes\((\w+)\)", str(decorator.value)):
                    path = function.parent.resolve(found[1])
                    _show_fields(function, pkg[path.removeprefix(f"{pkg.name}.")])


def _modules(module: griffe.Module) -> list[griffe.Module]:
    return [module, *(one for part in module.modules.values() if not part.is_alias for one in _modules(part))]


def _within(member: griffe.Object | griffe.Alias, package: griffe.Module) -> bool:
    return str(getattr(member, "target_path", "")).startswith(f"{package.path}.")


def _functions(module: griffe.Module) -> list[griffe.Function]:
    own = [one for one in module.functions.values() if not one.is_alias]
    return own + [one for part in module.modules.values() if not part.is_alias for one in _functions(part)]


def _show_fields(function: griffe.Function, settings: griffe.Class) -> None:
    settings = settings.final_target if settings.is_alias else settings
    groups = [group for group in reversed([settings, *settings.mro()]) if group.name != "Settings"]
    keyword_fields = griffe.ParameterKind.var_keyword  # the fields again, for type checkers
    shown = [one for one in function.parameters if one.name != "settings" and one.kind is not keyword_fields]
    text = ""
    for group in groups:
        for one in group.attributes.values():
            if one.annotation is not None and not one.name.isupper():
                kind = griffe.ParameterKind.keyword_only
                shown.append(griffe.Parameter(one.name, annotation=one.annotation, kind=kind, default=_default(one)))
        listed = _ATTRIBUTES.search(group.docstring.value) if group.docstring is not None else None
        text += listed[1].rstrip("\n") + "\n" if listed is not None else ""
    function.parameters = griffe.Parameters(*shown)
    if function.docstring is not None and text:
        function.docstring.value = _SETTINGS.sub(lambda _: text, function.docstring.value)


def _default(field: griffe.Attribute) -> str:
    text = str(field.value)
    made = re.fullmatch(r"field\(default_factory=(\w+)\)", text)
    return f"{made[1]}()" if made else text


def _under_heading(found: re.Match[str]) -> str:
    return "Examples:\n" + "\n".join(f"    {line}" for line in found[0].splitlines())
