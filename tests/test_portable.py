"""The main job where there is nothing of Linux: no fcntl, no /proc, no processor affinity, and processes by spawn."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
# Hide what other systems lack, before anything of ours is imported. A spawned process runs this again.
HIDDEN = """
import builtins, io, os, pathlib, signal, sys, warnings

sys.modules.update(dict.fromkeys(["fcntl", "resource", "pwd", "grp", "termios"]))
for module, name in ((os, "sched_getaffinity"), (os, "fork"), (signal, "pthread_kill")):
    delattr(module, name) if hasattr(module, name) else None


def there(look):
    return lambda path: not str(path).startswith("/proc") and look(path)


for look in ("exists", "is_file", "is_symlink"):
    setattr(pathlib.Path, look, there(getattr(pathlib.Path, look)))
usual = io.open


def opened(file, *arguments, **keywords):
    if str(file).startswith("/proc"):
        raise FileNotFoundError(file)
    return usual(file, *arguments, **keywords)


builtins.open = io.open = opened
warnings.filterwarnings("ignore", "only soft file lock is available")
"""
JOB = (
    HIDDEN
    + """
if __name__ == "__main__":
    import multiprocessing

    multiprocessing.set_start_method("spawn")
    import siamloc

    images = siamloc.data.example()
    monday, tuesday = images.frames.select(sequence="monday"), images.frames.select(sequence="tuesday")
    network = siamloc.models.build("simple1", "flat", image_size=(16, 64))
    siamloc.training.fit(
        network, images, monday, run="run", epochs=1, batch_size=4, workers=1,
        trainer={"accelerator": "cpu"}, augmentation="thesis",
    )
    known = siamloc.maps.build(network, images, monday, progress=False)
    print(siamloc.evaluation.localization(known, images, tuesday).measures["error"]["mean"])
    siamloc.runtime.export(network, known, "bundle")
    found = siamloc.runtime.Localizer("bundle").locate(str(tuesday.path[0]))
    print(found.room, found.x)
"""
)
IMPORTS = HIDDEN + "import siamloc.cli, siamloc.jobs, siamloc.checkup, analytic, augment, foundation.locks, filelock\n"


def ran(code, folder):
    path = folder / "job.py"
    path.write_text(code)
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    done = subprocess.run([sys.executable, path], capture_output=True, text=True, cwd=folder, env=environment)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_imports_need_nothing_of_linux(tmp_path):
    assert ran(IMPORTS, tmp_path) == ""


@pytest.mark.slow
def test_the_main_job_runs_without_anything_of_linux(tmp_path):
    shown = ran(JOB, tmp_path).splitlines()
    assert float(shown[-2]) >= 0
    assert shown[-1].split()[0] in ("office", "hall", "lab")
