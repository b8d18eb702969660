import subprocess
import sys
import time

import pytest

from siamloc.cli import main
from siamloc.cli.help import COMMANDS


def test_overview_names_every_command(capsys):
    assert main(["--help"]) == 0
    shown = capsys.readouterr().out
    assert all(name in shown for name in COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_each_command_helps_with_an_example(name, capsys):
    assert main([name, "--help"]) == 0
    assert f"siamloc {name}" in capsys.readouterr().out


def test_a_mistyped_command_is_answered_with_the_nearest(capsys):
    assert main(["trian"]) == 2
    assert "did you mean 'train'" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["localize", "--help"], ["localize", "bundle=nowhere", "images=[a.png]"]])
def test_the_robot_needs_nothing_that_composes_settings(words):
    code = f"""
import sys
sys.modules.update(dict.fromkeys(["torch", "hydra", "omegaconf", "yaml", "lightning"]))
from siamloc.cli import main
sys.exit(main({words}))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == (0 if "--help" in words else 2)
    assert "this needs" not in done.stderr
    assert "there is no image a.png" in done.stderr or "images=[a.jpeg,folder]" in done.stdout


def test_help_is_quick_and_the_module_runs():
    start = time.perf_counter()
    shown = subprocess.run([sys.executable, "-m", "siamloc", "--help"], capture_output=True, text=True, check=True)
    seconds = time.perf_counter() - start
    assert "usage: siamloc" in shown.stdout
    assert seconds < 5, "help must not load torch"
