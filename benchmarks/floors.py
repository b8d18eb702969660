"""Measure floors, the mean distance from the queries to the nearest map frame, from the poses of whole drives.

No retrieval that answers with a map frame has a smaller mean error. A floor depends on the distance between map frames,
so errors of two data sets can be compared only where the maps are equally dense in metres. COLD's frames are about 4 cm
apart and those of the simulated building about 15 cm, so one in five is not the same on both.

    siamloc simulate camera=panorama out=data
    python -m benchmarks.floors --data data/freiburg_like --lists ../shared/data/cold_places

Each map is one drive; the queries are all frames of each drive along its path. `--lists` names a folder of COLD's lists
of poses, `<building>_seq<path>_<run>.places.lst`. The floors of a map that leaves out a room are larger: Freiburg's
cloudy1 has no kitchen.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from benchmarks.report import Report, parser
from siamloc.data import FrameTable, read
from siamloc.data.cold import read_list

MAPS = {"all": {}, "1 in 5": {"every": 5}, "1 in 20": {"every": 20}, "15 cm apart": {"spacing": 0.15}}
"""How the frames of the map are selected."""


def main() -> None:
    """Measure, print and write the floors."""
    arguments = parser(__doc__)
    arguments.add_argument("--data", type=Path, required=True, help="folder of the rendered building, freiburg_like")
    arguments.add_argument("--lists", type=Path, required=True, help="folder of COLD's lists of poses")
    options = arguments.parse_args()
    frames = read("cold", root=options.data)
    drives = {name.rpartition("_")[2]: frames.select(sequence=name) for name in frames.rows_by("sequence")}
    rows = {"freiburg_like": floors(drives, "cloudy3", ("cloudy2", "night2", "sunny2"))}
    lists = {path.name.partition(".")[0]: listed(path) for path in sorted(options.lists.glob("*.places.lst"))}
    for name in lists:
        path, _, run = name.rpartition("_")
        drives = {each.rpartition("_")[2]: found for each, found in lists.items() if each.startswith(f"{path}_")}
        if len(drives) > 1:
            rows[f"COLD {path}, map {run}"] = floors(drives, run, tuple(drives))
    for name, row in rows.items():
        print(name, *(f"{way}: {found}" for way, found in row["maps"].items()), sep="\n  ")
    Report("floors", options.out).write({"rows": rows})


def floors(drives: Mapping[str, FrameTable], of_map: str, queries: tuple[str, ...]) -> dict[str, Any]:
    """Return the frames, their mean distance and the floors of maps of one drive."""
    maps = {}
    for way, options in MAPS.items():
        known = drives[of_map].every(options["every"]) if "every" in options else drives[of_map]
        known = known.spaced(options["spacing"]) if "spacing" in options else known
        tree = KDTree(known.xy)
        found = {name: round(float(tree.query(drives[name].xy)[0].mean()), 3) for name in queries}
        apart = round(float(np.hypot(*np.diff(known.xy, axis=0).T).mean()), 3)
        maps[way] = {"frames": len(known), "apart_m": apart, "floor_m": found}
    return {"map": of_map, "queries": {name: len(drives[name]) for name in queries}, "maps": maps}


def listed(path: Path) -> FrameTable:
    """Read a list of poses."""
    poses = read_list(path)
    return FrameTable(
        path=[one["image"] for one in poses], x=[one["x"] for one in poses], y=[one["y"] for one in poses]
    )


if __name__ == "__main__":
    main()
