"""`siamloc demo`: the commands of the whole workflow, one after the other."""

from __future__ import annotations

import shlex
import time
from dataclasses import dataclass
from pathlib import Path

from foundation.settings import Seed, Text
from foundation.words import as_words
from siamloc.errors import ConfigError
from siamloc.jobs.choices import Folder
from siamloc.jobs.job import Job, Say, quiet


@dataclass(frozen=True)
class Demo(Job):
    """Run the whole workflow on a small made-up building.

    Draws a building, trains a small network on it, builds its map, measures localization, exports the model,
    locates an image and writes an HTML report. Everything ends up in one folder.

        run=FOLDER       output folder; runs/demo if not given
        seed=0
        overwrite=true   replace an existing run

    Example:
        $ siamloc demo
    """

    folder: Folder = "runs/demo"
    data: Text = "data"
    seed: Seed = 0
    overwrite: bool = False

    def run(self, say: Say = quiet) -> None:
        """Run the commands one after the other, in the folder of the run, from rendering a building to the report."""
        from siamloc.data.image_files import image_files
        from siamloc.runs import Run
        from siamloc.training.run_folder import check_folder

        run, data, begin = Run(Path(self.folder)), Path(self.data), time.monotonic()
        if run.record.is_file() and not self.overwrite:
            raise ConfigError(
                f"{run.folder} holds a run already: replace it with overwrite=true, or choose another run="
            )
        check_folder(run, resume=False, overwrite=self.overwrite)  # before a minute of rendering
        overwrite = " overwrite=true" if self.overwrite else ""
        mini = f"building=mini seed={self.seed} {as_words({'out': data})}"
        runs = "cloudy1,cloudy2,cloudy3,night1,night2,sunny1,sunny2"
        _step(say, "simulate", f"{mini} camera=panorama runs=[{runs}] spacing=0.2{overwrite}")
        _step(say, "simulate", f"{mini} runs=[cloudy1,night1,sunny1] preview=true")
        root, here = as_words({"data.root": data / "mini"}), as_words({"run": run.folder})
        _step(say, "train", f"experiment=demo {root} seed={self.seed}{overwrite} {here}")
        _step(say, "map", here)
        measured = "task.radii=[0.5] task.baselines=[hog,thumbnail,untrained] task.error_model=true"
        _step(say, "evaluate", f"{here} {measured}")
        _step(say, "export", f"{here} thumbnails=true")
        photograph = image_files(next((data / "mini").glob("part_*/*night2/omni_cam")))[0]
        _step(say, "localize", as_words({"run": run.folder, "images": [photograph]}))
        _step(say, "report", here)
        say(f"\nThe run is in {run.folder}, the building in {data / 'mini'} with images in preview; curves for")
        say(f"tensorboard --logdir {shlex.quote(str(run.tensorboard))}; {time.monotonic() - begin:.0f} s in all.")
        drive = as_words({"run": run.folder, "images": [photograph.parent]})
        say(f"To watch a drive at night: siamloc live {drive}")


def _step(say: Say, command: str, words: str) -> None:
    """Show a command as a user would type it, and run it."""
    from siamloc.cli.compose import composed

    say(f"\n$ siamloc {command} {words}")
    composed(command, shlex.split(words)).run(say)
