"""`siamloc demo`: the whole main job on a small made-up building."""

from __future__ import annotations

import time
from importlib import import_module
from pathlib import Path

from omegaconf import DictConfig

from siamloc.cli.compose import run_composed
from siamloc.cli.help import COMMANDS
from siamloc.data.frames import image_files
from siamloc.errors import ConfigError
from siamloc.runs import Run

RUNS = ("cloudy1", "cloudy2", "cloudy3", "night1", "night2", "sunny1", "sunny2")


def main(config: DictConfig) -> None:
    """Simulate, train, map, evaluate, export, localize, report."""
    run = Run(Path(config.run))
    if run.record.is_file() and not config.overwrite:
        raise ConfigError(f"{run.folder} holds a run already: replace it by overwrite=true, or choose another run=")
    begin = time.monotonic()
    data = run.folder / "data"
    mini = ["building=mini", f"seed={config.seed}", f"out={data}"]
    overwrite = ["overwrite=true"] if config.overwrite else []
    _step("simulate", [*mini, "camera=panorama", f"runs=[{','.join(RUNS)}]", "spacing=0.2", *overwrite])
    _step("simulate", [*mini, "runs=[cloudy1,night1,sunny1]", "preview=true"])
    here = [f"run={run.folder}"]
    own = [f"data.root={data}", f"data.cache={run.folder / 'panoramas'}", f"seed={config.seed}"]
    _step("train", ["experiment=demo", *own, *overwrite, *here])
    _step("map", [*here, "heading=hog"])
    _step("evaluate", [*here, "task.error_model=true"])
    _step("export", here)
    photograph = image_files(next(data.glob("*/part_*/*night2/omni_cam")))[0]
    _step("localize", [*here, f"images=['{photograph}']"])
    _step("report", here)
    print(f"\nEverything lies in {run.folder}, the building's pictures in {data / 'mini' / 'preview'}, curves for")
    print(f"tensorboard --logdir {run.folder / 'tensorboard'}; {time.monotonic() - begin:.0f} s in all.")


def _step(command: str, words: list[str]) -> None:
    """Show a command as one would type it, and run it."""
    print(f"\n$ siamloc {command} {' '.join(words)}", flush=True)
    module = import_module(f"siamloc.cli.{COMMANDS[command].module}")
    run_composed(command, module.main, words)
