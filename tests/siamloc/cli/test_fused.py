"""`descriptor=[hog,hsv]`: several descriptors as one, from the map to a located photograph."""

import pytest

from siamloc.jobs import MapFrames
from siamloc.maps import VisualMap
from siamloc.results import read_results
from siamloc.runtime import Bundle
from tests.siamloc.cli.commands import done, measures, refused

FUSED = "descriptor=[hog,hsv]"


def test_from_a_map_to_a_located_photograph(words, flat, tmp_path, capsys):
    done("map", *words, FUSED, f"run={tmp_path}")
    said = capsys.readouterr().out
    assert "weights: hog 0." in said
    assert "learned on 24 validation frames" in said
    path = tmp_path / "evaluation/hog+hsv/map.npz"
    known = VisualMap.load(path)
    done("evaluate", f"run={tmp_path}", *words, "task.baselines=[hog+thumbnail]", "task.plots=false")
    results = read_results(path.parent)
    assert results["measures"]["absolute"]["overall"]["heading_error"]["count"] == 48
    assert list(results["baselines"]) == ["hog+thumbnail"]
    assert VisualMap.load(path).digest == known.digest
    nodes = ["task=mapping", "build=spectral", "build.nodes=4", "task.plots=false"]
    done("evaluate", f"run={tmp_path}", *words, FUSED, *nodes)
    assert measures(tmp_path / "evaluation/mapping-hog+hsv-spectral")["mapping"]["nodes"] == 4
    done("export", f"run={tmp_path}")
    assert "heading (by fused)" in capsys.readouterr().out
    assert Bundle.open(tmp_path / "bundle").identity["weights"] == known.identity["weights"]
    done("localize", f"run={tmp_path}", f"images=['{flat.parent / 'first/0000.png'}']")
    assert "1 of 1 images located" in capsys.readouterr().out


def test_the_network_of_a_run_is_a_part_as_well(run, flat, capsys):
    fused = "descriptor=[network,hsv]"
    done("map", f"run={run}", fused)
    done("export", f"run={run}", fused)
    bundle = Bundle.open(run / "bundle")
    assert {"model.onnx", "map.npz"} <= set(bundle.files)
    assert list(bundle.identity["parts"]) == ["network", "hsv"]
    assert bundle.parity["max_relative_difference"] < 1e-4
    capsys.readouterr()
    roles = ["protocol.query.sequences=[dark]", "protocol.validation.sequences=[]"]
    done("evaluate", f"run={run}", fused, *roles, "task.plots=false")
    assert "had sequence 'dark' in protocol.validation" in capsys.readouterr().out
    done("localize", f"run={run}", f"images=['{flat.parent / 'first/0000.png'}']")
    assert "1 of 1 images located" in capsys.readouterr().out


def test_weights_can_be_given_and_python_takes_the_list(words, data, flat, tmp_path, capsys):
    done("map", *words, FUSED, "descriptor.weights=[1,3]", f"run={tmp_path}")
    said = capsys.readouterr().out
    assert "weights: hog 0.25, hsv 0.75 (as given)" in said
    assert "descriptor=hog+hsv 'descriptor.weights=[1, 3]'" in said
    frames = {"manifest": str(flat), "image_size": [32, 128], "cache": str(flat.parent / "cache")}
    given = {"data": frames, "run": str(tmp_path), "protocol": {"map": {"sequences": ["first"]}}}
    made = MapFrames.of({**given, "descriptor": ["hog", "hsv"]})
    assert made.descriptor.title == "hog+hsv"
    assert MapFrames.of(made.plain()) == made
    assert "equal, since there are no validation frames" in made.run().made["fusion"]


@pytest.mark.parametrize(
    ("word", "says"),
    [
        ("descriptor=[]", "a list of two descriptors or more, such as [hog,hsv], got []"),
        ("descriptor=[hog,hgo]", "unknown descriptor 'hgo': did you mean 'hog'?"),
        (
            "descriptor=[hog,frozen]",
            "frozen cannot be given by its name alone: it needs descriptor.branch; choose another descriptor here, or "
            "use it by itself, descriptor=frozen descriptor.branch=...",
        ),
        ("descriptor.weights=[1]", "descriptor.weights must be 2 numbers, one for each of hog, hsv"),
    ],
)
def test_lists_that_make_no_sense(words, tmp_path, capsys, word, says):
    given = [FUSED, word] if word.startswith("descriptor.") else [word]
    assert says in refused(capsys, "map", *words, f"run={tmp_path}", *given)


def test_the_network_of_a_run_needs_a_run(words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where there are no runs
    assert "no run is named: train one first" in refused(capsys, "map", *words, "descriptor=[network,hog]")
