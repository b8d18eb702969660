"""`siamloc map`: describe the map frames of a run, and build a coarse layer over them."""

from __future__ import annotations

from omegaconf import DictConfig

from siamloc.cli.compose import plain
from siamloc.cli.headings import heading_descriptor
from siamloc.cli.mapping import build_and_save
from siamloc.cli.steps import Roles, build_map, finished_run, label_of, make_descriptor, map_file


def main(config: DictConfig) -> None:
    """Describe the map frames and save the map; build and save its coarse layer if one is asked for."""
    run = finished_run(config)
    options = plain(config.descriptor)
    descriptor = make_descriptor(config, run, options)
    heading = heading_descriptor(config)
    roles = Roles(config, ("map",))
    visual_map = build_map(config, descriptor, roles.library, roles["map"], "describing the map", heading)
    target = map_file(run, label_of(options))
    visual_map.save(target)
    print(f"map: {target}, {len(visual_map)} frames, descriptors of {visual_map.width} numbers")
    if visual_map.heading is not None:
        size = visual_map.heading.values[0].nbytes
        print(f"headings: by {visual_map.heading.identity['name']}, {size} bytes a frame")
    if config.build.name != "none":
        build_and_save(config, run, visual_map, descriptor, label_of(options))
        return
    query = "" if config.protocol.query.sequences is not None else " protocol.query.sequences=[...]"
    settings = "" if label_of(options) == "network" else " with the same data and descriptor"
    print(f"next: siamloc evaluate run={run.folder}{query}{settings}")
