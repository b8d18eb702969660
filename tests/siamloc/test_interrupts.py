import signal
import subprocess
import sys
import time

import pytest

from siamloc.cli import main
from siamloc.interrupts import follows_from

WAITS = """
import sys, time
import siamloc.cli
from siamloc.__main__ import entry

def wait(words):
    try:
        print("ready", flush=True)
        time.sleep(60)
    finally:
        print("cleaning", flush=True)
        time.sleep(float(sys.argv[1]))
        print("clean", flush=True)

siamloc.cli._dispatch = wait
entry()
"""


def started(code, *arguments, sent=signal.SIGINT):
    """Start a program, interrupt it once it is ready, and return it while it cleans up."""
    command = [sys.executable, "-c", code, *map(str, arguments)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    process.send_signal(sent)
    assert process.stdout.readline() == "cleaning\n"
    return process


def test_once_stops_and_cleans_up():
    with started(WAITS, 0) as process:  # `communicate` would pass over what `readline` has read ahead
        assert (process.stdout.read(), process.stderr.read()) == ("clean\n", "siamloc: interrupted\n")
    assert process.returncode == 130


ROBOT = """
import time
import siamloc.cli
from siamloc.__main__ import entry
from siamloc.jobs.robot import Localize

def run(self, say):
    try:
        say("ready")
        for _ in range(3000):  # a signal just before a wait is heard after it
            time.sleep(0.02)
    except KeyboardInterrupt:
        say("cleaning")
        raise

Localize.run = run
entry()
"""


def test_a_service_that_is_stopped_cleans_up():
    with started(ROBOT, "localize", sent=signal.SIGTERM) as process:
        assert (process.stdout.read(), process.stderr.read()) == ("", "")
    assert process.returncode == 143
    with started(ROBOT, "localize") as process:
        assert process.stderr.read() == "siamloc: interrupted\n"
    assert process.returncode == 130


IGNORES = """
import os, signal, sys, threading, time
import siamloc.cli
from siamloc.__main__ import entry

class Destroyed:
    def __del__(self):
        print("ready", flush=True)
        time.sleep(60)

class Fails:
    def __del__(self):
        raise KeyboardInterrupt("of another thread") if sys.argv[1] == "thread" else ValueError("of another kind")

def work(words):
    other = threading.Thread(target=Fails)
    other.start()
    other.join()
    Destroyed()
    try:
        time.sleep(60)
    finally:
        print("cleaning", flush=True)
        time.sleep(float(sys.argv[2]))
    print("went on")

siamloc.cli._dispatch = work
entry()
"""


@pytest.mark.parametrize(("code", "words"), [(WAITS, [50]), (IGNORES, ["other", 50])], ids=["once", "swallowed"])
def test_a_second_interrupt_ends_the_process_at_once(code, words):
    begin, process = time.monotonic(), started(code, *words)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=40)
    assert (process.returncode, out, "siamloc" in err) == (-signal.SIGINT, "", False)
    assert time.monotonic() - begin < 40


@pytest.mark.parametrize(("fails", "said"), [("other", "of another kind"), ("thread", "of another thread")])
def test_an_interrupt_that_a_destructor_swallows_is_raised_again(fails, said):
    process = started(IGNORES, fails, 0)
    out, err = process.communicate(timeout=40)
    assert (process.returncode, out) == (130, "")
    assert said in err, "what else is ignored is told as ever"
    assert "hear_again" not in err
    assert err.endswith("siamloc: interrupted\n")


def test_an_interrupt_that_another_error_hides_is_one_still(monkeypatch, capsys):
    def hides(words):
        try:
            raise KeyboardInterrupt
        finally:
            raise AttributeError("half made")

    monkeypatch.setattr("siamloc.cli._dispatch", hides)
    assert main(["train"]) == 130
    assert capsys.readouterr().err == "siamloc: interrupted\n"


def test_other_errors_do_not_follow_from_one():
    error = ValueError("a")
    error.__cause__ = KeyError("b")
    error.__cause__.__context__ = error
    assert not follows_from(error)
    assert not follows_from(None)
    error.__cause__.__cause__ = KeyboardInterrupt()
    assert follows_from(error)


@pytest.mark.parametrize("status", [0, 2])
def test_the_process_has_the_status_of_the_command(status):
    words = ["--version"] if status == 0 else ["tain"]
    done = subprocess.run([sys.executable, "-m", "siamloc", *words], capture_output=True, check=False)
    assert done.returncode == status
