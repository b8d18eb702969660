"""Headings for a descriptor that tells none, such as a trained network: the configuration's `heading`."""

from __future__ import annotations

from omegaconf import DictConfig

from analytic import DESCRIPTORS, Descriptor, descriptor
from siamloc.cli.compose import plain
from siamloc.cli.steps import device
from siamloc.errors import ConfigError
from siamloc.maps import VisualMap


def heading_descriptor(config: DictConfig) -> Descriptor | None:
    """Return what tells headings in place of the configured descriptor; None if nothing is asked for.

    An analytic descriptor tells headings itself, and needs no other.

    Raises:
        ConfigError: columns do not wrap around.
        AnalyticError: parameters that fit no image.
    """
    options = plain(config.heading)
    name = options.pop("name")
    if name == "none":
        return None
    if config.descriptor.name in DESCRIPTORS:
        print(f"heading={name} left out: {config.descriptor.name} tells headings itself")
        return None
    if not config.data.circular:
        raise ConfigError(
            f"heading={name} needs columns that are a full turn, and data.circular=false says that they are not: "
            "leave heading out"
        )
    return descriptor(name, **options, device=device(config))


def with_headings(known: VisualMap, heading: Descriptor | None) -> VisualMap:
    """Return a map that `siamloc.maps.WithHeading` can be compared with.

    Raises:
        ConfigError: the map holds nothing of this heading descriptor.
    """
    if heading is None:
        return known
    held = None if known.heading is None else known.heading.identity
    if held == heading.identity:
        return known.oriented()
    if held is None:
        found = "holds nothing to tell headings by"
    else:
        wanted = heading.identity
        keys = [key for key in {**held, **wanted} if held.get(key) != wanted.get(key)]
        told = [f"{key}={held.get(key)} instead of {wanted.get(key)}" for key in keys]
        found = f"tells headings by {held['name']}" + (
            f", not by {heading.name}" if "name" in keys else f" with {', '.join(told)}"
        )
    raise ConfigError(
        f"the map {found}: make it anew with `siamloc map heading={heading.name}` and the same heading keys, or "
        "evaluate with heading=none"
    )
