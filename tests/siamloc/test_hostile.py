"""Files from untrusted sources: each is refused with one sentence, at once, and nothing is lost."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import pytest

from foundation.files import atomic_path
from siamloc.cli import main
from siamloc.cli.compose import composed
from siamloc.data.image_files import UnreadableImageError, read_image
from siamloc.data.protocol import Role
from siamloc.errors import ConfigError, DataError, FormatError, StorageError
from siamloc.runs import Run
from siamloc.runtime import Bundle
from siamloc.simulate.parse import read_building_file
from siamloc.simulate.trajectory import listed


def test_a_file_never_takes_the_place_of_a_device_or_a_pipe(tmp_path):
    pipe = tmp_path / "pipe.csv"
    os.mkfifo(pipe)
    with pytest.raises(StorageError, match="is a device or a pipe"), atomic_path(pipe) as temporary:
        temporary.write_text("lost")
    assert pipe.is_fifo()
    assert [path.name for path in tmp_path.iterdir()] == ["pipe.csv"]


@pytest.mark.parametrize("stored", ["${oc.env:HOME}", "${nokey}"])
def test_stored_texts_are_never_looked_up(tmp_path, stored):
    Run(tmp_path).start({"data": {"kind": "manifest", "manifest": stored}}, [])
    assert composed("map", [f"run={tmp_path}"]).data.where["manifest"] == Path(stored)


@pytest.mark.parametrize(
    "rows", ["-5,1\n", "1,1e300\n", "2,1\n1,1\n", "nan,1\n"], ids=["negative", "huge", "backwards", "nowhere"]
)
def test_curves_that_no_training_writes_are_refused(tmp_path, rows):
    (tmp_path / "metrics.csv").write_text(f"epoch,train/loss\n{rows}")
    with pytest.raises(FormatError, match="is not a table of training curves"):
        Run(tmp_path).curves()


def test_a_checkpoint_that_is_no_file_is_not_passed_over(tmp_path):
    (tmp_path / "checkpoints").mkdir()
    (tmp_path / "checkpoints" / "last.ckpt").write_bytes(b"x")
    os.mkfifo(tmp_path / "checkpoints" / "best.ckpt")
    with pytest.raises(FormatError, match=r"best.ckpt is not a regular file"):
        Run(tmp_path).checkpoint("best")


def test_pipes_and_endless_devices_are_not_waited_for(tmp_path):
    pipe = tmp_path / "pipe.yaml"
    os.mkfifo(pipe)
    for path in (pipe, "/dev/zero"):
        with pytest.raises(DataError, match="it is not a regular file"):
            read_building_file(type(pipe)(path), 0)
        with pytest.raises(DataError, match="it is not a regular file"):
            listed(None, type(pipe)(path))


def test_aliases_cannot_make_a_building_endless(tmp_path):
    bomb = "a0: &a0 {x: 1}\n" + "".join(
        f"a{i}: &a{i} {{<<: [{', '.join([f'*a{i - 1}'] * 9)}]}}\n" for i in range(1, 12)
    )
    (tmp_path / "bomb.yaml").write_text(bomb)
    with pytest.raises(DataError, match="aliases are not supported"):
        read_building_file(tmp_path / "bomb.yaml", 0)


def test_a_description_of_a_bundle_that_would_fill_the_memory_is_refused(tmp_path):
    (tmp_path / "bundle.json").write_text("{}")
    os.truncate(tmp_path / "bundle.json", 20_000_000_000)
    with pytest.raises(FormatError, match="far too long for the description of a bundle"):
        Bundle.open(tmp_path)


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no /dev/full here")  # noqa: PTH110
def test_output_that_cannot_be_written_is_one_sentence():
    with open("/dev/full", "w") as full:  # noqa: PTH123
        done = subprocess.run(
            [sys.executable, "-m", "siamloc", "--help"], stdout=full, stderr=subprocess.PIPE, text=True
        )
    assert done.returncode == 2
    assert done.stderr.splitlines() == ["siamloc: what is printed cannot be written: no space left on device"]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["simulate", f"seed={'1' * 5000}"], "cannot be read"),
        (["localize", "images=[a.png]", f"top={'1' * 5000}"], "top must be"),
        (["simulate", "=3"], "'=3' is not of the form key=value"),
        (["simulate", f"building={'x' * 5000}"], "siamloc: "),
        (["localize", "images=[a.png]", "threads=1000000000"], "threads must be a whole number from 1 to 1,024"),
    ],
)
def test_words_that_are_too_much_are_one_short_sentence(words, says, capsys):
    assert main(words) == 2
    error = capsys.readouterr().err.strip()
    assert says in error
    assert len(error.splitlines()) == 1


def test_a_picture_of_too_many_pixels_is_refused_by_its_header(tmp_path):
    def chunk(kind, data):
        body = kind + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    header = struct.pack(">IIBBBBB", 20_000, 20_000, 8, 2, 0, 0, 0)
    (tmp_path / "bomb.png").write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IEND", b""))
    with pytest.raises(UnreadableImageError, match="it has 20,000 x 20,000 pixels, and 16,384 a side are the most"):
        read_image(tmp_path / "bomb.png")
    frame = b"\xff\xd8\xff\xe0\x00\x04ab\xff\xc0\x00\x11\x08" + struct.pack(">HH", 30_000, 100) + b"\x03" + b"\xff\xd9"
    (tmp_path / "bomb.jpeg").write_bytes(frame)
    with pytest.raises(UnreadableImageError, match="it has 30,000 x 100 pixels"):
        read_image(tmp_path / "bomb.jpeg")


def test_a_spacing_on_another_planet_is_refused():
    with pytest.raises(ConfigError, match="spacing must be"):
        Role(sequences=("a",), spacing=1e308)
