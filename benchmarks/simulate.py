"""Measure how fast the simulated building is rendered, compared with a bare ray-casting loop on the same machine.

    python -m benchmarks.simulate [--building freiburg_like] [--frames 500] [--workers 2] [--out FOLDER]

The data set is written to a temporary folder, including baking and JPEG encoding. The bare loop casts the primary rays
of one panorama with Embree and does nothing else; the ratio of the two does not depend on what else the machine does.
"""

from __future__ import annotations

import resource
import tempfile
import time

import numpy as np

from benchmarks.report import Report, parser
from siamloc.simulate import Run, build_scene, load_building, simulate
from siamloc.simulate.camera import CAMERAS, HEIGHT
from siamloc.simulate.rendering import frames, meter


def bare_loop(building: str, camera: str, repeats: int = 20) -> float:
    """Return the CPU seconds needed to cast the primary rays of one image."""
    scene = build_scene(load_building(building, 0), Run("cloudy", 1))
    directions = CAMERAS[camera].pixels.directions[0]
    x, y, _ = scene.state.track.poses[0]
    origins = np.tile(np.array([x, y, HEIGHT], dtype=np.float32), (len(directions), 1))
    begin = time.process_time()
    for _ in range(repeats):
        scene.caster.first_hit(origins, directions)
    return (time.process_time() - begin) / repeats


def processor_seconds(building: str, camera: str, count: int = 40) -> tuple[float, float]:
    """Return the CPU seconds of baking, and of one frame, in a single process."""
    plan = load_building(building, 0)
    begin = time.process_time()
    scene = build_scene(plan, Run("sunny", 1))
    baked = time.process_time() - begin
    track = scene.state.track
    exposure = meter(scene, track)
    rows = np.linspace(0, len(track) - 1, count).astype(int)
    begin = time.process_time()
    for _ in frames(scene, track, CAMERAS[camera], exposure, rows):
        pass
    return baked, (time.process_time() - begin) / count


def main() -> None:
    arguments = parser(__doc__)
    arguments.add_argument("--building", default="freiburg_like")
    arguments.add_argument("--frames", type=int, default=500)
    arguments.add_argument("--workers", type=int, default=2)
    arguments.add_argument("--cameras", nargs="+", default=["panorama", "omnidirectional"])
    options = arguments.parse_args()
    report = Report("simulate", options.out, ("embreex",))
    results = {}
    for camera in options.cameras:
        bare = bare_loop(options.building, camera)
        baked, each = processor_seconds(options.building, camera)
        with tempfile.TemporaryDirectory() as folder:
            summary = simulate(
                out=folder,
                building=options.building,
                runs=["sunny1"],
                frames=options.frames,
                camera=camera,
                workers=options.workers,
            )
        used = [resource.getrusage(who).ru_maxrss / 1024 for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        results[camera] = {
            "frames": summary.rendered,
            "workers": options.workers,
            "wall_s": summary.seconds,
            "frames_per_s": summary.rendered / summary.seconds,
            "baking_cpu_s": baked,
            "frame_cpu_ms": 1000 * each,
            "frames_per_cpu_s_and_core": summary.rendered / (baked + summary.rendered * each),
            "bare_rays_cpu_ms": 1000 * bare,
            "frame_over_bare_rays": each / bare,
            "memory_mib": used[0] + options.workers * used[1],
        }
        print(camera, {key: round(value, 2) for key, value in results[camera].items()})
    settings = {name: value for name, value in vars(options).items() if name != "out"}
    report.write({"settings": settings, "results": results})


if __name__ == "__main__":
    main()
