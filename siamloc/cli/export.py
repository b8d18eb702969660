"""`siamloc export`: write the model file for the robot."""

from __future__ import annotations

from pathlib import Path

from omegaconf import DictConfig

from siamloc.cli.compose import plain
from siamloc.cli.steps import finished_run, identity_of, image_size, label_of, make_descriptor
from siamloc.errors import ConfigError
from siamloc.maps import VisualMap
from siamloc.maps.error_model import ErrorModel
from siamloc.models import SiameseModule
from siamloc.runtime.bundle import learned_on, write_bundle


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
    errors = _error_model(run.evaluation(label_of(plain(config.descriptor))) / "error_model.json", visual_map)
    folder = Path(config.bundle) if config.bundle is not None else run.bundle
    report = write_bundle(
        folder,
        network,
        visual_map,
        image_size=image_size(config),
        unwrap=plain(config.unwrap),
        circular=config.data.circular,
        identity=identity_of(config, network),
        errors=errors,
    )
    print(
        f"bundle: {folder}; largest difference from the network {report['max_abs_difference']:.1e}, "
        f"{report['max_relative_difference']:.1e} of the largest value"
    )
    if visual_map is not None:
        told = ["position"]
        if visual_map.heading is not None:
            told.append(f"heading (by {visual_map.heading.identity['name']})")
        if errors is not None:
            told.append(f"expected error (lost above {errors.lost_above:g} {visual_map.unit})")
        print(f"the robot is told: {', '.join(told)}")
        if visual_map.heading is None:
            print(f"a heading as well: siamloc map run={run.folder} heading=hog, then export again")
        if errors is None:
            print(
                f"an expected error as well: siamloc evaluate run={run.folder} task.error_model=true, then export again"
            )
    print(f"next: siamloc localize run={run.folder} images=[photo.jpeg]")


def _error_model(path: Path, visual_map: VisualMap | None) -> ErrorModel | None:
    """Return the error model that an evaluation learned on this map, if there is one."""
    if visual_map is None or not path.is_file():
        return None
    errors = ErrorModel.load(path)
    if learned_on(errors, visual_map):
        return errors
    print(f"{path} left out, it was learned on another map: run `siamloc evaluate task.error_model=true` again")
    return None
