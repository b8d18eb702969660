import json
import subprocess
import sys

import cv2
import numpy as np
import pytest
import torch

import augment
from augment.expand import expand, headings, replay
from augment.expansion_files import COLUMNS, read_table
from foundation.files import is_temporary
from tests.augment.pictures import panoramas


@pytest.fixture
def images(tmp_path):
    paths = []
    for number, picture in enumerate(panoramas(3, 16, 32)):
        paths.append(tmp_path / "in" / f"{number}.png")
        paths[-1].parent.mkdir(exist_ok=True)
        cv2.imwrite(str(paths[-1]), np.ascontiguousarray(picture.permute(1, 2, 0).numpy()[:, :, ::-1]))
    return paths


def outputs(folder, count, depth, suffix=".png"):
    return [[folder / f"v{variant:03d}" / f"{frame}{suffix}" for variant in range(depth)] for frame in range(count)]


def contents(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def load(path):
    image = cv2.imread(str(path))[:, :, ::-1]
    return torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1)))[None]


def test_writes_every_variant_and_a_table_that_repeats_it(images, tmp_path):
    out = tmp_path / "out"
    done = expand(images, outputs(out, 3, 16), out, seed=7)
    assert (done.written, done.kept, done.failed) == (48, 0, ())
    rows = read_table(done.table)
    assert [(int(row["frame"]), int(row["variant"])) for row in rows] == [(f, v) for f in range(3) for v in range(16)]
    labels = [variant.label for variant in augment.variants(16)]
    for row in rows:
        assert row["label"] == labels[int(row["variant"])]
        assert row["source"] == str(images[int(row["frame"])])
        assert torch.equal(replay(row, load(row["source"])), load(out / row["image"]))
    assert torch.equal(load(out / "v000/1.png"), load(images[1]))


def test_parameters_follow_from_seed_frame_and_variant_alone(images, tmp_path):
    first, second = tmp_path / "a", tmp_path / "b"
    expand(images, outputs(first, 3, 16), first, seed=1, threads=1)
    expand(images, outputs(second, 3, 16), second, seed=1, threads=3)
    assert contents(first) == contents(second)
    variant = augment.variants(16)[2]
    both, other = (variant.parameters(seed, [0, 1], (16, 32))["0.bulb.radius"] for seed in (1, 2))
    assert len({*both.tolist(), *other.tolist()}) == 4
    assert torch.equal(variant.parameters(1, [1], (16, 32))["0.bulb.radius"], both[1:])


def test_headings_are_known_before_any_picture_is_made(images, tmp_path):
    out = tmp_path / "out"
    done = expand(images, outputs(out, 3, 20), out, seed=3)
    known = headings(3, 20, 3, (16, 32))
    assert known.shape == (3, 20)
    for row in read_table(done.table):
        assert float(row["heading"]) == known[int(row["frame"]), int(row["variant"])]
        assert (float(row["heading"]) != 0) == ("rotate" in row["label"])


def test_headings_of_many_variants_show_their_progress():
    seen = []

    def bar(items, total, what):
        for item in items:
            seen.append((item.label, total, what))
            yield item

    turns = headings(2, 30, 0, (16, 32), progress=bar)
    assert [label for label, *_ in seen] == [v.label for v in augment.variants(30) if "rotate" in v.label]
    assert {(total, what) for _, total, what in seen} == {(len(seen), "drawing headings")}
    assert not headings(2, 30, 0, (16, 32), circular=False).any()
    assert headings(0, 30, 0, (16, 32)).shape == (0, 30)
    assert turns.any()


def test_resuming_makes_only_what_is_missing(images, tmp_path):
    out, targets = tmp_path / "out", outputs(tmp_path / "out", 3, 16)
    expand(images, targets, out)
    whole = contents(out)
    targets[0][3].unlink()
    targets[2][15].unlink()
    kept = targets[1][1].stat().st_mtime_ns
    done = expand(images, targets, out, resume=True)
    assert (done.written, done.kept) == (2, 46)
    assert contents(out) == whole
    assert targets[1][1].stat().st_mtime_ns == kept


def test_resuming_after_an_interruption_in_the_middle_of_a_line(images, tmp_path):
    out, targets = tmp_path / "out", outputs(tmp_path / "out", 3, 16)
    expand(images, targets, out)
    whole = contents(out)
    table = out / "augmentation.csv"
    text = table.read_bytes()
    table.write_bytes(text[: len(text) // 2])
    lines = text[: len(text) // 2].count(b"\n") - 1
    done = expand(images, targets, out, resume=True)
    assert done.kept in (lines, lines + 1)
    assert contents(out) == whole


@pytest.mark.parametrize("length", [0, 5, 59, 60, 400, -1])
def test_resuming_from_a_table_that_a_killed_run_cut_anywhere(images, tmp_path, length):
    images = [path.rename(path.with_name(f"büro {path.name}")) for path in images]
    out, targets = tmp_path / "out", outputs(tmp_path / "out", 3, 4)
    expand(images, targets, out)
    whole, table = contents(out), out / "augmentation.csv"
    table.write_bytes(table.read_bytes()[:length])
    done = expand(images, targets, out, resume=True)
    assert done.written + done.kept == 12
    assert contents(out) == whole


def test_resuming_from_a_table_cut_within_a_letter(images, tmp_path):
    images = [path.rename(path.with_name(f"büro {path.name}")) for path in images]
    out, targets = tmp_path / "out", outputs(tmp_path / "out", 3, 4)
    expand(images, targets, out)
    whole, table = contents(out), out / "augmentation.csv"
    table.write_bytes(table.read_bytes()[: table.read_bytes().rindex("ü".encode()) + 1])
    assert expand(images, targets, out, resume=True).kept == 11
    assert contents(out) == whole


KILLED = """
import os, sys
from foundation import files
block = files.atomic_path(sys.argv[1])
block.__enter__()
os._exit(9)
"""


@pytest.mark.parametrize("resume", [False, True])
def test_a_run_killed_before_its_settings_were_written_leaves_an_empty_folder(images, tmp_path, resume):
    out = tmp_path / "out"
    subprocess.run([sys.executable, "-c", KILLED, str(out / "augmentation.json")], check=False)
    assert len(list(out.iterdir())) == 1
    assert expand(images, outputs(out, 3, 1), out, resume=resume).written == 3
    assert not [path for path in out.rglob("*") if is_temporary(path)]


def test_a_stopped_expansion_keeps_what_it_made(images, tmp_path):
    out, targets = tmp_path / "out", outputs(tmp_path / "out", 3, 4)

    def stop(items, total, what):
        assert (total, what) == (3, "augmenting frames")
        yield next(iter(items))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        expand(images, targets, out, threads=1, progress=stop)
    done = expand(images, targets, out, resume=True)
    assert done.kept == 4
    assert done.written == 8
    assert len(read_table(done.table)) == 12
    assert not list(out.rglob("*.tmp"))


def test_a_folder_that_is_not_empty_is_refused(images, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine.txt").write_text("mine")
    with pytest.raises(augment.AugmentError, match=r"is not empty: choose another folder, or go on with resume=true"):
        expand(images, outputs(out, 3, 1), out)
    with pytest.raises(augment.AugmentError, match=r"has no augmentation.json, so there is nothing to resume"):
        expand(images, outputs(out, 3, 1), out, resume=True)
    assert contents(out) == {"mine.txt": b"mine"}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seed": 1}, "was expanded with seed=0, now asked for 1"),
        ({"circular": False}, "was expanded with circular=True, now asked for False"),
    ],
)
def test_resuming_with_other_settings_is_refused(images, tmp_path, change, message):
    out, targets = tmp_path / "out", outputs(tmp_path / "out", 3, 2)
    expand(images, targets, out)
    with pytest.raises(augment.AugmentError, match=message):
        expand(images, targets, out, resume=True, **change)
    with pytest.raises(augment.AugmentError, match="was expanded with depth=2, now asked for 3"):
        expand(images, outputs(out, 3, 3), out, resume=True)
    with pytest.raises(augment.AugmentError, match="which is not what is asked for now"):
        expand(images[::-1], targets, out, resume=True)


def test_resuming_with_another_way_of_reading_is_refused(images, tmp_path):
    out, targets = tmp_path / "out", outputs(tmp_path / "out", 3, 2)
    expand(images, targets, out, reading={"size": (16, 32)})
    expand(images, targets, out, reading={"size": (16, 32)}, resume=True)
    with pytest.raises(augment.AugmentError, match=r"was expanded with reading=.*32.*, now asked for .*64"):
        expand(images, targets, out, reading={"size": (32, 64)}, resume=True)


def test_settings_or_table_that_are_none(images, tmp_path):
    out, targets = tmp_path / "out", outputs(tmp_path / "out", 3, 2)
    expand(images, targets, out)
    (out / "augmentation.csv").write_text("a,b\n1,2\n")
    with pytest.raises(augment.AugmentError, match=r"is not a table of augment.expand: its columns must be image, "):
        expand(images, targets, out, resume=True)
    (out / "augmentation.json").write_text('{"seed": ')
    with pytest.raises(augment.AugmentError, match="is incomplete or invalid JSON"):
        expand(images, targets, out, resume=True)
    (out / "augmentation.json").write_text("[]")
    with pytest.raises(augment.AugmentError, match="contains no settings"):
        expand(images, targets, out, resume=True)


def test_an_image_that_cannot_be_read_is_reported_and_left_out(images, tmp_path):
    images[1].write_bytes(b"no picture")
    images[2].unlink()
    out = tmp_path / "out"
    done = expand(images, outputs(out, 3, 4), out)
    assert done.written == 4
    assert [reason for _, reason in done.failed] == [
        f"{images[1]} is not a readable image",
        f"{images[2]} does not exist",
    ]
    with pytest.raises(augment.AugmentError, match=r"1.png is not a readable image"):
        expand(images, outputs(tmp_path / "strict", 3, 4), tmp_path / "strict", on_error="raise")


def test_jpeg_outputs_have_quality_95(images, tmp_path):
    out = tmp_path / "out"
    expand(images, outputs(out, 3, 1, ".jpeg"), out)
    packed = cv2.imencode(".jpg", cv2.imread(str(images[0])), [cv2.IMWRITE_JPEG_QUALITY, 95])[1]
    assert (out / "v000/0.jpeg").read_bytes() == packed.tobytes()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (lambda i, o: ([], [], o), "there is no image to expand"),
        (lambda i, o: (i, outputs(o, 2, 2), o), "3 images need as many rows of outputs, got 2"),
        (lambda i, o: (i, [[o / "a.png"], [], []], o), "every image needs the same number of outputs"),
        (lambda i, o: (i, [[o / "a.png"]] * 3, o), "outputs must differ from each other and from the images"),
        (lambda i, o: (i, [[p] for p in i], o.parent), "outputs must differ from each other and from the images"),
        (lambda i, o: (i, outputs(o / "..", 3, 1), o / "deeper"), "lies outside the folder"),
        (lambda i, o: (i, outputs(o / "in" / ".." / "..", 3, 1), o), "lies outside the folder"),
        (lambda i, o: (i, outputs(o, 3, 1, ".txt"), o), "does not end like an image: use .jpeg or .png"),
    ],
)
def test_paths_that_make_no_sense(images, tmp_path, arguments, message):
    with pytest.raises(augment.AugmentError, match=message):
        expand(*arguments(images, tmp_path / "out"))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [({"on_error": "stop"}, "on_error must be skip or raise, got 'stop'"), ({"seed": -1}, "seed must be 0 or more")],
)
def test_options_that_make_no_sense(images, tmp_path, options, message):
    with pytest.raises(augment.AugmentError, match=message):
        expand(images, outputs(tmp_path / "out", 3, 1), tmp_path / "out", **options)


def test_table_is_plain(images, tmp_path):
    out = tmp_path / "out"
    done = expand(images, outputs(out, 3, 2), out)
    text = done.table.read_text(encoding="utf-8")
    assert text.splitlines()[0] == ",".join(COLUMNS)
    row = read_table(done.table)[1]
    values = json.loads(row["parameters"])
    assert values["0.bulb.on"] is True
    assert row["image"] == "v001/0.png"
