"""`siamloc export`: write the model file for the robot."""

from __future__ import annotations

from pathlib import Path

from omegaconf import DictConfig

from siamloc.cli.compose import plain
from siamloc.cli.steps import finished_run, identity_of, image_size, make_descriptor
from siamloc.errors import ConfigError
from siamloc.maps import VisualMap
from siamloc.models import SiameseModule
from siamloc.runtime.bundle import write_bundle


def main(config: DictConfig) -> None:
    """Export network and map, and compare the exported network with the original."""
    run = finished_run(config)
    network = make_descriptor(config, run, plain(config.descriptor))
    if not isinstance(network, SiameseModule):
        raise ConfigError(f"only a network can be exported, not descriptor={config.descriptor.name}")
    visual_map = VisualMap.load(run.map) if run.map.is_file() else None
    if visual_map is not None:
        visual_map.check_describer(identity_of(config, network))
    else:
        print(f"{run.folder} holds no map: the bundle can describe images, but not locate them")
    folder = Path(config.bundle) if config.bundle is not None else run.bundle
    report = write_bundle(
        folder,
        network,
        visual_map,
        image_size=image_size(config),
        unwrap=plain(config.unwrap),
        circular=config.data.circular,
        identity=identity_of(config, network),
    )
    print(
        f"bundle: {folder}; largest difference from the network {report['max_abs_difference']:.1e}, "
        f"{report['max_relative_difference']:.1e} of the largest value"
    )
    print(f"next: siamloc localize run={run.folder} images=[photo.jpeg]")
