import errno
import subprocess
import sys

import pytest

from foundation.errors import ConfigError, StorageError
from foundation.locks import LOCK, alone, locked

HOLDS = """
import sys
from pathlib import Path
from foundation.locks import locked
with locked(Path(sys.argv[1])) as free:
    print(free, flush=True)
    sys.stdin.read()
"""


def start(path):
    return subprocess.Popen(
        [sys.executable, "-c", HOLDS, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )


def test_one_process_holds_it_until_it_ends_even_by_a_kill(tmp_path):
    with start(tmp_path / LOCK) as other:
        assert other.stdout.readline() == "True\n"
        with locked(tmp_path / LOCK, wait=False) as free:
            assert not free
        other.kill()
        other.wait()
    with locked(tmp_path / LOCK, wait=False) as free:
        assert free
    assert not list(tmp_path.iterdir())


def test_waiting_ends_when_the_other_process_is_done(tmp_path):
    with locked(tmp_path / LOCK):
        other = start(tmp_path / LOCK)
        with pytest.raises(subprocess.TimeoutExpired):
            other.wait(timeout=0.5)
    assert other.communicate()[0] == "True\n"


def test_one_process_at_a_time_works_in_a_folder(tmp_path):
    with alone(tmp_path / "run"), pytest.raises(ConfigError, match="another process"), alone(tmp_path / "run"):
        pass
    with pytest.raises(ZeroDivisionError), alone(tmp_path / "other"):
        raise ZeroDivisionError
    assert not (tmp_path / "other").exists()


def test_a_lock_needs_its_folder(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(StorageError), locked(tmp_path / "file" / LOCK):
        pass


def test_a_folder_without_locks_is_used_without(tmp_path, monkeypatch):
    def refused(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("fcntl.flock", refused)
    with alone(tmp_path / "run"):
        (tmp_path / "run/a").write_text("a")
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["a"]
