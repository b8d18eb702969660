"""Each command gives the same as the Python call, and the output of either works in the other."""

import json
from pathlib import Path

import numpy as np
import pytest

import siamloc
from siamloc.cli import main
from tests.drawn import write_manifest

SIZE = "data.image_size=[32,128]"


def run_command(*words):
    status = main([str(word) for word in words])
    assert status == 0, f"siamloc {' '.join(map(str, words))} returned {status}"


@pytest.fixture(scope="module")
def manifest(tmp_path_factory):
    sequences = {"monday": "cloudy", "tuesday": "cloudy", "dark": "night", "friday": "cloudy"}
    drawn = write_manifest(tmp_path_factory.mktemp("drawn"), sequences, frames_per_room=8)
    house = {"kitchen": "east", "office": "west", "corridor": "west"}
    rows = drawn.read_text().splitlines()
    lines = [f"{rows[0]},building"] + [f"{row},{house[row.split(',')[4]]}" for row in rows[1:]]
    drawn.write_text("\n".join(lines) + "\n")
    return drawn


@pytest.fixture(scope="module")
def images(manifest):
    frames = siamloc.data.read("manifest", manifest=manifest)
    return siamloc.data.PanoramaLibrary(frames, manifest.parent / "cache", image_size=(32, 128))


def drive(images, *names):
    return images.frames.select(sequence=names)


@pytest.fixture(scope="module")
def trained(manifest, tmp_path_factory):
    """Train, map and evaluate by commands."""
    run = tmp_path_factory.mktemp("trained") / "run"
    run_command(
        *["train", f"data.manifest={manifest}", f"data.cache={manifest.parent / 'cache'}", SIZE, f"run={run}"],
        *["model/branch=simple1", "model/head=fc500_500_5", "pairs=room", "epochs=1", "batch_size=8", "seed=3"],
        *["protocol.train.sequences=[monday]", "trainer.accelerator=cpu"],
    )
    run_command("map", f"run={run}")
    return run


def localized(known, images, folder, **settings):
    queries = drive(images, "tuesday", "dark")
    return siamloc.evaluation.localization(known, images, queries, **settings)


def learned(known, images, folder, **settings):
    return localized(known, images, folder, validation=drive(images, "friday"), names=["absolute"], **settings)


def retrieved(known, images, folder):
    return siamloc.evaluation.rooms(known, images, drive(images, "tuesday", "dark"), baselines=["thumbnail"])


def searched(known, images, folder):
    layer = siamloc.maps.group(known, "sample", nodes=4)
    queries = drive(images, "tuesday", "dark")
    return siamloc.evaluation.hierarchical(known, images, queries, layer, candidates=2, name="hog-sample")


def mapped(known, images, folder):
    # The time that the nodes took is stored in the layer, which is read again here.
    layer = siamloc.maps.group(known, "spectral", nodes=4, folder=folder / "layers" / "hog-spectral")
    return siamloc.evaluation.mapping(known, layer, closure_gap=5, name="spectral over hog")


def chosen(known, images, folder):
    return siamloc.evaluation.buildings([known], images, drive(images, "tuesday", "dark"))


def disturbed(known, images, folder):
    return siamloc.evaluation.robustness(
        known, images, drive(images, "tuesday", "dark"), every=3, occlusion=[], turn=[0, 90], effects=["blur"], seed=0
    )


TASKS = {
    "absolute": (
        ["task=absolute", "task.baselines=[thumbnail]", "task.radii=[0.3]"],
        "hog",
        lambda *world: localized(*world, names=["absolute"], baselines=["thumbnail"], radii=[0.3]),
    ),
    "both": (["task.baselines=[]"], "hog", localized),
    "rooms": (["task=room_retrieval", "task.baselines=[thumbnail]"], "hog", retrieved),
    "hierarchical": (
        ["task=hierarchical", "build=sample", "build.nodes=4", "task.candidates=2"],
        "hierarchical-hog-sample",
        searched,
    ),
    "mapping": (
        ["task=mapping", "build=spectral", "build.nodes=4", "task.closure_gap=5"],
        "mapping-hog-spectral",
        mapped,
    ),
    "buildings": (["task=buildings"], "buildings-hog", chosen),
    "robustness": (
        [
            *["task=robustness", "task.baselines=[]", "task.robustness.every=3", "task.robustness.occlusion=[]"],
            *["task.robustness.turn=[0,90]", "task.robustness.effects=[blur]"],
        ],
        "robustness-hog",
        disturbed,
    ),
    "filter": (
        ["task=absolute", "task.baselines=[]", "task.filter=true", "task.filter_tune=true", "task.refine=interpolate"],
        "hog",
        lambda *world: learned(*world, filter=True, filter_tune=True, refine="interpolate"),
    ),
    "error model": (
        ["task=absolute", "task.baselines=[]", "task.error_model=true", "task.lost_above=0.7"],
        "hog",
        lambda *world: learned(*world, error_model=True, lost_above=0.7),
    ),
}


@pytest.mark.parametrize("task", TASKS)
def test_a_task_by_command_and_by_call(manifest, images, tmp_path, task):
    words, name, call = TASKS[task]
    run_command(
        *["evaluate", "descriptor=hog", f"run={tmp_path}", f"data.manifest={manifest}", SIZE, "task.plots=false"],
        *[f"data.cache={manifest.parent / 'cache'}", "protocol.map.sequences=[monday]", *words],
        *["protocol.query.sequences=[tuesday,dark]", "protocol.validation.sequences=[friday]"],
    )
    known = siamloc.maps.build("hog", images, drive(images, "monday"))
    call(known, images, tmp_path).save(tmp_path / "python", pictures=False)
    by_command, by_call = tmp_path / "evaluation" / name, tmp_path / "python"
    one, other = (json.loads((folder / "results.json").read_text()) for folder in (by_command, by_call))
    for key in ("measures", "baselines", "denominators", "skipped", "descriptor", "name"):
        assert one[key] == other[key], key
    assert one["measures"]
    tables = sorted(path.name for path in by_call.iterdir() if path.name != "results.json")
    assert tables == sorted(path.name for path in by_command.iterdir() if path.name != "results.json")
    assert tables
    for table in tables:
        assert (by_command / table).read_text() == (by_call / table).read_text(), table


def test_what_commands_made_works_in_python(trained, images, tmp_path):
    network = siamloc.models.load(trained)
    known = siamloc.maps.VisualMap.load(trained / "map.npz", siamloc.models.as_descriptor(network))
    again = siamloc.maps.build(network, images, drive(images, "monday"))
    np.testing.assert_allclose(known.descriptors, again.descriptors, atol=1e-6)
    result = siamloc.evaluation.localization(known, images, drive(images, "tuesday"))
    assert result.measures["queries"] == 24
    bundle = siamloc.runtime.export(network, known, tmp_path / "bundle")
    location = siamloc.runtime.Localizer(bundle.path).locate(images.frames.path[0])
    assert location.candidates[0].image == images.frames.path[0]


def test_what_python_made_works_in_the_commands(manifest, images, tmp_path, capsys):
    run = tmp_path / "run"
    monday = drive(images, "monday")
    network = siamloc.models.build("simple1", "fc500_500_5", image_size=(32, 128))
    siamloc.training.fit(network, images, monday, run=run, epochs=1, batch_size=8, trainer={"accelerator": "cpu"})
    queries = ["protocol.query.sequences=[tuesday]", "task.baselines=[]", "task.plots=false"]

    run_command("map", f"run={run}", "heading=hog")
    known = siamloc.maps.VisualMap.load(run / "map.npz", siamloc.models.as_descriptor(network))
    assert known.frames == monday
    assert known.heading is not None

    every_second = siamloc.maps.build(network, images, monday.every(2))
    every_second.save(run / "map.npz")
    run_command("evaluate", f"run={run}", *queries)
    found = json.loads((run / "evaluation" / "network" / "results.json").read_text())
    assert found["denominators"]["map_frames"] == 12
    assert main(["evaluate", f"run={run}", *queries, "protocol.map.every=3", "overwrite=true"]) == 2
    assert "run `siamloc map` again" in capsys.readouterr().err

    siamloc.runtime.export(network, every_second, run / "bundle")
    run_command("localize", f"run={run}", f"images=[{monday.path[0]}]")
    assert Path(monday.path[0]).name in (run / "locations.csv").read_text()
    run_command("export", f"run={run}")
    run_command("train", f"run={run}", "resume=true", "epochs=2", "trainer.accelerator=cpu")
    assert len(siamloc.models.load(run).state_dict())


def test_excluded_map_frames_reach_the_evaluation(manifest, images, tmp_path):
    own = ["protocol.map.sequences=[monday]", "protocol.query.sequences=[monday]", "task.baselines=[]"]
    words = ["evaluate", "descriptor=hog", f"data.manifest={manifest}", SIZE, *own, "task.plots=false"]
    run_command(*words, f"run={tmp_path}", "protocol.leave_one_out=true")
    protocol = siamloc.data.Protocol(leave_one_out=True)
    known = siamloc.maps.build("hog", images, drive(images, "monday"))
    result = siamloc.evaluation.localization(known, images, drive(images, "monday"), protocol=protocol)
    held = json.loads((tmp_path / "evaluation" / "hog" / "results.json").read_text())["measures"]["absolute"]
    assert held["overall"]["error"] == result.measures["error"]
    assert held["overall"]["floor"]["mean"] > 0, "no query finds itself"
    run_command(*words, f"run={tmp_path}", "protocol.apart_metres=2", "overwrite=true")
    apart = json.loads((tmp_path / "evaluation" / "hog" / "results.json").read_text())["measures"]["absolute"]
    assert apart["overall"]["floor"]["mean"] > held["overall"]["floor"]["mean"]
