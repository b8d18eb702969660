"""Measure compact maps: both versions of the incremental mapper next to clustering and plain sampling.

    python -m benchmarks.mapping --data FOLDER [--out FOLDER] [--pictures FOLDER] [--spacing METRES] [--quick] [--scale]

FOLDER is the output of `siamloc simulate camera=panorama building=freiburg_like`. The map is path 2, cloudy1, with all
its frames or one every `--spacing` metres, described by HOG with the settings of [I] 6.1. Version 2 uses the y and
omega of [T] 4.6.1; spectral clustering and sampling get its number of nodes. The result of spectral clustering depends
on where its k-means starts: the table shows the median of 21 seeds by silhouette, with the lowest and the highest.
Silhouettes are those of the capture points. `silhouette` compares each frame with the nearest other node ([C] 8-9), and
the frames in no node count as one more node: otherwise a map that leaves out the difficult frames would look good.
`nearest` leaves these frames out, and so does `pooled` ([I] eq. 12-13), which takes all other nodes together. With
`--pictures`, the sweeps of y and omega ([I] figure 9) and of the number of clusters ([I] figures 11, 12) are drawn.
`--scale` adds 20,000 frames in one run.

Targets: the silhouette of version 2 is at least that of version 1, and that of spectral clustering with as many
nodes; version 2 leaves at most 5 % of the frames out of its nodes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from benchmarks import sweeps
from benchmarks.baselines import named
from benchmarks.report import Report, parser
from siamloc.data import PanoramaLibrary, read
from siamloc.evaluation import mapping
from siamloc.maps import VisualMap, build, group
from siamloc.report.draw.look import save

SEQUENCE = "*seq2_cloudy1"
YS = (0.75, 1.0, 1.25, 1.5, 1.75, 2.0, 2.25)
OMEGAS = (1.7, 1.85, 2.0, 2.15, 2.3)
CLUSTERS = (4, 6, 8, 10, 12, 16, 20, 24, 30, 36, 42, 50, 60)
GRIDS = ((2, 2), (3, 2), (4, 2), (5, 2), (4, 3), (4, 4), (5, 4), (6, 4), (6, 5), (6, 6), (7, 6), (10, 5), (10, 6))
RADIUS, GAP = 1.0, 30
SEEDS = 21
MOST_UNASSIGNED = 5.0


def main() -> None:
    arguments = parser(__doc__)
    arguments.add_argument("--data", type=Path, help="folder of the rendered building; not needed with --only-scale")
    arguments.add_argument("--pictures", type=Path, metavar="FOLDER", help="draw the sweeps into this folder")
    arguments.add_argument("--spacing", type=float, default=0.0, help="metres between map frames; all frames if 0")
    arguments.add_argument("--quick", action="store_true", help="every third value of the sweeps, short drives")
    arguments.add_argument("--scale", action="store_true", help="also 20,000 frames in one run")
    arguments.add_argument("--only-scale", action="store_true", help="run nothing but --scale")
    arguments.add_argument("--places", type=Path, default=Path("../shared/data/cold_places"), help="poses for --scale")
    options = arguments.parse_args()
    if options.data is None and not options.only_scale:
        arguments.error("--data is needed: the folder that `siamloc simulate camera=panorama` rendered")
    figures: dict[str, Any] = {}
    if not options.only_scale:
        report = Report("mapping", options.out, packages=("scipy", "scikit-learn"))
        figures = compare(options, report)
        report.write(figures)
    if options.scale or options.only_scale:
        from benchmarks import mapping_scale

        mapping_scale.run(options.places, options.out, options.quick)


def compare(options: Any, report: Report) -> dict[str, Any]:
    """Compare both versions with the other methods on one drive, and run the sweeps."""
    known = described(options.data, options.spacing)
    print(f"{len(known)} frames of {known.frames.sequence[0]}")
    table = [measured(known, f"incremental, version {v}", incremental(v, 1.5, 1.85)) for v in (2, 1)]
    nodes = table[0]["nodes"]
    sooner = incremental(2, 1.5, 1.85) | {"checked_unassigned": 12}
    early = measured(known, "incremental, version 2, checked_unassigned=12", sooner)
    table.append(typical(known, nodes))
    table.append(measured(known, f"sample, {nodes}", batch("sample", nodes)))
    table.append(typical(known, table[1]["nodes"]))
    step = 3 if options.quick else 1
    grid = [
        {"version": version, "y": y, "omega": omega}
        | measured(known, f"version {version}, y {y}, omega {omega}", incremental(version, y, omega))
        for version in (1, 2)
        for y in YS[::step]
        for omega in OMEGAS[:: min(step, 2)]
    ]
    others = [("spectral", count) for count in CLUSTERS[::step]] + [("sample", count) for count in CLUSTERS[::step]]
    curve = [{"method": name} | measured(known, f"{name}, {n}", batch(name, n)) for name, n in others]
    for size in GRIDS[::step]:
        row = measured(known, f"som, {size[0]} x {size[1]}", {"name": "som", "grid": size})
        curve.append({"method": "som"} | row)
    judge(report, table)
    print_table(table)
    if options.pictures is not None:
        draw(options.pictures, table, grid, curve)
    best = max((row for row in grid if row["version"] == 2), key=lambda row: row["silhouette"])
    return {
        "frames": len(known),
        "spacing": options.spacing or "that of the data",
        "table": table,
        "y_and_omega": grid,
        "clusters": curve,
        "nodes_sooner": [early, typical(known, early["nodes"])],
        "best_of_version_2": best,
    }


def described(data: Path, spacing: float) -> VisualMap:
    """Return the map frames, described."""
    frames = read("cold", root=data).select(sequence=SEQUENCE)
    if spacing > 0:
        frames = frames.spaced(spacing)
    return build(named("hog_mapping"), PanoramaLibrary(frames, image_size=(128, 512)), frames)


def incremental(version: int, y: float, omega: float) -> dict[str, Any]:
    return {"name": "incremental", "version": version, "y": y, "omega": omega}


def batch(name: str, nodes: int) -> dict[str, Any]:
    more = {"sigma": None, "neighbours": None, "assign": "kmeans"} if name == "spectral" else {}
    return {"name": name, "nodes": nodes, **more}


def typical(known: VisualMap, nodes: int) -> dict[str, Any]:
    """Return the measures of the spectral clustering with the median silhouette over seeds, and the range."""
    every = [measured(known, f"spectral, {nodes}", batch("spectral", nodes), seed) for seed in range(SEEDS)]
    every.sort(key=lambda row: row["silhouette"])
    return {**every[SEEDS // 2], "lowest": every[0]["silhouette"], "highest": every[-1]["silhouette"]}


def measured(known: VisualMap, what: str, options: dict[str, Any], seed: int = 0) -> dict[str, Any]:
    """Build a layer and measure it."""
    parameters = {key: value for key, value in options.items() if key != "name"}
    built = group(known, options["name"], seed=seed, progress=False, **parameters)
    found = mapping(known, built, closure_radius=RADIUS, closure_gap=GAP).parts["mapping"]
    closures = found["closures"]
    return {
        "what": what,
        "nodes": found["nodes"],
        "unassigned": round(100 * found["unassigned"]["share"], 1),
        "silhouette": _rounded(found["silhouette"]["with_unassigned"]),
        "nearest": _rounded(found["silhouette"]["nearest"]),
        "pooled": _rounded(found["silhouette"]["pooled"]),
        "descriptors": _rounded(found["descriptor_silhouette"]),
        "inertia": _rounded(found["inertia"]),
        "purity": _rounded(found["purity"]["overall"]),
        "precision": _rounded(closures["precision"]),
        "recall": _rounded(closures["recall"]),
        "f1": _rounded(closures["f1"]),
        "ms_per_frame": _rounded(found["ms_per_frame"]["mean"]),
    }


def judge(report: Report, table: list[dict[str, Any]]) -> None:
    second, first, spectral = table[:3]
    for rival in (first, spectral):
        what = f"silhouette of version 2 ({second['silhouette']}) at least that of {rival['what']}"
        spread = f", {rival['lowest']} to {rival['highest']} over seeds" if "lowest" in rival else ""
        report.target(f"{what} ({rival['silhouette']}{spread})", second["silhouette"] >= rival["silhouette"])
    share = second["unassigned"]
    report.target(f"version 2 leaves at most {MOST_UNASSIGNED:g} % out ({share} %)", share <= MOST_UNASSIGNED)


def draw(folder: Path, table: list[dict[str, Any]], grid: list[dict[str, Any]], curve: list[dict[str, Any]]) -> None:
    points = [{**table[1], "version": 1}, {**table[0], "version": 2}]
    for figure, name in (
        (sweeps.heat_maps(grid), "mapping_sweep.png"),
        (sweeps.silhouette_against_clusters(curve, points), "clusters.png"),
    ):
        print(f"picture: {save(figure, folder / name)}")


def print_table(table: list[dict[str, Any]]) -> None:
    columns = [name for name in table[0] if name != "what"]
    print(f"{'':<24}" + "".join(f"{name:>13}" for name in columns))
    for row in table:
        print(f"{row['what']:<24}" + "".join(f"{row[name]!s:>13}" for name in columns))


def _rounded(value: float) -> float | None:
    return None if value != value else round(float(value), 3)


if __name__ == "__main__":
    main()
