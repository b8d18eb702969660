"""Checkpoints on a disk that refuses, and what a killed run leaves."""

from __future__ import annotations

import errno
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
import torch

from siamloc.errors import StorageError
from siamloc.runs import Run
from siamloc.training.callbacks import AtomicCheckpoints

# Writes a checkpoint and is stopped for ever where the whole file would get its name.
KILLED = """
import sys
import time
from siamloc import files
from siamloc.training.callbacks import AtomicCheckpoints

def wait(_):
    print("written", flush=True)
    time.sleep(600)

files.os.fsync = wait
AtomicCheckpoints().save_checkpoint({"state": 1}, sys.argv[1])
"""


@contextmanager
def files_of_at_most(size: int) -> Iterator[None]:
    """Let the operating system cut files short, as a full disk does."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_disk_that_fills_up_is_one_sentence_and_leaves_the_checkpoint_before(tmp_path):
    path = tmp_path / "last.ckpt"
    AtomicCheckpoints().save_checkpoint({"epoch": 1}, path)
    with files_of_at_most(1 << 16), pytest.raises(StorageError) as raised:
        AtomicCheckpoints().save_checkpoint({"epoch": 2, "weights": torch.zeros(1 << 20)}, path)
    assert str(raised.value) == (
        f"the checkpoint {path} could not be written whole: free some space on the disk or write elsewhere"
    )
    assert torch.load(path, weights_only=True) == {"epoch": 1}
    assert list(tmp_path.iterdir()) == [path]


def test_a_disk_that_is_full_when_the_file_is_synced_is_one_sentence(tmp_path, monkeypatch):
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "full")

    monkeypatch.setattr("siamloc.files.os.fsync", full)
    with pytest.raises(StorageError, match=r"no space left on the disk while writing .*last\.ckpt"):
        AtomicCheckpoints().save_checkpoint({"epoch": 1}, tmp_path / "last.ckpt")
    assert list(tmp_path.iterdir()) == []


def test_other_failures_of_torch_keep_their_words(tmp_path, monkeypatch):
    def fail(*_: object) -> None:
        raise RuntimeError("something else")

    monkeypatch.setattr(torch, "save", fail)
    with pytest.raises(RuntimeError, match=r"^something else$"):
        AtomicCheckpoints().save_checkpoint({}, tmp_path / "last.ckpt")


def test_what_a_killed_run_left_is_removed_and_nothing_else(tmp_path):
    run = Run(tmp_path / "run")
    run.start({}, ["checkpoints/last.ckpt"])
    path = run.checkpoints / "last.ckpt"
    with subprocess.Popen([sys.executable, "-c", KILLED, str(path)], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "written\n"
        process.send_signal(signal.SIGKILL)
        process.wait(timeout=60)
    assert len(list(run.checkpoints.iterdir())) == 1
    kept = {path, *(run.checkpoints / name for name in (".hidden", "notes.tmp.ckpt", ".other.ckpt.abc.tmp.ckpt"))}
    for file in kept:
        file.touch()
    run.clear_temporaries()
    assert set(run.checkpoints.iterdir()) == kept
