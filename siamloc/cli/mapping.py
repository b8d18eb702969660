"""Coarse layers on the command line: building, saving and measuring them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import DictConfig

from analytic import Descriptor
from siamloc.cli.compose import plain
from siamloc.cli.steps import (
    Roles,
    build_map,
    finished_run,
    identity_of,
    label_of,
    make_descriptor,
    map_file,
    usable,
)
from siamloc.errors import ConfigError, FormatError
from siamloc.evaluation.mapping import evaluate_mapping
from siamloc.evaluation.results import write_results
from siamloc.files import read_json, storage_errors, write_json, write_text
from siamloc.maps import CoarseLayer, VisualMap
from siamloc.maps.layers import BUILDS, Built, build_layer
from siamloc.progress import track
from siamloc.runs import Run


def layer_over(
    config: DictConfig, run: Run, known: VisualMap, descriptor: Descriptor, label: str
) -> tuple[CoarseLayer, Path]:
    """Return the configured layer over a map and its folder: the one that was built before, if it fits."""
    folder = run.layer(label, label_of(plain(config.build)))
    layer = _saved_layer(config, folder, known)
    return (layer, folder) if layer is not None else build_and_save(config, run, known, descriptor, label)


def build_and_save(
    config: DictConfig, run: Run, known: VisualMap, descriptor: Descriptor, label: str
) -> tuple[CoarseLayer, Path]:
    """Build the configured layer over a map, write it with all that explains it, and say what it is."""
    built = build_layer(known, descriptor, _options(config), config.seed, track)
    called = label_of(plain(config.build))
    folder = run.layer(label, called)
    with storage_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        # The layer goes first and comes last: if this is interrupted, no layer stands beside what explains another.
        (folder / "layer.npz").unlink(missing_ok=True)
    write_json(folder / "placing.json", {**_placing(built), "map": known.digest})
    if built.mapper is not None:
        built.mapper.save(folder / "mapper.npz")
        write_text(folder / "events.jsonl", "".join(f"{line}\n" for line in built.mapper.events))
        graph = built.mapper.graph()
        graph.to_json(folder / "graph.json")
        graph.to_graphml(folder / "graph.graphml")
    built.layer.save(folder / "layer.npz")
    unassigned = int((built.layer.labels < 0).sum())
    lost = f", {unassigned} frames in none" if unassigned else ""
    seconds = built.seconds.sum()
    print(f"layer: {folder}, {len(built.layer)} nodes over {len(known)} frames{lost}, built in {seconds:.1f} s")
    if built.mapper is not None and len(built.layer) == 1:
        print(
            "one node: the thresholds count frames that lie a few centimetres apart; take more frames into the map "
            "(protocol.map.every=1), or use build=incremental_sparse"
        )
    if list(config.task.names) not in (["mapping"], ["hierarchical"], ["buildings"]):
        print(f"next: siamloc evaluate task=mapping|hierarchical build={called} ... with the same settings")
    return built.layer, folder


def measure(config: DictConfig) -> None:
    """Measure a coarse layer, building it if it is not there; write the files, print a table."""
    if config.build.name == "none":
        raise ConfigError(f"task=mapping measures a coarse layer: choose one with build={'|'.join(BUILDS)}")
    run = finished_run(config)
    options = plain(config.descriptor)
    descriptor = make_descriptor(config, run, options)
    label = label_of(options)
    known = _map(config, run, descriptor, label)
    layer, folder = layer_over(config, run, known, descriptor, label)
    placing = read_json(folder / "placing.json")
    result = evaluate_mapping(
        known,
        layer,
        descriptor,
        config.task.closure_radius,
        config.task.closure_gap,
        np.array(placing["seconds"]),
        np.array(placing["reasons"]) if placing.get("reasons") else None,
    )
    measures = result.measures()
    called = label_of(plain(config.build))
    target = run.folder / "evaluation" / f"mapping-{label}-{called}"
    write_results(
        target,
        {
            "command": "evaluate",
            "descriptor": descriptor.identity,
            "layer": layer.made,
            "edges": layer.edges,
            "config": plain(config),
            "measures": {"mapping": measures},
            "denominators": {"frames": len(known), "nodes": len(layer)},
        },
        tables={"frames": result.columns, "nodes": result.nodes},
    )
    _print(label, called, measures)
    if config.task.plots:
        from siamloc.report.draw import save_all

        for path in save_all(target, folder):
            print(f"picture: {path}")
    print(f"results: {target / 'results.json'}, one row per frame in {target / 'frames.csv'}")


def _map(config: DictConfig, run: Run, descriptor: Descriptor, label: str) -> VisualMap:
    """Return the saved map of the descriptor, or make it; without the frames that have no position."""
    path = map_file(run, label)
    if path.is_file():
        known = VisualMap.load(path)
        known.check_describer(identity_of(config, descriptor))
        if known.made.get("role") == plain(config.protocol.map):
            return _placed(config, known)
    roles = Roles(config, ("map",))
    known = build_map(config, descriptor, roles.library, roles["map"], "describing the map")
    known.save(path)
    return _placed(config, known)


def _placed(config: DictConfig, known: VisualMap) -> VisualMap:
    has = known.frames.has_position
    usable(config, known.frames, has, "of the map have no position (x, y)")
    return known if has.all() else known.take(np.flatnonzero(has))


def _saved_layer(config: DictConfig, folder: Path, known: VisualMap) -> CoarseLayer | None:
    """Return the layer that was built over this map with these settings, if there is one."""
    if not (folder / "layer.npz").is_file():
        return None
    try:
        layer = CoarseLayer.load(folder / "layer.npz")
        digest = read_json(folder / "placing.json").get("map")
    except FormatError:
        return None
    same = all(layer.made.get(key) == value for key, value in _options(config).items())
    seeded = layer.made.get("seed", config.seed) == config.seed
    return layer if same and seeded and digest == known.digest else None


def _options(config: DictConfig) -> dict[str, Any]:
    """Return how a layer is built, without what it is called."""
    return {key: value for key, value in plain(config.build).items() if key != "label"}


def _placing(built: Built) -> dict[str, Any]:
    reasons = [decision.reason.name for decision in built.decisions]
    return {"seconds": built.seconds.tolist(), "reasons": reasons}


def _print(label: str, build: str, measures: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    closures, purity = measures["closures"], measures["purity"]
    table = Table(box=None, show_header=False, pad_edge=False)
    unit = measures["unit"]
    for name, value in (
        ("layer", f"{build} over {label}"),
        ("nodes", f"{measures['nodes']} over {measures['frames']} frames"),
        ("frames in no node", f"{measures['unassigned']['frames']} ({_percent(measures['unassigned']['share'])})"),
        ("silhouette of points", f"{_number(measures['silhouette']['nearest'])} to the nearest cluster, "
         f"{_number(measures['silhouette']['pooled'])} pooled"),
        ("silhouette of descriptors", _number(measures["descriptor_silhouette"])),
        ("moment of inertia", f"{_number(measures['inertia'])} {unit}^2"),
        ("purity by room", f"{_percent(purity['overall'])} of {purity['frames']} frames"),
        ("loop closures", f"precision {_percent(closures['precision'])} of {closures['closures']}, recall "
         f"{_percent(closures['recall'])} of {closures['revisits']}, F1 {_percent(closures['f1'])}, within "
         f"{closures['radius']:g} {unit}"),
        ("time per frame", f"{_number(measures['ms_per_frame']['median'])} ms median, "
         f"{_number(measures['ms_per_frame']['p95'])} ms 95 %"),
        ("bytes", f"{measures['bytes']['representatives']} of {measures['bytes']['descriptors']}"),
    ):  # fmt: skip
        table.add_row(name, value)
    console = Console()
    console.print(table) if console.is_terminal else Console(width=160).print(table)


def _number(value: float) -> str:
    return f"{value:.3f}" if value == value else "-"


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %" if share == share else "-"
