import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

import augment
from augment.expand import COLUMNS, TABLE, expand, headings, read_table
from foundation.errors import FormatError
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


def read(path):
    image = cv2.imread(str(path)) if path.is_file() else None
    if image is None:
        raise augment.AugmentError(f"{path} cannot be read")
    return np.ascontiguousarray(image[:, :, ::-1].transpose(2, 0, 1))


def load(path):
    return torch.from_numpy(read(Path(path)))[None]


def test_writes_every_variant_and_a_table_that_repeats_it(images, tmp_path):
    out = tmp_path / "out"
    done = expand(images, outputs(out, 3, 16), out, read, seed=7)
    assert done == (48, 0, [])
    rows = read_table(out / TABLE)
    assert [(int(row["frame"]), int(row["variant"])) for row in rows] == [(f, v) for f in range(3) for v in range(16)]
    labels = [variant.label for variant in augment.variants(16)]
    for row in rows:
        assert row["label"] == labels[int(row["variant"])]
        assert row["source"] == str(images[int(row["frame"])])
        policy = augment.variants(16)[int(row["variant"])].policy
        parameters = {key: [value] for key, value in json.loads(row["parameters"]).items()}
        assert torch.equal(policy.apply(load(row["source"]), parameters), load(out / row["image"]))
    assert torch.equal(load(out / "v000/1.png"), load(images[1]))
    assert (out / TABLE).read_text(encoding="utf-8").splitlines()[0] == ",".join(COLUMNS)
    assert json.loads(rows[1]["parameters"])["0.bulb.on"] is True


def test_parameters_follow_from_seed_frame_and_variant_alone(images, tmp_path):
    first, second = tmp_path / "a", tmp_path / "b"
    expand(images, outputs(first, 3, 16), first, read, seed=1, threads=1)
    expand(images, outputs(second, 3, 16), second, read, seed=1, threads=3)
    assert contents(first) == contents(second)
    variant = augment.variants(16)[2]
    both, other = (variant.parameters(seed, [0, 1], (16, 32))["0.bulb.radius"] for seed in (1, 2))
    assert len({*both.tolist(), *other.tolist()}) == 4
    assert torch.equal(variant.parameters(1, [1], (16, 32))["0.bulb.radius"], both[1:])


def test_headings_are_known_before_any_picture_is_made(images, tmp_path):
    out = tmp_path / "out"
    expand(images, outputs(out, 3, 20), out, read, seed=3)
    known = headings(3, 20, 3, (16, 32))
    assert known.shape == (3, 20)
    for row in read_table(out / TABLE):
        assert float(row["heading"]) == known[int(row["frame"]), int(row["variant"])]
        assert (float(row["heading"]) != 0) == ("rotate" in row["label"])
    assert not headings(2, 30, 0, (16, 32), circular=False).any()
    assert headings(0, 30, 0, (16, 32)).shape == (0, 30)


def test_resuming_makes_only_what_is_missing(images, tmp_path):
    out, targets = tmp_path / "out", outputs(tmp_path / "out", 3, 16)
    expand(images, targets, out, read)
    whole = contents(out)
    targets[0][3].unlink()
    targets[2][15].unlink()
    kept = targets[1][1].stat().st_mtime_ns
    done = expand(images, targets, out, read, resume=True)
    assert (done.written, done.kept) == (2, 46)
    assert contents(out) == whole
    assert targets[1][1].stat().st_mtime_ns == kept


@pytest.mark.parametrize("cut", [0, 5, 59, 60, 400, -1, "ü"])
def test_resuming_from_a_table_that_a_killed_run_cut_anywhere(images, tmp_path, cut):
    images = [path.rename(path.with_name(f"büro {path.name}")) for path in images]
    out, targets = tmp_path / "out", outputs(tmp_path / "out", 3, 4)
    expand(images, targets, out, read)
    whole, table = contents(out), out / "augmentation.csv"
    text = table.read_bytes()
    left = text[: text.rindex("ü".encode()) + 1 if cut == "ü" else cut]
    table.write_bytes(left)
    done = expand(images, targets, out, read, resume=True)
    assert done.written + done.kept == 12
    assert done.kept == max(left.count(b"\n") - 1, 0)
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
    assert expand(images, outputs(out, 3, 1), out, read, resume=resume).written == 3
    assert not [path for path in out.rglob("*") if is_temporary(path)]


def test_a_stopped_expansion_keeps_what_it_made(images, tmp_path):
    out, targets = tmp_path / "out", outputs(tmp_path / "out", 3, 4)

    def stop(items, total, what):
        assert (total, what) == (3, "augmenting frames")
        yield next(iter(items))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        expand(images, targets, out, read, threads=1, progress=stop)
    done = expand(images, targets, out, read, resume=True)
    assert done.kept == 4
    assert done.written == 8
    assert len(read_table(out / TABLE)) == 12
    assert not list(out.rglob("*.tmp"))


def test_a_folder_that_is_not_empty_is_refused(images, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine.txt").write_text("mine")
    with pytest.raises(augment.AugmentError, match=r"is not empty: choose another folder, or go on with resume=true"):
        expand(images, outputs(out, 3, 1), out, read)
    with pytest.raises(augment.AugmentError, match=r"has no augmentation.json, so there is nothing to resume"):
        expand(images, outputs(out, 3, 1), out, read, resume=True)
    assert contents(out) == {"mine.txt": b"mine"}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seed": 1}, "was expanded with seed=0, now asked for 1"),
        ({"circular": False}, "was expanded with circular=True, now asked for False"),
        ({"depth": 3}, "was expanded with depth=2, now asked for 3"),
        ({"order": -1}, "which is not what is asked for now"),
        ({"reading": {"size": (32, 64)}}, r"was expanded with reading=.*32.*, now asked for .*64"),
    ],
)
def test_resuming_with_other_settings_is_refused(images, tmp_path, change, message):
    def ask(depth=2, order=1, resume=True, **options):
        targets = outputs(tmp_path / "out", 3, depth)
        how = {"reading": {"size": (16, 32)}, "resume": resume, **options}
        return expand(images[::order], targets, tmp_path / "out", read, **how)

    ask(resume=False)
    assert ask().kept == 6
    with pytest.raises(augment.AugmentError, match=message):
        ask(**change)


@pytest.mark.parametrize(
    ("name", "text", "error", "message"),
    [
        ("csv", "a,b\n1,2\n", augment.AugmentError, r"is not a table of augment.expand: its columns must be image, "),
        ("json", '{"seed": ', FormatError, "is incomplete or invalid JSON"),
        ("json", "[]", augment.AugmentError, "was expanded with schema=None"),
    ],
)
def test_settings_or_table_that_are_none(images, tmp_path, name, text, error, message):
    out, targets = tmp_path / "out", outputs(tmp_path / "out", 3, 2)
    expand(images, targets, out, read)
    (out / f"augmentation.{name}").write_text(text)
    with pytest.raises(error, match=message):
        expand(images, targets, out, read, resume=True)


def test_an_image_that_cannot_be_read_is_reported_and_left_out(images, tmp_path):
    images[1].write_bytes(b"no picture")
    images[2].unlink()
    out = tmp_path / "out"
    done = expand(images, outputs(out, 3, 4), out, read)
    assert done.written == 4
    assert done.failed == [(path, f"{path} cannot be read") for path in images[1:]]
    with pytest.raises(augment.AugmentError, match=r"1.png cannot be read"):
        expand(images, outputs(tmp_path / "strict", 3, 4), tmp_path / "strict", read, on_error="raise")


def test_jpeg_outputs_have_quality_95(images, tmp_path):
    out = tmp_path / "out"
    expand(images, outputs(out, 3, 1, ".jpeg"), out, read)
    packed = cv2.imencode(".jpg", cv2.imread(str(images[0])), [cv2.IMWRITE_JPEG_QUALITY, 95])[1]
    assert (out / "v000/0.jpeg").read_bytes() == packed.tobytes()
