"""`siamloc simulate`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from foundation.words import as_words
from siamloc.jobs.job import Job, Say, quiet
from siamloc.simulate.produce import SimulateConfig, Summary, simulate


@dataclass(frozen=True)
class Simulate(SimulateConfig, Job):
    """Render a made-up building in the COLD layout.

    Renders drives of a robot with an omnidirectional camera in cloudy, night and sunny light, and writes them with
    COLD's folders and file names. The same seed gives the same bytes, whatever the number of workers.

        building=freiburg_like      or annex, mini, random, or a YAML file: docs/howto/building.md
        out=data                    output folder
        runs=[cloudy1,night1]       lighting and number; each number is a different hour of a different day
        path=path2                  the route through the building
        trajectory=FILE.places.lst  or a COLD list of poses: one image for each
        spacing=0.15                metres after which a frame is taken; after 20 degrees of turning, earlier
        path=grid                   no route: a grid of positions over the free floor, spacing metres apart
        path=halfway                the middles of the grid's squares: queries for such a map
        positions=11 headings=16    with these two: number of positions in each run, of frames at each of them
        hours=[9,15.5]              solar time of each run, 7 to 17 but for nights; also dims a cloudy sky
        months=6                    drive again in each of six later months, which move and exchange furniture
        camera=omnidirectional      640 x 480; or panorama: 512 x 128, already unwrapped
        workers=2 seed=0
        preview=true                only a contact sheet and a floor plan

    Example:
        $ siamloc simulate camera=panorama
        $ siamloc simulate camera=panorama path=grid spacing=0.4 runs=[cloudy1] out=data/grid
    """

    def run(self, say: Say = quiet) -> Summary:
        """Render the building."""
        summary = simulate(settings=self)
        for path in summary.files:
            say(f"picture: {path}")
        for line in summary.lines():
            say(line)
        if summary.sequences:
            say(f"{summary.folder}: {summary.rendered} frames rendered in {summary.seconds:.0f} s{summary.rate}")
            say(f"next: siamloc train experiment=modern {as_words(self._drives_to_train(summary))}")
        return summary

    def _drives_to_train(self, summary: Summary) -> dict[str, Any]:
        """Return settings of a training on the drives: the last is left for queries, the one before for validation."""
        names = list(summary.sequences)
        roles = {
            "train": names[:-2] or names[:1],
            "validation": names[-2:-1] if names[2:] else [],
            "query": names[1:][-1:],
        }
        unwrap = "none" if self.camera == "panorama" else "hyperbolic"
        chosen = {"data": "cold", "data.root": str(summary.folder), "unwrap": unwrap}
        return {**chosen, **{f"protocol.{role}.sequences": drives for role, drives in roles.items() if drives}}
