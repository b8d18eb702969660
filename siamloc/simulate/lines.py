"""YAML whose mappings and sequences know the line they began on."""

from __future__ import annotations

from typing import Any

import yaml


def load_with_lines(text: str) -> Any:
    """Parse YAML; every mapping and sequence has an attribute `line`, counted from 1.

    Raises:
        yaml.YAMLError: not YAML.
    """
    return yaml.load(text, _Loader)


class LineDict(dict[str, Any]):
    """A mapping that knows the line it began on."""

    line = 0


class LineList(list[Any]):
    """A sequence that knows the line it began on."""

    line = 0


class _Loader(yaml.SafeLoader):
    pass


def _mapping(loader: Any, node: yaml.MappingNode) -> LineDict:
    value = LineDict(loader.construct_mapping(node, deep=True))
    value.line = node.start_mark.line + 1
    return value


def _sequence(loader: Any, node: yaml.SequenceNode) -> LineList:
    value = LineList(loader.construct_sequence(node, deep=True))
    value.line = node.start_mark.line + 1
    return value


_Loader.add_constructor("tag:yaml.org,2002:map", _mapping)
_Loader.add_constructor("tag:yaml.org,2002:seq", _sequence)
