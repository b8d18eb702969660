import os
import subprocess
import sys

import pytest

from siamloc.locks import held

HOLDS = """
import sys
from siamloc.locks import held
with held(sys.argv[1]) as free:
    print(free, flush=True)
    sys.stdin.read()
"""


def holding(path):
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDS, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "True\n"
    return process


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_one_process_holds_it_until_it_ends_even_by_a_kill(tmp_path, kind):
    path = tmp_path / "held"
    path.mkdir() if kind == "folder" else path.touch()
    with holding(path) as other:
        with held(path) as free:
            assert not free
        other.kill()
        other.wait()
    with held(path) as free:
        assert free


def test_waiting_ends_with_what_the_file_is_by_then(tmp_path):
    path = tmp_path / "record"
    path.write_text("old")
    with holding(path) as other:
        (tmp_path / "new").write_text("new")
        (tmp_path / "new").replace(path)
        with held(path) as free:  # another file by now, which nobody holds
            assert free
        other.communicate()


def test_a_forked_child_does_not_hold_on_to_it(tmp_path):
    with held(tmp_path) as free:
        assert free
        child = os.fork()
        if child == 0:
            sys.stdin.close()
            os.execvp("sleep", ["sleep", "30"])
    try:
        with held(tmp_path, wait=True) as free:  # the child may need a moment
            assert free
            assert os.waitpid(child, os.WNOHANG) == (0, 0), "the child has ended"
    finally:
        os.kill(child, 9)
        os.waitpid(child, 0)


def test_nothing_to_hold_is_said_by_the_system(tmp_path):
    with pytest.raises(FileNotFoundError), held(tmp_path / "nothing"):
        pass
