"""Every analytic descriptor on the standard benchmark: error by lighting, heading, size and time.

Each row is what `siamloc evaluate descriptor=NAME data=freiburg_sim task=absolute` gives: a map of every fifth frame of
one cloudy run, and all frames of three other runs as queries.

    siamloc simulate camera=panorama out=data
    OMP_NUM_THREADS=2 python -m benchmarks.baselines --data data/freiburg_like
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import analytic
import siamloc.cli
from benchmarks.report import Report, medians, parser
from siamloc.cli.steps import descriptor_options
from siamloc.data.decoding import read_image

NAMES = ("hog", "gist", "wisurf", "briefgist", "fs", "radon_fourier", "radon_poc", "hsv", "hog_mapping", "gist_mapping")
LIGHTINGS = ("cloudy", "night", "sunny")


def main() -> None:
    """Evaluate, print a table and write it."""
    arguments = parser(__doc__)
    arguments.add_argument("--data", type=Path, required=True, help="folder of the rendered building, freiburg_like")
    arguments.add_argument("--names", nargs="+", default=[*NAMES, "thumbnail"])
    options = arguments.parse_args()
    report = Report("baselines", options.out)
    with tempfile.TemporaryDirectory() as folder:
        rows = [row(name, options.data, Path(folder)) for name in options.names]
    print("| descriptor | cloudy | night | sunny | heading | bytes | ms per image |\n|---|---|---|---|---|---|---|")
    for one in rows:
        errors = " | ".join(f"{one['mean_m'][lighting]:.2f}" for lighting in LIGHTINGS)
        heading = "-" if one["heading_median_deg"] is None else f"{one['heading_median_deg']:.1f}"
        print(f"| `{one['name']}` | {errors} | {heading} | {one['bytes']:,} | {one['ms']:.2f} |")
    report.write({"rows": rows})


def row(name: str, data: Path, folder: Path) -> dict[str, Any]:
    """Return the figures of one descriptor."""
    run = folder / name
    words = [f"descriptor={name}", "data=freiburg_sim", f"data.root={data}", "task=absolute", f"run={run}"]
    if siamloc.cli.main(["evaluate", *words, "task.baselines=[]", "task.plots=false"]) != 0:
        raise SystemExit(f"siamloc evaluate {' '.join(words)} failed")
    results = json.loads((run / "evaluation" / name / "results.json").read_text(encoding="utf-8"))
    absolute = results["measures"]["absolute"]
    heading = absolute["overall"].get("heading_error")
    return {
        "name": name,
        "mean_m": {lighting: absolute["lighting"][lighting]["error"]["mean"] for lighting in LIGHTINGS},
        "floor_m": absolute["overall"]["floor"]["mean"],
        "heading_median_deg": heading["median"] if heading else None,
        "heading_p95_deg": heading["p95"] if heading else None,
        "queries": absolute["overall"]["queries"],
        **cost(name, next(data.glob("**/omni_cam/*.jpeg"))),
    }


def cost(name: str, image: Path) -> dict[str, float]:
    """Return bytes of a description and milliseconds for one panorama."""
    options = descriptor_options(name)
    options.pop("label", None)
    kind = options.pop("name")
    made = analytic.Thumbnail(**options) if kind == "thumbnail" else analytic.descriptor(kind, **options)
    panorama = np.ascontiguousarray(read_image(image).transpose(2, 0, 1))
    found = made.describe(panorama)
    size = found.position.nbytes
    if found.orientation is not None and not made.aligned:
        size += found.orientation.nbytes
    return {"bytes": size, "ms": 1e3 * medians({"one": lambda: made.describe(panorama)}, 30)["one"]}


if __name__ == "__main__":
    main()
