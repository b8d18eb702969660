"""Settings that a job takes from the map in its run."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from analytic import descriptor
from siamloc.cli.compose import composed
from siamloc.data import FrameTable, Mounting
from siamloc.errors import ConfigError, FormatError
from siamloc.jobs import Evaluate, Export, MapFrames
from siamloc.maps import VisualMap, visual_map


@pytest.fixture
def run(tmp_path):
    """A folder whose only content is a map of two frames by thumbnails."""
    thumbnail = descriptor("thumbnail", rows=4)
    described = thumbnail.describe(np.random.default_rng(0).integers(0, 256, (2, 3, 16, 64), dtype=np.uint8))
    data = {"kind": "manifest", "manifest": "robot.csv", "image_size": [16, 64]}
    frames = FrameTable(path=["a.png", "b.png"], x=[0.0, 1.0], y=[0.0, 0.0], theta=[0.0, 0.0])
    known = VisualMap(described.position, frames, thumbnail.identity, made={"data": data, "role": {"every": 3}})
    known.save(tmp_path / "evaluation/thumbnail/map.npz")
    return str(tmp_path)


def record(run, **data):
    """Write the record of a training on some data into the folder."""
    content = {"format": "siamloc-run", "version": 2, "settings": {"data": data}, "written": []}
    (Path(run) / "run.json").write_text(json.dumps(content))


def test_the_settings_of_the_only_map_of_a_folder_are_taken(run):
    job = Evaluate.of({"run": run})
    assert (job.descriptor.name, job.descriptor.parameters["rows"]) == ("thumbnail", 4)
    assert (job.data.where["manifest"], job.protocol.map.every) == (Path("robot.csv"), 3)


def test_the_only_map_of_a_folder_is_read_once(run, monkeypatch):
    files = []
    read = visual_map.read_map
    monkeypatch.setattr(visual_map, "read_map", lambda path, kind: files.append(path) or read(path, kind))
    Evaluate.of({"run": run})
    assert files == [Path(run) / "evaluation/thumbnail/map.npz"]


def test_data_of_another_kind_replace_those_of_the_map(run):
    job = Evaluate.of({"run": run, "data": {"kind": "folder", "root": "photos"}})
    assert (job.data.kind, job.data.where) == ("folder", {"root": Path("photos")})
    same = Evaluate.of({"run": run, "data": {"kind": "manifest", "circular": False}})
    assert (same.data.where["manifest"], same.data.circular) == (Path("robot.csv"), False)


def test_a_run_whose_frames_have_no_source_asks_for_data(run):
    record(run, image_size=[16, 64])
    chosen = {"run": run, "descriptor": {"name": "thumbnail"}}
    with pytest.raises(ConfigError, match="came from Python, and its record names no files: say which to read"):
        MapFrames.of(chosen)
    assert MapFrames.of({**chosen, "data": {"manifest": "robot.csv"}}).data.where["manifest"] == Path("robot.csv")


def test_a_map_that_was_made_of_other_data_than_its_run_is_searched_with_its_own(run):
    record(run, kind="manifest", manifest="training.csv")
    chosen = {"run": run, "descriptor": {"name": "thumbnail"}}
    for job, name in ((Evaluate, "robot.csv"), (Export, "robot.csv"), (MapFrames, "training.csv")):
        assert job.of(chosen).data.where["manifest"] == Path(name)
    updating = MapFrames.of({**chosen, "update": {"sequences": ["tuesday"]}})
    assert updating.data.where["manifest"] == Path("robot.csv")
    given = {**chosen, "data": {"manifest": "third.csv"}}
    assert Evaluate.of(given).data.where["manifest"] == Path("third.csv")


def test_the_command_line_takes_keys_of_the_kind_of_data_that_the_run_has(run):
    record(run, kind="cold", root="/old", unwrap={"kind": "cold", "forward": 270.0})
    for command in ("map", "train"):
        words = [f"run={run}", "descriptor=hog"] if command == "map" else [f"run={run}", "resume=True"]
        job = composed(command, [*words, "data.root=/new", "unwrap.forward=90"])
        assert (job.data.kind, job.data.where["root"]) == ("cold", Path("/new"))
        assert job.unwrap["forward"] == 90
        with pytest.raises(ConfigError, match=r"unknown key data\.manifest: .*valid: .*root.*, for data\.kind=cold"):
            composed(command, [*words, "data.manifest=new.csv"])
        with pytest.raises(ConfigError, match=r"give the whole list, data\.image_size=\[\.\.\.\]"):
            composed(command, [*words, "data.image_size.0=64"])
    with pytest.raises(ConfigError, match=r"unknown configuration key 'data\.root'"):
        composed("map", [f"run={run}/none", "descriptor=hog", "data.root=/new"])
    by_network = composed("evaluate", [f"run={run}/none", f"descriptor={run}", "data.root=/new"])
    assert (by_network.data.kind, by_network.data.where["root"]) == ("cold", Path("/new"))


def test_the_command_line_takes_keys_of_one_lens_of_the_camera_that_the_run_has(run):
    lens = {"fov": 190.0, "image_size": [100, 100], "fx": 30.0, "fy": 30.0, "cx": 50.0, "cy": 50.0}
    camera = {"kind": "dual_fisheye", "image_size": [100, 200], "front": lens, "back": {**lens, "azimuth": 180.0}}
    record(run, kind="folder", root="/old", unwrap=camera)
    words = [f"run={run}", "descriptor=hog"]
    lenses = composed("map", [*words, "unwrap.front.fov=200"]).unwrap
    assert (lenses["front"]["fov"], lenses["back"]["fov"]) == (200, 190)
    with pytest.raises(ConfigError, match=r"unknown key unwrap\.fvo: did you mean 'fov'"):
        composed("map", [*words, "unwrap.front.fvo=200"])


def test_a_map_of_an_older_siamloc_is_replaced_but_not_searched(run):
    file = Path(run) / "evaluation/thumbnail/map.npz"
    with np.load(file) as archive:
        arrays = dict(archive)
    header = json.loads(str(arrays["header"])) | {"format": "siamloc-map", "version": 1}
    np.savez(file, **{**arrays, "header": np.array(json.dumps(header))})
    chosen = {"run": run, "descriptor": {"name": "thumbnail"}, "data": {"kind": "folder", "root": "photos"}}
    assert MapFrames.of(chosen).data.where == {"root": Path("photos")}
    for job in (Evaluate, Export):
        with pytest.raises(FormatError, match="written by an older siamloc: build the map again with `siamloc map`"):
            job.of(chosen)


def test_a_map_takes_the_mounting_that_is_given_and_others_are_refused(tmp_path):
    pictures = np.random.default_rng(0).integers(0, 256, (2, 16, 64, 3), dtype=np.uint8)
    for name, turned in (("straight", 0), ("turned", 16)):  # of 64 columns, a quarter turn
        (tmp_path / name).mkdir()
        for number, picture in enumerate(pictures):
            cv2.imwrite(str(tmp_path / name / f"{number}.png"), np.roll(picture, turned, axis=1))
        (tmp_path / name / "frames.csv").write_text("image,x,y\n0.png,0,0\n1.png,1,0\n")

    def given(name, **mounting):
        data = {"manifest": str(tmp_path / name / "frames.csv"), "image_size": [16, 64]}
        settings = {"data": data, "descriptor": "thumbnail", "protocol": {"map": {"sequences": ["*"]}}}
        return {**settings, "mounting": mounting, "run": str(tmp_path / f"run_{name}")}

    straight, turned = MapFrames.of(given("straight")).run(), MapFrames.of(given("turned", yaw=90)).run()
    assert turned.mounting == Mounting(yaw=90)
    np.testing.assert_array_equal(turned.descriptors, straight.descriptors)
    for job in (Evaluate, Export):
        with pytest.raises(
            ConfigError, match=r"another mounting .*yaw=90.* again with the intended mounting keys, or le"
        ):
            job.of(given("turned", yaw=0)).run()
    flat = given("turned", yaw=90)
    flat["data"]["circular"] = False
    with pytest.raises(ConfigError, match=r"mounting\.yaw=90 needs columns that are a full turn"):
        MapFrames.of(flat).run()
