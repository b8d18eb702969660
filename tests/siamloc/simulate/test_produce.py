"""Writing data sets: layout, equal bytes, resuming, and refusals."""

from __future__ import annotations

import hashlib
import os
import pickle
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import cv2
import numpy as np
import pytest

from foundation.files import read_json
from siamloc.cli import main
from siamloc.cli.compose import composed
from siamloc.data.cold import read_cold
from siamloc.errors import ConfigError, DataError
from siamloc.runtime.stream import read_odometry
from siamloc.simulate import Run, Summary, load_building, produce, simulate
from siamloc.simulate.buildings import building_folder
from siamloc.simulate.camera import Exposure
from siamloc.simulate.layout import Building
from siamloc.simulate.preview import floor_plan
from siamloc.simulate.produce import STANDARD_RUNS
from siamloc.simulate.scene import Scene

SMALL = {"building": "mini", "runs": ["cloudy1"], "frames": 6, "camera": "panorama", "workers": 1}


def small(**changes: Any) -> Summary:
    return simulate(**{**SMALL, **changes})


def hashes(folder: Path) -> dict[str, str]:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.fixture(autouse=True, scope="module")
def scenes_built_once() -> Iterator[None]:
    """Build and meter the scene of a run through one building once: pictures leave it as it is."""
    build, meter, scenes, exposures = produce.build_scene, produce.meter, {}, {}

    def scene_of(building: Building, run: Run) -> Scene:
        key = pickle.dumps((building, run))
        if key not in scenes:
            scenes[key] = build(building, run)
            exposures[id(scenes[key])] = meter(scenes[key], scenes[key].state.track)
        return scenes[key]

    def exposure_of(scene: Scene, _: object) -> Exposure:
        return exposures[id(scene)]

    with mock.patch.object(produce, "build_scene", scene_of), mock.patch.object(produce, "meter", exposure_of):
        yield


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("sim")
    small(out=out)
    return out


def test_the_cold_reader_reads_it(written: Path) -> None:
    table = read_cold(written / "mini", on_error="raise")
    labels = [set(column.tolist()) for column in (table.sequence, table.lighting, table.room)]
    assert (len(table), labels) == (6, [{"mini_a_seq2_cloudy1"}, {"cloudy"}, {"CR-A"}])
    assert table.has_position.all()
    assert table.odometry[0].tolist() == [0, 0, 0]
    driven, reported = (np.hypot(*np.diff(xy, axis=0).T) for xy in (table.xy, table.odometry[:, :2]))
    np.testing.assert_allclose(reported, driven, rtol=0.2)
    assert not np.allclose(reported, driven, rtol=0.001)
    wheels = read_odometry(written / "mini/part_a/seq2_cloudy1/localization/odometry.csv")
    assert set(wheels) == {os.path.abspath(path) for path in table.path}  # noqa: PTH100
    image = cv2.imread(str(table.path[0]))
    assert image.shape == (128, 512, 3)
    assert image.std() > 10


def test_equal_bytes_with_other_worker_counts(written: Path, tmp_path: Path) -> None:
    small(out=tmp_path / "two", frames=17, workers=2)
    small(out=tmp_path / "one", frames=17, workers=1)
    two = hashes(tmp_path / "two")
    assert two == hashes(tmp_path / "one")
    for name, value in hashes(written).items():
        if name.endswith(".jpeg"):
            assert two[name] == value
    assert sum(name.endswith(".jpeg") for name in two) == 17
    table = Path("mini/part_a/seq2_cloudy1/localization/odometry.csv")
    short, long = ((out / table).read_text() for out in (written, tmp_path / "one"))
    assert long.startswith(short), "fewer frames of the same drive"
    small(out=tmp_path / "other", seed=1, frames=1)
    assert not set(hashes(tmp_path / "other").values()) & set(two.values()), "another seed is another building"


def test_an_interrupted_rendering_goes_on(
    written: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    real, done = produce.write_picture, []

    def stopping(path: Path, picture: np.ndarray, quality: int) -> None:
        if len(done) == 3:
            raise KeyboardInterrupt
        done.append(path)
        real(path, picture, quality)

    monkeypatch.setattr(produce, "write_picture", stopping)
    with pytest.raises(KeyboardInterrupt):
        small(out=tmp_path)
    sequence = tmp_path / "mini" / "part_a" / "seq2_cloudy1"
    assert len(list((sequence / "omni_cam").iterdir())) == 3
    assert not (sequence / "localization" / "places.lst").exists()
    monkeypatch.setattr(produce, "write_picture", real)
    summary = small(out=tmp_path)
    assert summary.rendered == 3
    assert hashes(tmp_path) == hashes(written)
    assert "rendering mini: 3 of 3" in capsys.readouterr().err
    again = small(out=tmp_path)
    assert "rendering" not in capsys.readouterr().err
    first = f"{tmp_path / 'mini'}: 0 frames rendered in {again.seconds:.0f} s"
    assert repr(again).splitlines() == [first, "  mini_a_seq2_cloudy1: 6 frames", "  rooms: CR-A 6"]


def test_images_of_somebody_else_are_never_replaced(tmp_path: Path) -> None:
    image = tmp_path / "mini" / "part_a" / "seq2_cloudy1" / "omni_cam" / "t5.0_x1.0_y1.1_a0.0.jpeg"
    image.parent.mkdir(parents=True)
    image.write_bytes(b"mine")
    with pytest.raises(DataError, match="holds images that simulate did not render"):
        small(out=tmp_path, overwrite=True)
    assert image.read_bytes() == b"mine"


def test_the_present_folder_is_an_output_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", "out=.", "building=mini", "runs=[cloudy1]", "frames=1", "camera=panorama"]) == 0
    assert len(list((tmp_path / "mini").rglob("*.jpeg"))) == 1
    assert small(out=".", frames=1).rendered == 0


def test_rendering_without_the_ray_caster_is_refused_in_one_sentence(tmp_path: Path) -> None:
    code = """if True:
        import sys
        sys.modules["embreex"] = None
        from siamloc.errors import SiamlocError
        from siamloc.simulate import Run, build_scene, load_building, simulate
        mini = load_building("mini")
        for render in (lambda: simulate(out=sys.argv[1], building="mini"), lambda: build_scene(mini, Run())):
            try:
                render()
            except SiamlocError as error:
                print(error)
        """
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, check=True)
    words = "rendering needs the package embreex: run pip install '.[simulate]' in the folder of siamloc's source"
    assert done.stdout.splitlines() == [words] * 2
    assert not any(tmp_path.iterdir())


def test_another_simulation_is_not_mixed_in(written: Path, tmp_path: Path) -> None:
    small(out=tmp_path, frames=2)
    with pytest.raises(DataError, match=r"holds images of another simulation \(different: spacing\)"):
        small(out=tmp_path, spacing=0.3)
    next(tmp_path.rglob("camera.json")).write_text("[1]")
    with pytest.raises(DataError, match=r"holds images of another simulation \(different: camera.json\)"):
        small(out=tmp_path, frames=2)
    assert small(out=tmp_path, spacing=0.3, frames=2, overwrite=True).rendered == 2


def test_omnidirectional_pictures_and_lists(tmp_path: Path) -> None:
    names = ["t5.000000_x1.000000_y1.100000_a0.000000.jpeg", "t5.200000_x1.100000_y1.100000_a0.000000.jpeg"]
    poses = tmp_path / "night.places.lst"
    poses.write_text("".join(f"{name} CR-A\n" for name in names))
    summary = simulate(building="mini", out=tmp_path, workers=1, trajectory=poses, hours=[23])
    assert read_json(summary.folder / "part_a" / "seq2_night1" / "camera.json")["hour"] == 23
    images = summary.folder / "part_a" / "seq2_night1" / "omni_cam"
    assert sorted(path.name for path in images.iterdir()) == names
    image = cv2.imread(str(images / names[0]))
    assert image.shape == (480, 640, 3)
    assert image[5, 5].max() < 12  # outside the mirror
    assert summary.rooms == {"CR-A": 2}


def test_a_grid_is_a_run_like_others(tmp_path: Path) -> None:
    asked = {"path": "grid", "spacing": 0.8, "runs": ["cloudy2"], "hours": [9], "headings": 2, "positions": 2}
    asked |= {"frames": None, "out": tmp_path}
    assert small(**asked).sequences == {"mini_a_seq1_cloudy2": 4}
    table = read_cold(tmp_path / "mini", on_error="raise")
    assert table.lighting.tolist() == ["cloudy"] * 4
    assert np.isnan(table.odometry).all(), "nobody drives"
    with pytest.raises(DataError, match=r"another simulation \(different: hour\)"):
        small(**asked | {"hours": [15]})


@pytest.mark.parametrize(("camera", "drives"), [("omnidirectional", [1]), ("panorama", [2, 4])])
def test_the_next_command_is_a_training_on_the_drives(tmp_path: Path, capsys, camera: str, drives: list[int]) -> None:
    for number in drives:  # what is there already is not rendered again
        runs = ["cloudy1", "night1", "sunny1", "sunny2"][:number]
        given = [f"runs=[{','.join(runs)}]", f"camera={camera}", f"out={tmp_path / 'my data'}"]
        assert main(["simulate", "building=mini", "frames=2", "workers=1", *given]) == 0
        *said, follows = capsys.readouterr().out.splitlines()
        names = [f"mini_a_seq2_{run}" for run in runs]
        assert [line.partition(":")[0] for line in said[:number]] == names
        command, *words = shlex.split(follows)[2:]
        job = composed(command, [*words, f"data.cache={tmp_path / 'cache'}"])
        shares = {1: (1, 0, 0), 2: (1, 0, 1), 4: (2, 1, 1)}[number]
        for role, count in zip(("train", "validation", "query"), shares, strict=True):
            taken, names = names[:count], names[count:]
            assert getattr(job.protocol, role).sequences == (tuple(taken) or None)
            if taken:
                assert len(job.open_roles(role)[1][role]) == 2 * count


def test_months_add_drives_and_leave_the_first_month_as_it_is(written: Path, tmp_path: Path) -> None:
    summary = small(out=tmp_path, months=1)
    drives = tmp_path / "mini" / "part_a"
    assert hashes(drives / "seq2_cloudy1") == hashes(written / "mini" / "part_a" / "seq2_cloudy1")
    table = read_cold(tmp_path / "mini", on_error="raise")
    assert sorted(set(table.sequence.tolist())) == ["mini_a_seq2_cloudy1", "mini_a_seq2_cloudy1_month1"]
    assert set(table.building.tolist()) == {"mini_a"}
    later = table.select(sequence="*_month1")
    assert later.time.min() > table.select(sequence="*_cloudy1").time.max()
    assert not np.isnan(later.odometry).any()
    share = summary.changed["mini_a_seq2_cloudy1_month1"]
    assert 0 < share < 0.5
    told = read_json(drives / "seq2_cloudy1_month1" / "localization" / "changes.json")
    assert (told["changed"], {change["month"] for change in told["changes"]}) == (share, {1})
    line = f"mini_a_seq2_cloudy1_month1: 6 frames, {100 * share:.0f} % of the surfaces in view changed"
    assert summary.lines() == ["mini_a_seq2_cloudy1: 6 frames", line]
    assert small(out=tmp_path, months=1).rendered == 0


def test_preview_writes_two_pictures(tmp_path: Path) -> None:
    summary = simulate(building="mini", runs=["night1"], out=tmp_path, preview=True)
    assert [path.name for path in summary.files] == ["contact_sheet.png", "floor_plan.png"]
    assert min(cv2.imread(str(path)).std() for path in summary.files) > 20


def test_a_plan_shows_what_months_have_changed() -> None:
    mini = load_building("mini")
    plain, later = (floor_plan(mini, [Run("cloudy", 1, month=month)]).axes[0] for month in (0, 3))
    assert later.get_title() == "mini, seed 0, month 3: changed since month 0"
    colours, news = ({patch.get_facecolor() for patch in plan.patches} for plan in (plain, later))
    assert colours < news, "changed furniture has a colour of its own"


@pytest.mark.parametrize(("path", "marker"), [("grid", "."), ("path2", "None")])
def test_the_legend_of_a_plan_shows_a_grid_as_dots(path: str, marker: str) -> None:
    runs = [Run.parse(name, path, 0.8) for name in ("cloudy1", "cloudy2", "night1")]
    figure = floor_plan(load_building("mini"), runs)
    handles = figure.axes[0].get_legend().legend_handles
    assert [str(handle.get_marker()) for handle in handles] == [marker] * 2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"runz": ["cloudy1"]}, "simulate has no setting 'runz': did you mean 'runs'"),
        ({"runs": []}, "at least one run"),
        ({"runs": ["cloudy1", "cloudy1"]}, "listed twice"),
        ({"runs": ["cloudy1", "cloudy01"]}, "listed twice"),
        ({"runs": ["rainy1"]}, "a lighting and a number such as cloudy1, got 'rainy1'"),
        ({"path": 3}, "building 'mini' has no path '3'; valid: path1, path2, grid, halfway"),
        ({"hours": [9, 12]}, r"hours needs one hour for each run \(cloudy1\), got 2"),
        ({"trajectory": "night.lst", "runs": STANDARD_RUNS, "hours": [9] * 8}, r"each run \(night1\), got 8"),
        ({"trajectory": "night.lst", "path": "grid", "headings": 4}, "leave out path=grid, or the trajectory"),
        ({"months": -1}, "months must be a whole number from 0"),
        ({"trajectory": "night.lst", "months": 2}, "may stand in the way of a trajectory: choose a path instead"),
        ({"runs": ["sunny1"], "hours": [22]}, "at hour 22, the sun may be down: choose one from 7 to 17 for a sunny"),
        ({"spacing": float("nan")}, "spacing must be a number of metres from 0.005, got nan"),
    ],
)
def test_bad_configurations(change: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        small(out="nowhere", **change)


def test_an_edited_building_is_another_one_but_not_with_one_more_comment(tmp_path: Path) -> None:
    plan = tmp_path / "plan.yaml"
    text = (building_folder() / "mini.yaml").read_text(encoding="utf-8")
    plan.write_text(text, encoding="utf-8")
    small(building=plan, out=tmp_path / "a", frames=1)
    plan.write_text(f"# one line more\n{text}", encoding="utf-8")
    assert small(building=plan, out=tmp_path / "a", frames=1).rendered == 0
    plan.write_text(text.replace("tiles_floor", "carpet_red").replace("linoleum", "parquet"), encoding="utf-8")
    small(building=plan, out=tmp_path / "b", frames=1)
    first, second = (next(iter((tmp_path / out).rglob("*.jpeg"))).read_bytes() for out in "ab")
    assert first != second


def test_a_cut_image_is_rendered_again(tmp_path: Path) -> None:
    small(out=tmp_path, frames=3)
    whole = hashes(tmp_path)
    for picture, size in zip(sorted(tmp_path.rglob("*.jpeg")), (0, 3, 500), strict=True):
        picture.write_bytes(picture.read_bytes()[:size])
    assert small(out=tmp_path, frames=3).rendered == 3
    assert hashes(tmp_path) == whole
