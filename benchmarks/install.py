"""Measure what each extra takes on the disk, and how long it takes until a fresh process answers.

Each extra is installed into a virtual environment of its own, in a temporary folder, with the tested set of versions.
Its size is that of the installed files without compiled Python code. A start is a process that imports siamloc, shows
`siamloc --version`, or, with the extra `robot`, locates one image with a bundle of the shipped network. Its processor
time is the smallest of five starts with the files in the system's cache; the time on a clock depends on what else the
machine does, and is given next to it. The slowest imports of `import siamloc` are those of `python -X importtime`.

    python -m benchmarks.install
    python -m benchmarks.install --extras robot live --keep --uv     # by uv, and the other rows stay

pip chooses the build of torch: the usual one for Linux brings the libraries of CUDA, some gigabytes more.
"""

from __future__ import annotations

import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.report import Report, parser
from foundation.settings import shortened

ROOT = Path(__file__).parents[1]
EXTRAS = (
    *("base", "robot", "robot-gpu", "robot-openvino", "live", "train", "simulate", "sweeps", "recordings"),
    *("timm", "wandb", "mlflow", "all", "docs", "notebooks"),
)
STARTS = 5


def main() -> None:
    arguments = parser(__doc__, keeps=True)
    arguments.add_argument("--extras", nargs="+", default=EXTRAS, choices=EXTRAS, help="what to install")
    arguments.add_argument("--uv", action="store_true", help="install with uv instead of pip")
    given = arguments.parse_args()
    report, rows = Report("install", given.out), {}
    with tempfile.TemporaryDirectory() as folder:
        wheel = _wheel(Path(folder))
        bundle, image = _bundle(Path(folder))
        for extra in given.extras:
            rows[extra] = _measured(Path(folder) / extra, wheel, extra, given.uv, bundle, image)
            print(extra, shortened(str(rows[extra]), 200), flush=True)
            shutil.rmtree(Path(folder) / extra)
    report.write({"rows": report.kept(rows, EXTRAS) if given.keep else rows})


def _wheel(folder: Path) -> Path:
    subprocess.run(
        [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, ROOT], check=True
    )
    return next(folder.glob("*.whl"))


def _bundle(folder: Path) -> tuple[Path, Path]:
    """Export the shipped network with a map of a few drawn frames, and return the bundle and an image."""
    import siamloc

    images = siamloc.data.example(image_size=(64, 256))
    network = siamloc.models.pretrained()
    siamloc.runtime.export(
        network, siamloc.maps.build(network, images, images.frames, progress=False), folder / "bundle"
    )
    return folder / "bundle", Path(shutil.copy(images.frames.path[0], folder / "photo.png"))


def _measured(venv: Path, wheel: Path, extra: str, uv: bool, bundle: Path, image: Path) -> dict[str, Any]:
    subprocess.run([sys.executable, "-m", "venv", *(["--without-pip"] if uv else []), venv], check=True)
    python = venv / "bin/python"
    what = f"{wheel}[{extra}]" if extra != "base" else str(wheel)
    installer = ["uv", "pip", "install", "--python", python] if uv else [python, "-m", "pip", "install"]
    begin = time.monotonic()
    # No one set pins OpenVINO's build of onnxruntime, which is older.
    constraints = [] if extra == "robot-openvino" else ["--constraint", ROOT / "constraints.txt"]
    subprocess.run([*installer, "--quiet", *constraints, what], check=True)
    row: dict[str, Any] = {
        "installer": "uv" if uv else "pip",
        "seconds": round(time.monotonic() - begin, 1),
        "megabytes": round(_size(venv) / 1e6, 1),
        "packages": len(list(venv.glob("lib/python*/site-packages/*.dist-info"))),
        "import": _start([python, "-c", "import siamloc"]),
        "version": _start([venv / "bin/siamloc", "--version"]),
        "slowest_imports_ms": _slowest(python),
    }
    if extra.startswith("robot"):
        row["localize"] = _start(
            [venv / "bin/siamloc", "localize", f"bundle={bundle}", f"images={image}", "format=csv"]
        )
    return row


def _size(venv: Path) -> int:
    """Return the bytes of the installed packages, without those of a new environment and compiled Python code."""
    packages = next(venv.glob("lib/python*/site-packages"))
    own = re.compile(r"pip|pip-.*|setuptools|setuptools-.*|_distutils_hack|distutils-precedence.pth|pkg_resources")
    return sum(
        path.stat().st_size
        for entry in packages.iterdir()
        if not own.fullmatch(entry.name)
        for path in ([entry] if entry.is_file() else entry.rglob("*"))
        if path.is_file() and not path.is_symlink() and path.suffix != ".pyc"
    )


def _start(command: list[Any]) -> dict[str, float]:
    """Return the least processor time, and the least time on the clock, of some starts after a first one."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    processor, clock = list[float](), list[float]()
    for _ in range(1 + STARTS):
        before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
        subprocess.run(command, check=True, capture_output=True, env=environment, cwd="/")
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        clock.append(time.monotonic() - begin)
        processor.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return {"processor_s": round(min(processor[1:]), 3), "clock_s": round(min(clock[1:]), 3)}


def _slowest(python: Path) -> dict[str, float]:
    shown = subprocess.run(
        [python, "-X", "importtime", "-c", "import siamloc"], check=True, capture_output=True, text=True, cwd="/"
    ).stderr
    times = {name.strip(): int(own) / 1000 for own, name in re.findall(r"import time:\s+(\d+) \|\s+\d+ \|(.*)", shown)}
    return dict(sorted(times.items(), key=lambda one: -one[1])[:5])


if __name__ == "__main__":
    main()
