"""`siamloc map`: describe the map frames of a run."""

from __future__ import annotations

from omegaconf import DictConfig

from siamloc.cli.compose import plain
from siamloc.cli.steps import Roles, build_map, finished_run, label_of, make_descriptor, map_file


def main(config: DictConfig) -> None:
    """Describe the map frames and save the map."""
    run = finished_run(config)
    descriptor = make_descriptor(config, run, plain(config.descriptor))
    roles = Roles(config, ("map",))
    visual_map = build_map(config, descriptor, roles.library, roles["map"], "describing the map")
    target = map_file(run, label_of(plain(config.descriptor)))
    visual_map.save(target)
    print(f"map: {target}, {len(visual_map)} frames, descriptors of {visual_map.width} numbers")
    query = "" if config.protocol.query.sequences is not None else " protocol.query.sequences=[...]"
    print(f"next: siamloc evaluate run={run.folder}{query}")
