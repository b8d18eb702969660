"""The lines of Python in the README run as they are written, on a small data set of one's own."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

import siamloc

README = Path(__file__).parents[1] / "README.md"
FRAMES = 6


def blocks():
    """The Python code blocks of the README, in order."""
    return re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), flags=re.DOTALL)


@pytest.fixture
def robot(tmp_path, monkeypatch):
    """A folder with `robot.csv`, two drives of a few small pictures, and a photograph; the current folder."""
    noise = np.random.default_rng(0)
    places = noise.integers(0, 256, (FRAMES, 8, 32, 3)).astype(np.uint8)
    rows = ["image,x,y,theta,room,sequence"]
    for drive in ("monday", "tuesday"):
        for number, place in enumerate(places):
            name = f"{drive}_{number}.png"
            cv2.imwrite(str(tmp_path / name), cv2.resize(place, (128, 32), interpolation=cv2.INTER_NEAREST))
            rows.append(f"{name},{number},0,0,{'office' if number < FRAMES // 2 else 'corridor'},{drive}")
    (tmp_path / "robot.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    (tmp_path / "photo.jpg").write_bytes((tmp_path / "tuesday_4.png").read_bytes())
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SIAMLOC_CACHE", str(tmp_path / "cache"))
    return tmp_path


@pytest.mark.slow
def test_the_lines_of_the_readme_run_as_written(robot, capsys):
    names = {"siamloc": siamloc}
    for code in blocks():
        exec(compile(code, str(README), "exec"), names)
    assert (robot / "runs/robot/run.json").is_file()
    assert names["result"].measures["queries"] == FRAMES
    assert names["location"].room in ("office", "corridor")
    assert "recall@1" in capsys.readouterr().out


def test_every_link_of_the_readme_leads_somewhere():
    links = re.findall(r"\]\(([^)#]+)", README.read_text(encoding="utf-8"))
    missing = [link for link in links if not link.startswith("http") and not (README.parent / link).exists()]
    assert not missing
