import errno
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from foundation import files
from foundation.errors import FormatError, StorageError
from foundation.files import (
    atomic_files,
    atomic_folder,
    atomic_path,
    check_writable,
    content_key,
    is_temporary,
    older_folder,
    read_json,
    read_text,
    real_path,
    write_json,
    write_text,
)


def write_half(path):
    with atomic_path(path) as temporary:
        temporary.write_text("half")
        raise ZeroDivisionError


def test_a_file_appears_whole_or_not_at_all(tmp_path):
    path = tmp_path / "deep" / "file.txt"
    with pytest.raises(ZeroDivisionError):
        write_half(path)
    assert list(path.parent.iterdir()) == []
    write_text(path, "whole")
    (tmp_path / "usual").write_text("a")
    assert path.stat().st_mode == (tmp_path / "usual").stat().st_mode
    with pytest.raises(ZeroDivisionError):
        write_half(path)
    assert path.read_text() == "whole"
    assert [item.name for item in path.parent.iterdir()] == ["file.txt"]


@pytest.mark.parametrize(
    ("code", "says"),
    [(errno.ENOSPC, "no space left"), (errno.EROFS, "not permitted"), (errno.ENOTDIR, "a file stands where")],
)
def test_refusals_of_the_disk_are_one_sentence(tmp_path, code, says):
    with pytest.raises(StorageError, match=says), atomic_path(tmp_path / "file"):
        raise OSError(code, os.strerror(code))
    assert list(tmp_path.iterdir()) == []


def test_other_system_errors_pass_through(tmp_path):
    with pytest.raises(TimeoutError), atomic_path(tmp_path / "file"):
        raise TimeoutError


def test_json_makes_numpy_plain_and_refuses_nothing(tmp_path):
    value = {"a": np.float32(1.5), "b": np.arange(2), "c": float("nan"), 3: (1, None), "p": tmp_path}
    write_json(tmp_path / "v.json", value)
    assert read_json(tmp_path / "v.json") == {"a": 1.5, "b": [0, 1], "c": None, "3": [1, None], "p": str(tmp_path)}


@pytest.mark.parametrize("content", ["", "{", '{"a": ', "\xff"])
def test_json_cut_short_is_said_to_be(tmp_path, content):
    (tmp_path / "v.json").write_bytes(content.encode("latin-1"))
    with pytest.raises(FormatError, match="incomplete or invalid JSON"):
        read_json(tmp_path / "v.json")
    with pytest.raises(FormatError, match="does not exist"):
        read_json(tmp_path / "w.json")


@pytest.mark.parametrize("encoding", ["latin-1", "utf-16"])
def test_a_text_in_another_encoding_is_refused_with_what_to_do(tmp_path, encoding):
    (tmp_path / "poses.txt").write_text("# Büro", encoding=encoding)
    with pytest.raises(ValueError, match=r"it is not text in UTF-8 \(at byte \d\): save it as UTF-8"):
        read_text(tmp_path / "poses.txt")


@given(st.dictionaries(st.text(), st.integers(), min_size=2))
def test_content_key_looks_at_contents_only(value):
    backwards = dict(reversed(value.items()))
    assert content_key(value) == content_key(backwards)
    changed = {**value, next(iter(value)): None}
    assert content_key(value) != content_key(changed)


def test_a_folder_appears_whole_and_replaces_the_older_one(tmp_path):
    target = tmp_path / "store"
    for word in ("first", "second"):
        with atomic_folder(target) as temporary:
            (temporary / f"{word}.txt").write_text(word)
            assert not (target / f"{word}.txt").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["store"]
    assert [path.name for path in target.iterdir()] == ["second.txt"]
    (tmp_path / "usual").mkdir()
    assert target.stat().st_mode == (tmp_path / "usual").stat().st_mode
    with pytest.raises(ZeroDivisionError), atomic_folder(target) as temporary:
        (temporary / "third.txt").write_text(str(1 / 0))
    assert [path.name for path in target.iterdir()] == ["second.txt"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["store", "usual"]


def test_the_files_of_a_folder_are_on_the_disk_before_it_appears(tmp_path, monkeypatch):
    flushed = []
    monkeypatch.setattr(files, "_flush", lambda path: flushed.append((path.name, (tmp_path / "store").exists())))
    with atomic_folder(tmp_path / "store") as temporary:
        (temporary / "inner").mkdir()
        (temporary / "inner" / "file").touch()
    assert flushed == [("file", False)]


def test_files_appear_together_or_not_at_all(tmp_path):
    folder = tmp_path / "results"
    folder.mkdir()
    for name in ("a", "kept"):
        (folder / name).write_text("old")
    with pytest.raises(StorageError), atomic_files(folder) as fresh:
        write_text(fresh / "a" / "b", str((fresh / "a").write_text("new")))
    assert {path.name: path.read_text() for path in folder.iterdir()} == {"a": "old", "kept": "old"}
    with atomic_files(folder) as fresh:
        (fresh / "a").write_text("new")
        (fresh / "b").write_text("new")
        assert (folder / "a").read_text() == "old"
    assert {path.name: path.read_text() for path in folder.iterdir()} == {"a": "new", "b": "new", "kept": "old"}


KILLED = """
import os, sys
from foundation import files
with getattr(files, sys.argv[1])(sys.argv[2]) as temporary:
    (temporary / "half").touch() if temporary.is_dir() else temporary.write_text("half")
    os._exit(9)
"""
WRITES = "import sys; from foundation.files import write_text; write_text(sys.argv[1], 'whole')"


def run(code, *words):
    subprocess.run([sys.executable, "-c", code, *map(str, words)], check=False)


@pytest.mark.parametrize("kind", ["atomic_path", "atomic_folder", "atomic_files"])
def test_what_a_killed_process_left_goes_when_another_writes_into_the_folder(tmp_path, kind):
    run(KILLED, kind, tmp_path / "target")
    left = [path for path in tmp_path.rglob("*") if is_temporary(path)]
    assert left, "nothing was left behind"
    own = [".half.tmp", ".target.tmp.json", left[0].name + "x.x", left[0].name.replace("-", "-x", 1)]
    for name in own:
        (left[0].parent / name).touch()
    run(WRITES, left[0].parent / "other")
    assert not any(path.exists() for path in left)
    assert {path.name for path in left[0].parent.iterdir()} == {"other", *own}


def test_what_a_living_process_writes_stays(tmp_path):
    with atomic_path(tmp_path / "file") as temporary:
        temporary.write_text("ours")
        run(WRITES, tmp_path / "other")
    assert (tmp_path / "file").read_text() == "ours"


def test_what_another_machine_writes_stays(tmp_path):
    run(KILLED, "atomic_path", tmp_path / "target")
    (left,) = tmp_path.iterdir()
    theirs = left.rename(left.with_name(left.name.replace(files._HOST, "00000000")))
    run(WRITES, tmp_path / "other")
    assert theirs.exists()


def test_two_writers_of_one_file_do_not_meet(tmp_path):
    path = tmp_path / "file"
    with atomic_path(path) as one, atomic_path(path) as other:
        assert one != other
        one.write_text("one")
        other.write_text("other")
    assert path.read_text() == "one", "that of the writer that ends last"
    assert [item.name for item in tmp_path.iterdir()] == ["file"]


def test_a_folder_that_cannot_be_replaced_stays(tmp_path, monkeypatch):
    path = tmp_path / "folder"
    path.mkdir()
    (path / "old").touch()
    real, calls = Path.replace, []

    def refusing(self, target):
        calls.append(target)
        if len(calls) == 2:
            raise OSError(errno.EACCES, "no")
        return real(self, target)

    monkeypatch.setattr(Path, "replace", refusing)
    with pytest.raises(StorageError), atomic_folder(path) as fresh:
        (fresh / "new").touch()
    assert [item.name for item in path.iterdir()] == ["old"]
    assert [item.name for item in tmp_path.iterdir()] == ["folder"]


KILLED_WHILE_REPLACING = """
import os, sys
from pathlib import Path
from foundation.files import atomic_folder
real = Path.replace
Path.replace = lambda self, target: (real(self, target), os._exit(9))
with atomic_folder(sys.argv[1]) as fresh:
    (fresh / "new").touch()
"""


@pytest.mark.parametrize("name", ["folder", "folder.v2"])
def test_a_kill_while_a_folder_is_replaced_leaves_the_older_one_beside_it(tmp_path, name):
    path = tmp_path / name
    path.mkdir()
    (path / "old").touch()
    run(KILLED_WHILE_REPLACING, path)
    write_text(tmp_path / "other", "clears what was left")
    (older,) = tmp_path.glob(".folder.*.old")
    assert [item.name for item in older.iterdir()] == ["old"]
    assert older_folder(path) == older
    assert older_folder(tmp_path / "folder.v3") is None
    with atomic_folder(path) as fresh:
        (fresh / "newer").touch()
    assert older.is_dir()
    run(WRITES, tmp_path / "other")
    assert not older.exists(), "another process does not need it, since there is a whole folder again"


def test_a_folder_stays_if_the_check_of_the_older_one_fails(tmp_path):
    def check(older):
        if older.exists():
            raise ZeroDivisionError

    with atomic_folder(tmp_path / "folder", check) as fresh:
        (fresh / "first").touch()
    with pytest.raises(ZeroDivisionError), atomic_folder(tmp_path / "folder", check) as fresh:
        (fresh / "second").touch()
    assert [str(item.relative_to(tmp_path)) for item in tmp_path.rglob("*")] == ["folder", "folder/first"]


def test_an_older_folder_goes_if_somebody_else_has_replaced_it_before_an_error(tmp_path):
    path = tmp_path / "folder"

    def check(older):
        path.mkdir()
        (path / "other").touch()
        raise ZeroDivisionError

    path.mkdir()
    (path / "old").touch()
    with pytest.raises(ZeroDivisionError), atomic_folder(path, check) as fresh:
        (fresh / "new").touch()
    assert [str(item.relative_to(tmp_path)) for item in tmp_path.rglob("*")] == ["folder", "folder/other"]


def test_a_folder_does_not_replace_a_file(tmp_path):
    (tmp_path / "taken").write_text("mine")
    with pytest.raises(StorageError, match="a file stands where a folder is needed"), atomic_folder(tmp_path / "taken"):
        pass
    assert [(item.name, item.read_text()) for item in tmp_path.iterdir()] == [("taken", "mine")]


@pytest.mark.parametrize("name", ["", "."])
def test_a_file_needs_a_name(name):
    with pytest.raises(StorageError, match="names no file"):
        write_json(name, {})


def test_links_in_a_circle_are_followed_nowhere(tmp_path):
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    assert real_path(tmp_path / "loop") == tmp_path / "loop"


def test_what_cannot_be_written_is_known_before(tmp_path):
    (tmp_path / "file").write_text("mine")
    check_writable(tmp_path / "new/folders/map.npz")
    assert [path.name for path in tmp_path.iterdir()] == ["file"], "nothing is created"
    with pytest.raises(StorageError, match="a file stands where a folder is needed"):
        check_writable(tmp_path / "file/folders/map.npz")
