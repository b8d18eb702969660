"""Installations without torch, Hydra and the rest: no extra at all, and the wheel with the extra of the robot."""

import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

import analytic
from siamloc.data import FrameTable, PanoramaLibrary
from siamloc.maps import build
from siamloc.models import build as network
from siamloc.runtime import export
from tests.installed import printed

ROOT = Path(__file__).parents[1]
PIP = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet")


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """Return a way to run Python with nothing but the wheel, its dependencies and those of the extra `robot`."""
    folder = tmp_path_factory.mktemp("robot")
    subprocess.run([*PIP, "wheel", "--no-deps", "--wheel-dir", folder, ROOT], check=True)
    (wheel,) = folder.glob("siamloc-*.whl")
    constraints = ["--constraint", ROOT / "constraints.txt"]
    subprocess.run([*PIP, "install", "--target", folder / "packages", *constraints, f"{wheel}[robot]"], check=True)

    def run(*arguments):
        environment = {**os.environ, "PYTHONPATH": str(folder / "packages")}
        base = getattr(sys, "_base_executable", sys.executable)
        return subprocess.run(
            [base, "-S", *map(str, arguments)],  # not even what its own installation has
            capture_output=True, text=True, check=False, cwd=folder, env=environment,
        )  # fmt: skip

    return run


@pytest.fixture(scope="module")
def bundle(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bundle")
    generator = np.random.default_rng(0)
    for name in "abc":
        cv2.imwrite(str(folder / f"{name}.png"), generator.integers(0, 256, (64, 512, 3), dtype=np.uint8))
    frames = FrameTable(path=[str(folder / f"{name}.png") for name in "abc"], x=[0, 1, 2], y=[0, 0, 0], theta=[0, 0, 0])
    images = PanoramaLibrary(frames, folder / "cache", image_size=(64, 512))
    made = network("simple1", "flat", image_size=(64, 512))
    export(made, build(made, images, frames, progress=False), folder / "bundle")
    for name in analytic.DESCRIPTORS:
        known = build(name, images, frames, progress=False)
        export(known.descriptor, known, folder / name)
    return folder


def test_without_extras_there_are_data_sets_analytic_descriptors_maps_and_bundles(tmp_path):
    shown = printed(f"""
from pathlib import Path
import siamloc
folder, images = Path({str(tmp_path)!r}), siamloc.data.example()
siamloc.maps.build("hog", images, images.frames, progress=False).save(folder / "map.npz")
siamloc.runtime.export("hog", siamloc.maps.VisualMap.load(folder / "map.npz"), folder / "bundle")
print(siamloc.runtime.Localizer(folder / "bundle").locate(images.frames.path[3]).room, images.frames.room[3])
""")
    assert shown == "office office\n"


def test_without_extras_an_evaluation_and_a_clustering_name_theirs_at_once():
    shown = printed("""
import siamloc
images = siamloc.data.example()
known = siamloc.maps.build("hog", images, images.frames, progress=False)
for call, arguments in (siamloc.evaluation.localization, (images, images.frames)), (siamloc.maps.group, ("spectral",)):
    try:
        call(known, *arguments)
    except ModuleNotFoundError as error:
        print(error)
""")
    needs = "this needs {}, which is not installed here: run pip install '.[train]' in the folder of siamloc's source\n"
    assert shown == needs.format("scipy") + needs.format("sklearn")


@pytest.mark.slow
def test_the_robot_locates_images_without_the_laboratory(robot, bundle):
    done = robot("-m", "siamloc", "localize", f"bundle={bundle / 'bundle'}", f"images={bundle / 'b.png'}", "top=1")
    assert done.returncode == 0, done.stderr
    assert "x 1.00 m, y 0.00 m" in done.stdout
    for name in analytic.DESCRIPTORS:
        done = robot("-m", "siamloc", "localize", f"bundle={bundle / name}", f"images={bundle / 'b.png'}", "top=1")
        assert done.returncode == 0, done.stderr
        heading = ", heading 0 deg" if analytic.descriptor(name).tells_heading else ""
        assert f"x 1.00 m, y 0.00 m{heading}" in done.stdout
    left = ["torch", "scipy", "hydra", "omegaconf", "matplotlib", "lightning", "onnx", "rich"]
    code = f"import importlib.util as u; print([name for name in {left} if u.find_spec(name)])"
    assert robot("-c", code).stdout == "[]\n", "these came along"


@pytest.mark.slow
def test_what_is_lacking_is_said_with_what_brings_it(robot):
    done = robot("-m", "siamloc", "train", "data=cold")
    assert done.returncode == 2
    assert done.stderr.startswith("siamloc: this needs ")
    assert "pip install '.[train]'" in done.stderr
    done = robot("-m", "siamloc", "live", "bundle=x", "images=[y]")
    assert done.returncode == 2
    done = robot("-c", "import siamloc; siamloc.runtime.Live")
    assert "pip install '.[live]'" in done.stderr
    done = robot("-c", "import siamloc; print(siamloc.__path__[0])")
    assert (Path(done.stdout.strip()) / "runtime/assets/live.html").is_file(), done.stderr
    done = robot("-c", "import siamloc; siamloc.models.build")
    assert "this needs torch, which is not installed here: run pip install '.[train]' in" in done.stderr


@pytest.mark.slow
def test_the_doctor_of_a_robot_says_what_it_has_and_lacks(robot):
    done = robot("-m", "siamloc", "doctor")
    assert done.returncode == 0, done.stderr
    assert "CPUExecutionProvider works" in done.stdout
    assert "lacks torch, torchvision" in done.stdout
    assert "self-test     hog described a picture" in done.stdout
