"""The settings that a job takes from its run and its map, and the paths of maps in a run.

What the user gives wins over what is stored: a key such as `protocol.map.every=2` replaces the stored value, and a
group such as `data=cold` replaces everything that it chooses. The image size always comes from the network.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from analytic import DESCRIPTORS
from foundation.settings import defaults_of, fields_of
from foundation.words import as_words
from siamloc.data.protocol import Protocol
from siamloc.errors import ConfigError, OldFormatError
from siamloc.jobs.choices import OF_A_RUN, Build, DescriptorChoice, Model, names_in, parameters_of
from siamloc.jobs.job import Given, at
from siamloc.jobs.options import is_fused, option
from siamloc.jobs.sweep import of_map, own_folder
from siamloc.models.registry import Optimizer
from siamloc.runs import Run
from siamloc.training.settings import Learning

if TYPE_CHECKING:
    from siamloc.maps import VisualMap

OF_TRAINING = tuple(name for name in fields_of(Learning) if name not in ("pairs", "optimizer"))
"""Settings of a training that are keys of their own on the command line."""
_OF_DATA = ("data", "unwrap", "protocol")
# Sections that an option of a group sets: data sets and experiments choose options of other groups.
_CHOOSES = {
    "data": _OF_DATA,
    "experiment": (*_OF_DATA, "protocol.map", "model", "pairs", "optimizer", "loss", "augment", *OF_TRAINING),
    "protocol": ("protocol", "protocol.map"),
}


def with_settings_of_the_run(
    values: dict[str, Any],
    given: Given,
    known: Container[str],
    *,
    resumed: bool = False,
    replaces_map: bool = False,
    loaded: Mapping[Path, VisualMap] | None = None,
) -> dict[str, Any]:
    """Return the values of a job with the settings of its run; unchanged if there is no such run yet.

    Args:
        values: with `run`, and `descriptor` where the job has one.
        given: the keys that win over the settings of the run.
        known: keys of the job.
        resumed: whether to take the settings of the training as well.
        replaces_map: whether the job makes a new map, which takes neither frames nor headings from the old map.
        loaded: maps that have been read already, by their files.

    Raises:
        ConfigError: a folder that is not a run although its network is needed, or no data, neither given nor stored.
        FormatError: a run or a map of another version.
    """
    if not isinstance(values["run"], str) or not values["run"].strip():
        return values  # which the check of the job refuses
    run = Run(Path(values["run"]))
    described = {"name": "network", "run": None, **values.get("descriptor", {})}
    trained = run if described["run"] is None else Run(Path(described["run"]))
    by_network = bool(set(names_in(described)) & set(OF_A_RUN))
    needed = by_network and not resumed
    if needed and not trained.record.is_file():
        _hint_at_maps(trained.folder)
    record = trained.settings if needed or trained.record.is_file() else {}
    made = None if resumed or "descriptor" not in values else _map_made(run, values, loaded or {}, replaces_map)
    kept = _kept(record, made, resumed=resumed, replaces_map=replaces_map)
    own = [key for key in given.keys if key not in given.groups]
    said = {key: value for key in own if (value := at(values, key, _NOTHING)) is not _NOTHING}
    stored_kind = kept.get("data", {}).get("kind")
    other_data = stored_kind is not None and said.get("data.kind", stored_kind) != stored_kind
    groups = [*given.groups, *(["data"] if other_data else [])]
    chosen = {part for group in groups for part in _CHOOSES.get(group, (group,))}
    result = dict(values)
    for section, stored in kept.items():
        if section.partition(".")[0] in known and not any(
            section == part or (section != "protocol.map" and section.startswith(f"{part}.")) for part in chosen
        ):
            _put(result, section, stored)
    size = record.get("model", {}).get("image_size") or record.get("data", {}).get("image_size")
    if size is not None and "data" in known and "experiment" not in given.groups and by_network:
        _put(result, "data.image_size", size)
    edges = (record.get("data") or {}).get("unwrap") or {}
    for key in ("top", "bottom"):  # of the panoramas that the network was trained on, by any camera
        if by_network and key in edges and (result.get("unwrap") or {}).get(key, 0) is None:
            _put(result, f"unwrap.{key}", edges[key])
    for key, value in said.items():
        _put(result, key, value)
    if record.get("data") and "data" not in kept and at(result, "data.manifest") == "???":
        raise ConfigError(
            f"the frames of {trained.folder} came from Python, and its record names no files: say which to read, such "
            "as data.manifest=robot.csv, or go on in Python"
        )
    return result


def titles_of(values: Mapping[str, Any]) -> dict[str, str]:
    """Return the titles of the descriptor and of the build in the values of a job, by group."""
    return {"descriptor": DescriptorChoice.of(values["descriptor"]).title, "build": Build.of(values["build"]).title}


def map_file(run: Run, label: str) -> Path:
    """Return the path of a descriptor's map in a run.

    Args:
        run: the run.
        label: title of the descriptor: "network" for the network of the run, or a name such as "hog".
    """
    return run.map if label == "network" else run.evaluation(label) / "map.npz"


def map_places(run: Run, titles: Mapping[str, str]) -> list[Path]:
    """Return the path of a job's map, and of the map that jobs with other distances or headings share with it.

    The path is `map_file`, or inside the job's own folder if a sweep makes different maps.

    Args:
        run: the run.
        titles: the job's titles by key, with "descriptor", and those of the swept settings.
    """
    label = titles["descriptor"]
    shared = run.evaluation(label)

    def without(*keys: str) -> Path:
        own = own_folder(shared, titles, lambda key: of_map(key) and key not in keys)
        return map_file(run, label) if own == shared else own / "map.npz"

    return [without(), without("distance"), without("distance", "heading")]


def map_known(run: Run, titles: Mapping[str, str]) -> Path:
    """Return the path of a job's map, or of one with another distance or heading; none of them need exist."""
    places = map_places(run, titles)
    return next((path for path in places if path.is_file()), places[-1])


def only_map(run: Run) -> dict[Path, VisualMap]:
    """Return the map of a folder with one map and no trained network, by its file; nothing for other folders."""
    made = list(run.folder.glob("evaluation/*/map.npz"))
    if run.record.is_file() or len(made) != 1:
        return {}
    from siamloc.maps import VisualMap

    return {made[0]: VisualMap.load(made[0])}


def descriptor_of(file: Path, identity: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return the descriptor of a saved map as values of a job; None for the network of another run."""
    label, name = file.parent.name, identity.get("name")
    if name not in DESCRIPTORS:
        itself = label == "pretrained" or is_fused(label)
        return dict(option("descriptor", label).values) if itself else None
    values = {key: identity[key] for key in ("name", *parameters_of(name)) if key in identity}
    return values if label == name else {**values, "label": label}


def _hint_at_maps(folder: Path) -> None:
    """Refuse a folder that has no trained network but maps by other descriptors.

    Raises:
        ConfigError: there are such maps; the sentence names their descriptors.
    """
    made = sorted(file.parent.name for file in folder.glob("evaluation/*/map.npz"))
    if made:
        raise ConfigError(
            f"{folder} holds no trained network, only maps by {', '.join(made)}: choose the descriptor, such as "
            f"descriptor={made[0].partition('-')[0]}, or train with `siamloc train {as_words({'run': folder})}`"
        )


def _kept(
    record: Mapping[str, Any], made: Mapping[str, Any] | None, *, resumed: bool, replaces_map: bool
) -> dict[str, Any]:
    """Return the stored settings by section of the job."""
    model, training, kept = record.get("model", {}), record.get("training", {}), dict[str, Any]()
    data, of_map = dict(record.get("data") or {}), (made or {}).get("data") or {}
    if of_map.get("kind") and not (replaces_map and data):  # a map made in Python may not know where its frames are
        data = dict(of_map)
    if data.get("kind"):
        kept |= {"unwrap": data.pop("unwrap", None) or {"kind": "none"}, "data": data}
    if "protocol" in record:
        kept["protocol"] = Protocol.of(record["protocol"]).plain()
    if made is not None and not replaces_map:
        kept |= {key: made[key] for key in ("protocol.map", "heading") if key in made}
    if "seed" in training:
        kept["seed"] = training["seed"]
    if "branch" in model:
        head = {"name": model["head"], "outputs": model.get("outputs")}
        kept |= {"model.branch.name": model["branch"], "model.head": head}
        known = {"colours": False, **model}
        kept |= {f"model.{key}": known[key] for key in defaults_of(Model) if key in known}
    if resumed and training:
        loss = {key: value for key, value in (record.get("loss") or {}).items() if key != "class"}
        kept |= {
            "model.branch.weights": model.get("weights"),
            "loss": {"name": "contrastive", **loss},
            "augment": {**(record.get("augment") or {"name": "none"}), "where": training["augment_where"]},
            "trainer.precision": record.get("trainer", {}).get("precision", "32-true"),
            "pairs": training["pairs"],
            "optimizer": Optimizer.of(training["optimizer"]).plain(),
            **({"views": record["views"], "image_size": model["image_size"]} if "views" in record else {}),
            **{key: training[key] for key in OF_TRAINING if key in training},
        }
    return kept


def _map_made(
    run: Run, values: Mapping[str, Any], loaded: Mapping[Path, VisualMap], replaced: bool
) -> dict[str, Any] | None:
    """Return the settings with which the map of the descriptor was made, by section; None without a map.

    A map of an older siamloc that is to be replaced is passed over.
    """
    titles = titles_of(values)
    places = (map_known(run, titles), map_file(run, titles["descriptor"]))
    path = next((one for one in places if one.is_file()), None)
    if path is None:
        return None
    from siamloc.maps import VisualMap

    try:
        known = loaded[path] if path in loaded else VisualMap.load(path)
    except OldFormatError:
        if replaced:
            return None
        raise
    found: dict[str, Any] = {}
    if "data" in known.made:
        found["data"] = {**known.made["data"], "unit": known.unit}
    if "role" in known.made:
        found["protocol.map"] = known.made["role"]
    if known.heading is not None and not known.heading_by_network:  # headings need columns that are a full turn
        found["heading"] = {key: value for key, value in known.heading.items() if key != "circular"}
    return found


_NOTHING = object()


def _put(values: dict[str, Any], key: str, value: Any) -> None:
    """Set a nested value; mappings on the way are copied."""
    first, _, rest = key.partition(".")
    if rest:
        values[first] = dict(values[first]) if isinstance(values.get(first), Mapping) else {}
        _put(values[first], rest, value)
    else:
        values[first] = value
