"""Help and the tab key."""

import os
import shutil
import subprocess
import sys

import pytest

from siamloc.cli import main
from siamloc.cli.help import COMMANDS, job_of, keys_of
from tests.siamloc.cli.commands import refused


def test_overview_names_every_command(capsys):
    assert main(["--help"]) == 0
    shown = capsys.readouterr().out
    assert all(name in shown for name in COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_each_command_helps_with_an_example_and_every_key(name, capsys):
    assert main([*name.split(), "--help"]) == 0
    text = capsys.readouterr().out
    assert f"siamloc {name}" in text
    assert "example:" in text
    shown = text.split()
    for group, (options, keys) in keys_of(job_of(name)).items():
        assert group.split()[0] in shown or f"{group}=" in shown
        assert {*options, *keys} <= set(shown)
    if name in ("train", "evaluate"):
        assert {"data=", "cold", "freiburg_sim", "data.manifest", "data.root", "protocol.leave_one_out"} <= set(shown)
        assert ("loss.margin" in shown, "build.omega" in shown) == (name == "train", name == "evaluate")


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("evaluate --help=1", "ignored explicit argument '1': --help lists"),
        ("train --config-dir", "expected one argument: --help lists"),
        ("train -m --cfg job seed=1,2", "--cfg shows the configuration of one job: leave out -m"),
        ("evaluate -m run=(", "the value of 'run=(' cannot be read"),
        ("doctor --cfg job", "leave '--cfg' out: this command has no settings"),
    ],
)
def test_options_that_make_no_sense_are_answered_in_one_sentence(line, says, capsys):
    assert says in refused(capsys, *line.split())


def test_commands_whose_configuration_cannot_be_shown_are_named(capsys):
    assert main(["--help"]) == 0
    shown = capsys.readouterr().out
    (line,) = (line for line in shown.splitlines() if "--cfg job" in line)
    assert {name for name in COMMANDS if name in line} == {name for name in COMMANDS if not job_of(name).BY_HYDRA}


def test_a_closed_output_is_no_error():
    shell = [sys.executable, "-m", "siamloc", "--version"]
    ended = subprocess.run(["sh", "-c", '"$@" >&-', "sh", *shell], stderr=subprocess.PIPE, text=True)
    assert (ended.returncode, ended.stderr) == (0, "")


def test_letters_that_an_output_lacks_are_escaped():
    code = "import siamloc.cli as c, siamloc.__main__ as it; c._dispatch = lambda _: print('가 ü') or 0; it.entry()"
    environment = {**os.environ, "PYTHONIOENCODING": "cp1252", "PYTHONUTF8": "0"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, env=environment)
    assert (done.returncode, done.stdout.split(), done.stderr) == (0, [rb"\uac00", b"\xfc"], b"")


def test_mistyped_commands_are_answered_with_the_nearest(capsys):
    assert "did you mean 'train'" in refused(capsys, "trian")
    assert "did you mean 'bash'" in refused(capsys, "completion", "bush")
    says = "unknown command 'augment': use one of augment expand, augment preview"
    assert says in refused(capsys, "augment", "depth=3")
    assert main(["augment", "--help"]) == 0
    assert capsys.readouterr().out.count("example:") == 2


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


@pytest.mark.parametrize(("command", "extra"), [("pretrain", "simulate"), ("survey", "train")])
def test_a_command_names_the_extra_that_brings_all_it_needs(command, extra):
    code = f"import sys; sys.modules['yaml'] = None; from siamloc.cli import main; sys.exit(main(['{command}']))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert f"pip install '.[{extra}]'" in done.stderr


def test_the_module_answers_within_five_seconds():
    command = [sys.executable, "-m", "siamloc", "--help"]
    shown = subprocess.run(command, capture_output=True, text=True, check=True, timeout=5)
    assert "usage: siamloc" in shown.stdout


READERS = ("360loc", "cold", "folder", "freiburg_sim", "manifest", "rawseeds", "trajectory")
ASKED = {
    "bash": "COMP_LINE='{0}'; COMP_POINT={1}; _siamloc; (IFS='|'; echo \"${{COMPREPLY[*]}}\")\n",
    "zsh": "COMP_LINE='{0}'; COMP_POINT={1}; _siamloc; (IFS='|'; echo \"${{COMPREPLY[*]}}\")\n",
    "fish": "string join '|' (complete --do-complete '{0}'); true\n",
}
"""How each shell is asked for its candidates, without a terminal."""


@pytest.mark.parametrize("shell", ASKED)
def test_the_tab_key_completes(shell, tmp_path):
    """By the script that users load."""
    if shutil.which(shell) is None:
        pytest.skip(f"needs {shell}")
    (tmp_path / "siamloc").write_text(f'#!/bin/sh\nexec {sys.executable} -m siamloc "$@"\n')
    (tmp_path / "siamloc").chmod(0o755)
    before = "" if shell == "bash" else "data="  # bash alone ends a word at "="
    lines = {
        "siamloc tr": "train ",
        "siamloc augment ": "expand |preview ",
        "siamloc train data=": "|".join(f"{before}{name}" for name in READERS),
        "siamloc train data=folder pairs.l": "pairs.label=",
        "siamloc map model/he": "model/head=",
    }
    load = "siamloc completion fish | source\n" if shell == "fish" else f'eval "$(siamloc completion {shell})"\n'
    script = load + "".join(ASKED[shell].format(line, len(line)) for line in lines)
    path = f"{tmp_path}:{os.environ['PATH']}"
    done = subprocess.run([shell, "-c", script], capture_output=True, text=True, env={**os.environ, "PATH": path})
    assert done.returncode == 0, done.stderr
    assert done.stdout.split("\n")[:-1] == list(lines.values())
