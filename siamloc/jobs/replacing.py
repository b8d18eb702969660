"""Whether results that an evaluation would replace are of the same frames."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from foundation.files import real_path
from siamloc.data.protocol import Protocol, Role
from siamloc.data.reading import parameters_of, path_keys
from siamloc.errors import SiamlocError
from siamloc.results import read_results


def measured_otherwise(folder: Path, protocol: Protocol, data: Mapping[str, Any], *, only_map: bool) -> list[str]:
    """Return the keys, such as "protocol.query", by which new results would be of other frames than those in a folder.

    Args:
        folder: folder of the earlier results; there is no difference from results that cannot be read.
        protocol: roles of the frames of the new results.
        data: where these frames are, as plain values of `DataSettings`.
        only_map: whether only map frames are measured.
    """
    try:
        config = read_results(folder).get("config", {})
        before = _frames(Protocol.of(config.get("protocol") or {}), config.get("data") or {})
    except SiamlocError:
        return []
    wanted = _frames(Protocol(map=protocol.map) if only_map else protocol, data)
    keys = ("protocol.map", "data") if only_map else tuple(wanted)
    return [key for key in keys if config.get(key.partition(".")[0]) and before[key] != wanted[key]]


def _frames(protocol: Protocol, data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings that decide which frames are located in which map, by their keys."""
    values = {**protocol.plain(), "map": (protocol.train if protocol.map == Role() else protocol.map).plain()}
    wanted = {f"protocol.{key}": _sorted(value) for key, value in values.items() if key not in ("train", "validation")}
    reader = parameters_of(data["kind"]) if data else {}
    where = {key: data[key] for key, one in reader.items() if key in data and data[key] not in (None, one.default)}
    places = {key: str(real_path(str(value))) for key, value in where.items() if key in path_keys()}
    return {**wanted, "data": {**where, **places, "on_error": None}}


def _sorted(role: Any) -> Any:
    """Return a role in plain values with its lists sorted; other settings of a protocol as they are."""
    if not isinstance(role, Mapping):
        return role
    return {key: sorted(value) if isinstance(value, list) else value for key, value in role.items()}
