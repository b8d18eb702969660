"""Every analytic descriptor on the standard benchmark: error by lighting, heading, size and time.

A map of every fifth frame of one cloudy run, and all frames of three other runs as queries. For one row, run:

    siamloc evaluate descriptor=NAME data=freiburg_sim task=absolute

    siamloc simulate camera=panorama out=data
    OMP_NUM_THREADS=2 python -m benchmarks.baselines --data data/freiburg_like
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import siamloc
from analytic import DESCRIPTORS, Descriptor, descriptor
from benchmarks.building import LIGHTINGS, MAP, QUERIES, Building, by_lighting
from benchmarks.report import Report, medians, parser

# The configurations of the mapping experiments ([I] 6.1, [T] 4.5.1), as in conf/descriptor.
MAPPING: dict[str, dict[str, Any]] = {
    "hog_mapping": {"name": "hog", "rows": 16, "bins": 16, "step": 2, "orientation_bins": 16},
    "gist_mapping": {
        "name": "gist",
        "blocks": 16,
        "orientations": 16,
        "step": 2,
        "orientation_filters": 16,
        "orientation_levels": 1,
    },
}
NAMES = (*DESCRIPTORS, *MAPPING)


def main() -> None:
    """Evaluate, print a table and write it."""
    arguments = parser(__doc__)
    arguments.add_argument("--data", type=Path, required=True, help="folder of the rendered building, freiburg_like")
    arguments.add_argument("--names", nargs="+", default=list(NAMES))
    options = arguments.parse_args()
    report, building = Report("baselines", options.out), Building(options.data)
    rows = [row(name, building) for name in options.names]
    print("| descriptor | cloudy | night | sunny | heading | bytes | ms per image |\n|---|---|---|---|---|---|---|")
    for one in rows:
        errors = " | ".join(f"{one['mean_m'][lighting]:.2f}" for lighting in LIGHTINGS)
        heading = "-" if one["heading_median_deg"] is None else f"{one['heading_median_deg']:.1f}"
        print(f"| `{one['name']}` | {errors} | {heading} | {one['bytes']:,} | {one['ms']:.2f} |")
    report.write({"rows": rows})


def named(name: str) -> Descriptor:
    """Return a descriptor by the name of its configuration."""
    options = dict(MAPPING.get(name, {"name": name}))
    return descriptor(**options)


def row(name: str, building: Building) -> dict[str, Any]:
    """Return the figures of one descriptor."""
    known = siamloc.maps.build(named(name), building.images, building.drives(MAP, every=5))
    result = siamloc.evaluation.localization(known, building.images, building.drives(QUERIES), names=("absolute",))
    heading = result.measures.get("heading_error")
    return {
        "name": name,
        "mean_m": by_lighting(result.parts["absolute"]),
        "floor_m": result.measures["floor"]["mean"],
        "heading_median_deg": heading["median"] if heading else None,
        "heading_p95_deg": heading["p95"] if heading else None,
        "queries": result.measures["queries"],
        **cost(name, building),
    }


def cost(name: str, building: Building) -> dict[str, float]:
    """Return the bytes of a description and the milliseconds for one panorama."""
    made, panorama = named(name), building.images.batch([0])[0]
    found = made.describe(panorama)
    size = found.position.nbytes
    if found.orientation is not None and not made.aligned:
        size += found.orientation.nbytes
    return {"bytes": size, "ms": 1e3 * medians({"one": lambda: made.describe(panorama)}, 30)["one"]}


if __name__ == "__main__":
    main()
