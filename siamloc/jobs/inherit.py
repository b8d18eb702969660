"""Settings that a job takes from the run that it names: those stored in the run and in its map.

What is given wins: a key such as `protocol.map.every=2` replaces the stored one, and a group such as `data=cold`
replaces everything that it chooses. The image size always comes from the network.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from pathlib import Path
from typing import Any

from foundation.settings import fields_of
from siamloc.data.protocol import Protocol
from siamloc.errors import ConfigError
from siamloc.jobs.choices import OF_A_RUN
from siamloc.jobs.job import Given
from siamloc.jobs.sweep import of_map, own_folder
from siamloc.models.registry import Optimizer, whole_model
from siamloc.runs import Run, newest_run
from siamloc.training.settings import Learning

OF_TRAINING = tuple(name for name in fields_of(Learning) if name not in ("pairs", "optimizer"))
"""Settings of a training that are keys of their own on the command line."""
# What a chosen option of a group sets in addition: data sets and experiments choose options of other groups.
_CHOOSES = {
    "data": ("data", "unwrap", "protocol"),
    "experiment": (
        *("data", "unwrap", "protocol", "protocol.map", "model", "pairs", "optimizer", "loss"),
        *("augment", *OF_TRAINING),
    ),
    "protocol": ("protocol", "protocol.map"),
}


def with_settings_of_the_run(
    values: dict[str, Any],
    given: Given,
    known: Container[str],
    *,
    resumed: bool = False,
    replaces_map: bool = False,
) -> dict[str, Any]:
    """Return the values of a job with the settings of its run; unchanged if there is no such run yet.

    Args:
        values: with `run`, and `descriptor` where the job has one.
        given: what wins over the run.
        known: keys of the job.
        resumed: whether to take the settings of the training as well.
        replaces_map: whether a new map is made: frames and headings of the existing one are then not taken.

    Raises:
        ConfigError: an empty run name, or a folder that is not a run although its network is needed.
        FormatError: a run or a map of another version.
    """
    if not isinstance(values["run"], str) or not values["run"].strip():
        return values  # which the check of the job refuses
    run = Run(Path(values["run"]))
    network = values.get("descriptor", {}).get("run")
    trained = Run(Path(network)) if network is not None else run
    by_network = values.get("descriptor", {}).get("name", "network") in OF_A_RUN
    needed = by_network and not resumed
    if needed and not trained.record.is_file():
        _hint_at_maps(trained.folder)
    record = trained.settings if needed or trained.record.is_file() else {}
    made = None if resumed else _map_made(run, values)
    kept = _kept(record, made, resumed=resumed, replaces_map=replaces_map)
    chosen = {part for group in given.groups for part in _CHOOSES.get(group, (group,))}
    said = {key: _select(values, key) for key in given.keys if key not in given.groups and _has(values, key)}
    result = dict(values)
    for section, stored in kept.items():
        if section.partition(".")[0] in known and not any(
            section == part or (section != "protocol.map" and section.startswith(f"{part}.")) for part in chosen
        ):
            _put(result, section, stored)
    size = record.get("model", {}).get("image_size") or record.get("data", {}).get("image_size")
    if size is not None and "data" in known and "experiment" not in given.groups and by_network:
        _put(result, "data.image_size", size)
    for key, value in said.items():
        _put(result, key, value)
    return result


def map_file(run: Run, label: str) -> Path:
    """Return the path of a descriptor's map in a run."""
    return run.map if label == "network" else run.evaluation(label) / "map.npz"


def map_of_job(run: Run, titles: Mapping[str, str]) -> Path:
    """Return the path of a job's map: in its own folder if a sweep makes different maps, else `map_file`."""
    label = titles["descriptor"]
    shared = run.evaluation(label)
    own = own_folder(shared, titles, of_map)
    return map_file(run, label) if own == shared else own / "map.npz"


def map_known(run: Run, titles: Mapping[str, str]) -> Path:
    """Return the map that a job searches: its own, or one shared across distances and headings; it need not exist."""
    label = titles["descriptor"]
    shared = run.evaluation(label)
    for others in ((), ("distance",), ("distance", "heading")):
        own = own_folder(shared, titles, lambda key, others=others: of_map(key) and key not in others)  # type: ignore[misc]
        path = map_file(run, label) if own == shared else own / "map.npz"
        if path.is_file():
            return path
    return path


def suggestion() -> str:
    """Suggest a run for an error message."""
    try:
        return f"give run=FOLDER, such as run={newest_run().folder}, the newest one"
    except ConfigError:
        return "train one first with `siamloc train run=FOLDER`, or choose a descriptor that needs none, descriptor=hog"


def _hint_at_maps(folder: Path) -> None:
    """Refuse a folder without a trained network that has maps of other descriptors, naming one of them.

    Raises:
        ConfigError: it has.
    """
    made = sorted(file.parent.name for file in folder.glob("evaluation/*/map.npz"))
    if made:
        raise ConfigError(
            f"{folder} holds no trained network, only maps by {', '.join(made)}: choose the descriptor, such as "
            f"descriptor={made[0].partition('-')[0]}, or train with `siamloc train run={folder}`"
        )


def _kept(
    record: Mapping[str, Any], made: Mapping[str, Any] | None, *, resumed: bool, replaces_map: bool
) -> dict[str, Any]:
    """Return the stored settings by section of the job."""
    model, training = whole_model(record.get("model", {})), record.get("training", {})
    kept = _of_data(record.get("data") or (made or {}).get("data") or {})
    if "protocol" in record:
        kept["protocol"] = Protocol.of(record["protocol"]).plain()
    if made is not None and not replaces_map:
        kept |= {key: made[key] for key in ("protocol.map", "heading") if key in made}
    if "seed" in training:
        kept["seed"] = training["seed"]
    if "branch" in model:
        head = {"name": model["head"], "outputs": model.get("outputs")}
        kept |= {"model.branch.name": model["branch"], "model.head": head}
        keys = ("circular", "normalize", "canonical", "relative")
        kept |= {f"model.{key}": model[key] for key in keys if key in model}
    if resumed and training:
        kept |= {
            "model.branch.weights": model.get("weights"),
            "loss": _of_loss(record.get("loss") or {}),
            "augment": {**(record.get("augment") or {"name": "none"}), "where": training["augment_where"]},
            "trainer.precision": record.get("trainer", {}).get("precision", "32-true"),
            "pairs": training["pairs"],
            "optimizer": Optimizer.of(training["optimizer"]).plain(),
            **({"views": record["views"], "image_size": model["image_size"]} if "views" in record else {}),
            **{key: training[key] for key in OF_TRAINING if key in training},
        }
    return kept


def _of_loss(loss: Mapping[str, Any]) -> dict[str, Any]:
    return {"name": "contrastive", **{key: value for key, value in loss.items() if key != "class"}}


def _of_data(data: Mapping[str, Any]) -> dict[str, Any]:
    if not data.get("kind"):
        return {}
    held = dict(data)
    return {"unwrap": held.pop("unwrap", None) or {"kind": "none"}, "data": held}


def _map_made(run: Run, values: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return the settings with which the map of the descriptor was made, by section; None without a map."""
    if "descriptor" not in values:
        return None
    titles = {group: str(values[group].get("label") or values[group]["name"]) for group in ("descriptor", "build")}
    places = (map_known(run, titles), map_file(run, titles["descriptor"]))
    path = next((one for one in places if one.is_file()), None)
    if path is None:
        return None
    from siamloc.maps import VisualMap

    known = VisualMap.load(path)
    found: dict[str, Any] = {}
    if "data" in known.made:
        found["data"] = {**known.made["data"], "unit": known.unit}
    if "role" in known.made:
        found["protocol.map"] = known.made["role"]
    if known.heading is not None and not known.heading.own:  # headings need columns that are a full turn
        found["heading"] = {key: value for key, value in known.heading.identity.items() if key != "circular"}
    return found


def _select(values: Mapping[str, Any], key: str) -> Any:
    for part in key.split("."):
        values = values[part]
    return values


def _has(values: Mapping[str, Any], key: str) -> bool:
    try:
        _select(values, key)
    except (KeyError, TypeError):
        return False
    return True


def _put(values: dict[str, Any], key: str, value: Any) -> None:
    """Set a nested value; mappings on the way are copied."""
    first, _, rest = key.partition(".")
    if rest:
        values[first] = dict(values[first]) if isinstance(values.get(first), Mapping) else {}
        _put(values[first], rest, value)
    else:
        values[first] = value
