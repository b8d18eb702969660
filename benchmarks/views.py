"""Measure how fast training images are rendered, and compare with the frames of a data set of the same size and number.

For each random building, images are rendered with `draw_views` as pretraining calls it; and, of offices with matt
surfaces, the same number both with `draw_views`, by plain cameras, and with `frames` from a scene under each of three
lightings. All include drawing the building and baking its light. Times are CPU seconds of a single process that renders
the images one after the other.

    python -m benchmarks.views [--buildings 4]
"""

from __future__ import annotations

import statistics
import time
from dataclasses import asdict

import numpy as np

from benchmarks.report import Report, hardware, parser
from siamloc.data.panorama import PanoramaView
from siamloc.pretraining import RECIPE, ViewSettings
from siamloc.simulate import Run, build_scene, draw_views, load_building
from siamloc.simulate.camera import PanoramaCamera
from siamloc.simulate.rendering import frames, meter
from siamloc.simulate.run import LIGHTINGS
from siamloc.simulate.views import FIRST_SEED

LEAST_FASTER, LEAST_RATE = 3.0, 100
PLAIN = ViewSettings(cameras="built_in", worlds="offices", imaging="plain")


def quick(seed: int, wanted: ViewSettings | None = None) -> tuple[int, float]:
    """Return the number of images of a building, and the CPU seconds they took."""
    wanted = wanted or ViewSettings()
    begin = time.process_time()
    views = draw_views(*wanted.drawn(seed, RECIPE.image_size))
    return len(views), time.process_time() - begin


def plain(seed: int, count: int) -> tuple[int, float]:
    """Return the same for `count` frames of a data set."""
    camera = PanoramaCamera(PanoramaView(*RECIPE.image_size))
    begin, rendered = time.process_time(), 0
    building = load_building("random", FIRST_SEED + seed)
    for lighting in LIGHTINGS:
        scene = build_scene(building, Run(lighting, 1))
        track = scene.state.track
        rows = np.linspace(0, len(track) - 1, count // len(LIGHTINGS)).astype(int)
        rendered += sum(1 for _ in frames(scene, track, camera, meter(scene, track), rows.tolist()))
    return rendered, time.process_time() - begin


def main() -> None:
    """Render both ways, print the ratio and write the file."""
    arguments = parser(__doc__)
    arguments.add_argument("--buildings", type=int, default=4)
    options = arguments.parse_args()
    report = Report("views", options.out, ("embreex",))
    quick(0)  # warm-up
    rows = []
    for seed in range(options.buildings):
        rates = {}
        for name, settings in {"views_per_s": ViewSettings(), "plain_views_per_s": PLAIN}.items():
            pictures, seconds = quick(seed, settings)
            rates[name] = pictures / seconds
        others, longer = plain(seed, pictures)
        rows.append({**rates, "frames_per_s": others / longer})
        print(f"building {seed}: {', '.join(f'{rate:.0f}' for rate in rows[-1].values())} images/s")
    ratio = statistics.median(row["plain_views_per_s"] / row["frames_per_s"] for row in rows)
    rate = statistics.median(row["views_per_s"] for row in rows)
    print(
        f"{rate:.0f} images per second on one core; plain ones {ratio:.1f} times as many as frames; {hardware()['cpu']}"
    )
    report.target(f"at least {LEAST_RATE} images per second on one core ({rate:.0f})", rate >= LEAST_RATE)
    report.target(f"plain: at least {LEAST_FASTER} times as many as frames ({ratio:.1f})", ratio >= LEAST_FASTER)
    about = {**asdict(ViewSettings()), "image_size": list(RECIPE.image_size), "buildings": options.buildings}
    report.write({"settings": about, "rows": rows, "pictures_per_core_s": rate, "ratio": ratio})


if __name__ == "__main__":
    main()
