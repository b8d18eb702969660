import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

import augment
from augment.expand import read_table
from siamloc import data
from tests.drawn import write_manifest
from tests.siamloc.cli.commands import done, refused


@pytest.fixture(scope="module")
def manifest(tmp_path_factory):
    return write_manifest(tmp_path_factory.mktemp("drawn"), {"day": "cloudy", "dark": "night"}, frames_per_room=1)


def words(manifest, out, *more):
    given = [f"data.manifest={manifest}", "data.image_size=[32,128]", f"out={out}", "depth=16"]
    return ["augment", "expand", *given, *more]


@pytest.fixture(scope="module")
def expanded(manifest, tmp_path_factory):
    out = tmp_path_factory.mktemp("expanded") / "out"
    done(*words(manifest, out, "sequences=[day]"))
    return out


def test_every_frame_gets_its_variants_and_the_table_repeats_them(manifest, expanded):
    frames = data.read("manifest", manifest=manifest).select(sequence="day")
    found = data.read("manifest", manifest=expanded / "manifest.csv", on_error="raise")
    assert len(found) == 16 * len(frames)
    rows = read_table(expanded / "augmentation.csv")
    assert [row["image"] for row in rows] == [str(Path(path).relative_to(expanded)) for path in found.path]
    added = [float(row["heading"]) for row in rows]
    wrapped = np.exp(1j * (np.repeat(frames.theta, 16) + added))
    np.testing.assert_allclose(np.exp(1j * found.theta), wrapped, atol=1e-9)


def test_one_unreadable_image_is_left_out_and_said(manifest, tmp_path, capsys):
    table = write_manifest(tmp_path / "in", {"day": "cloudy"}, frames_per_room=1)
    broken = data.read("manifest", manifest=table).path[1]
    Path(broken).write_bytes(b"no image")
    done(*words(table, tmp_path / "out"))
    said = capsys.readouterr().out
    assert "left out: 1 of 3 images, the first: " in said
    words_of_training = "/manifest.csv 'data.image_size=[32, 128]' 'protocol.train.sequences=[\"*\"]'"
    assert said.rstrip().endswith(words_of_training), "training needs sequences"
    assert len(data.read("manifest", manifest=tmp_path / "out" / "manifest.csv")) == 32
    assert str(broken) in refused(capsys, *words(table, tmp_path / "strict", "data.on_error=raise"))


@pytest.mark.parametrize(
    ("word", "sentence"),
    [
        ("depth=0", "depth must be a whole number from 1 to 10,000, got 0"),
        ("sequences=[evening]", "no frame has sequence 'evening'"),
        ("out={folder}", "holds images that are to be expanded"),
    ],
)
def test_wrong_words_get_one_sentence(manifest, tmp_path, capsys, word, sentence):
    assert sentence in refused(capsys, *words(manifest, tmp_path / "out", word.format(folder=manifest.parent)))
    assert not (tmp_path / "out").exists()


def test_a_data_set_is_not_expanded_into_itself(tmp_path, capsys):
    room = tmp_path / "in" / "train" / "KT-A"
    room.mkdir(parents=True)
    cv2.imwrite(str(room / "a.png"), np.zeros((8, 32, 3), np.uint8))
    common = ["augment", "expand", "data=folder", f"data.root={tmp_path / 'in'}", "data.image_size=[8,32]"]
    assert "lies in the data set" in refused(capsys, *common, f"out={tmp_path / 'in' / 'more'}")
    done(*common, f"out={tmp_path / 'out'}", "depth=4", "data.circular=false")
    assert "'data.image_size=[8, 32]' data.circular=false 'protocol" in capsys.readouterr().out
    assert len(list((tmp_path / "out" / "train" / "KT-A").iterdir())) == 4
    with (tmp_path / "out" / "augmentation.csv").open(newline="") as file:
        assert all(json.loads(row["parameters"]) for row in csv.DictReader(file))


def test_a_preview_of_data_and_of_files(manifest, tmp_path, capsys):
    size = "data.image_size=[32,128]"
    done("augment", "preview", f"data.manifest={manifest}", size, f"out={tmp_path / 'a' / 'sheet.png'}")
    assert cv2.imread(str(tmp_path / "a" / "sheet.png")).shape[1] > 1000
    image = data.read("manifest", manifest=manifest).path[0]
    done("augment", "preview", f"images=[{image}]", size, f"out={tmp_path / 'sheet.jpg'}")
    assert f"{len(augment.EFFECTS)} effects on 1 image\n" in capsys.readouterr().out
    done("augment", "preview", "data.circular=false", size, f"out={tmp_path / 'sheet.jpg'}", "count=1")
    assert f"{len(augment.EFFECTS) - 1} effects on 1 image\n" in capsys.readouterr().out, "all but rotate"
    (tmp_path / "some").mkdir()
    cv2.imwrite(str(tmp_path / "some" / "a.png"), np.zeros((32, 128, 3), np.uint8))
    (tmp_path / "some" / "b.png").write_bytes(b"no image")
    some = ["augment", "preview", f"images=[{tmp_path / 'some'}]", size, f"out={tmp_path / 'sheet.jpg'}"]
    done(*some)
    assert "effects on 1 image\n" in capsys.readouterr().out
    assert "b.png" in refused(capsys, *some, "data.on_error=raise")
    unread = "1 of 1 images cannot be read, the first: "
    for shown, out, says in ((manifest, "sheet.png", unread), (image, "sheet.txt", "must be a picture")):
        assert says in refused(capsys, "augment", "preview", f"images=[{shown}]", f"out={tmp_path / out}")
