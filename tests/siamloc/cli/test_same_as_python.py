"""Each command gives the same as the Python call, and the output of either works in the other."""

from pathlib import Path

import numpy as np
import pytest

import siamloc
from siamloc import evaluation
from siamloc.results import read_results
from tests.siamloc.cli.commands import QUICK, done, measures, refused


@pytest.fixture(scope="module")
def images(town):
    frames = siamloc.data.read("manifest", manifest=town)
    return siamloc.data.PanoramaLibrary(frames, town.parent / "cache", image_size=(32, 128))


def drive(images, *names):
    return images.frames.select(sequence=names)


def searched(known, images, queries, **settings):
    return evaluation.hierarchical(known, images, queries, siamloc.maps.group(known, "sample", nodes=4), **settings)


def chosen(known, images, queries):
    return evaluation.buildings([known], images, queries)


def learned(known, images, queries, **settings):
    return evaluation.localization(known, images, queries, validation=drive(images, "third"), **settings)


TASKS = {
    "both": ("task.baselines=[]", "hog", evaluation.localization, {}),
    "absolute": (
        "task=absolute task.baselines=[thumbnail] task.radii=[0.3]",
        "hog",
        evaluation.localization,
        {"names": ["absolute"], "baselines": ["thumbnail"], "radii": [0.3]},
    ),
    "rooms": (
        "task=room_retrieval task.baselines=[thumbnail]",
        "room_retrieval-hog",
        evaluation.rooms,
        {"baselines": ["thumbnail"]},
    ),
    "hierarchical": (
        "task=hierarchical build=sample build.nodes=4 task.candidates=2",
        "hierarchical-hog-sample",
        searched,
        {"candidates": 2, "name": "hog-sample"},
    ),
    "buildings": ("task=buildings", "buildings-hog", chosen, {}),
    "robustness": (
        "task=robustness task.baselines=[] task.robustness.every=3 task.robustness.occlusion=[] "
        "task.robustness.turn=[0,90] task.robustness.effects=[blur] seed=3",
        "robustness-hog",
        evaluation.robustness,
        {"every": 3, "occlusion": [], "turn": [0, 90], "effects": ["blur"], "seed": 3},
    ),
    "filter": (
        "task=absolute task.baselines=[] task.filter=true task.filter_tune=true task.refine=interpolate "
        "task.error_model=true task.lost_above=0.7",
        "hog",
        learned,
        {
            **{"names": ["absolute"], "filter": True, "filter_tune": True, "refine": "interpolate"},
            **{"error_model": True, "lost_above": 0.7},
        },
    ),
}


def agree(by_command, result, folder):
    """Compare the files of a command with those of a result."""
    result.save(folder, pictures=False)
    one, other = read_results(by_command), read_results(folder)
    for key in ("measures", "baselines", "denominators", "skipped", "descriptor", "name"):
        assert one[key] == other[key], key
    assert one["measures"]
    tables = sorted(path.name for path in folder.iterdir() if path.name != "results.json")
    assert tables == sorted(path.name for path in by_command.iterdir() if path.name != "results.json")
    assert tables
    for table in tables:
        assert (by_command / table).read_text() == (folder / table).read_text(), table


@pytest.mark.parametrize("task", TASKS)
def test_a_task_by_command_and_by_call(town, words, images, tmp_path, task):
    line, name, call, settings = TASKS[task]
    given = ["evaluate", "descriptor=hog", *words, f"data.manifest={town}", f"run={tmp_path}", "task.plots=false"]
    done(*given, *line.split())
    known = siamloc.maps.build("hog", images, drive(images, "first"))
    result = call(known, images, drive(images, "second", "dark"), **settings)
    agree(tmp_path / "evaluation" / name, result, tmp_path / "python")


def test_a_layer_by_command_and_by_call(town, words, images, tmp_path):
    given = ["evaluate", "descriptor=hog", *words, f"data.manifest={town}", f"run={tmp_path}", "task.plots=false"]
    done(*given, "task=mapping", "build=spectral", "build.nodes=4", "task.closure_gap=5")
    known = siamloc.maps.build("hog", images, drive(images, "first"))
    # The time that the nodes took is stored in the layer, which is read again here.
    layer = siamloc.maps.group(known, "spectral", nodes=4, folder=tmp_path / "layers/hog-spectral")
    result = evaluation.mapping(known, layer, closure_gap=5, name="spectral over hog")
    agree(tmp_path / "evaluation/mapping-hog-spectral", result, tmp_path / "python")


def test_what_commands_made_works_in_python(trained, images, tmp_path):
    network = siamloc.models.load(trained)
    known = siamloc.maps.VisualMap.load(trained / "map.npz", siamloc.models.as_descriptor(network))
    again = siamloc.maps.build(network, images, drive(images, "first"))
    np.testing.assert_allclose(known.descriptors, again.descriptors, atol=1e-6)
    result = evaluation.localization(known, images, drive(images, "second"))
    assert result.measures["queries"] == 24
    bundle = siamloc.runtime.export(network, known, tmp_path / "bundle")
    location = siamloc.runtime.Localizer(bundle.path).locate(images.frames.path[0])
    assert location.candidates[0].image == Path(images.frames.path[0]).name  # its folder stays here


def test_what_python_made_works_in_the_commands(images, tmp_path, capsys):
    run = tmp_path / "run"
    first = drive(images, "first")
    network = siamloc.models.build("simple1", "fc500_500_5", image_size=(32, 128))
    siamloc.training.fit(network, images, first, run=run, epochs=1, batch_size=8, trainer={"accelerator": "cpu"})
    queries = ["protocol.query.sequences=[second]", *QUICK]

    done("map", f"run={run}", "heading=hog")
    known = siamloc.maps.VisualMap.load(run / "map.npz", siamloc.models.as_descriptor(network))
    assert known.frames == first
    assert known.heading is not None

    every_second = siamloc.maps.build(network, images, first.every(2))
    every_second.save(run / "map.npz")
    done("evaluate", f"run={run}", *queries)
    assert read_results(run / "evaluation/network")["denominators"]["map_frames"] == 12
    other = ["protocol.map.every=3", "overwrite=true"]
    assert "run `siamloc map` again" in refused(capsys, "evaluate", f"run={run}", *queries, *other)

    siamloc.runtime.export(network, every_second, run / "bundle")
    done("localize", f"run={run}", f"images=[{first.path[0]}]")
    assert Path(first.path[0]).name in (run / "locations.csv").read_text()
    done("export", f"run={run}")
    done("train", f"run={run}", "resume=true", "epochs=2", "trainer.accelerator=cpu")
    assert len(siamloc.training.Run(run).curves()["epoch"]) == 2


def test_excluded_map_frames_reach_the_evaluation(town, words, images, tmp_path):
    own = ["protocol.query.sequences=[first]", "protocol.validation.sequences=null", *QUICK, f"run={tmp_path}"]
    given = ["evaluate", "descriptor=hog", *words, f"data.manifest={town}", *own]
    done(*given, "protocol.leave_one_out=true")
    protocol = siamloc.data.Protocol(leave_one_out=True)
    known = siamloc.maps.build("hog", images, drive(images, "first"))
    result = evaluation.localization(known, images, drive(images, "first"), protocol=protocol)
    held = measures(tmp_path / "evaluation/hog")["absolute"]["overall"]
    assert held["error"] == result.measures["error"]
    assert held["floor"]["mean"] > 0, "no query finds itself"
    done(*given, "protocol.apart_metres=2", "overwrite=true")
    assert measures(tmp_path / "evaluation/hog")["absolute"]["overall"]["floor"]["mean"] > held["floor"]["mean"]
