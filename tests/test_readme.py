"""The Python of the README and of the how-to pages runs as it is written, on a small custom data set."""

import re
from pathlib import Path

import pytest

import siamloc

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"


def run(page, names):
    """Execute the Python code blocks of a page in order."""
    for code in re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL):
        exec(compile(code, str(page), "exec"), names)
    return names


@pytest.mark.slow
def test_the_lines_of_the_readme_run_as_written(robot, capsys):
    names = run(README, {})
    assert (robot / "runs/robot/run.json").is_file()
    assert names["result"].measures["queries"] == len(names["tuesday"])
    assert names["location"].room in ("office", "corridor")
    assert "recall@1" in capsys.readouterr().out


@pytest.mark.slow
def test_a_network_a_loss_and_a_descriptor_of_ones_own_run_as_the_page_says(robot):
    frames = siamloc.data.read("manifest", manifest="robot.csv")
    images = siamloc.data.PanoramaLibrary(frames, image_size=(32, 128))
    monday, tuesday = frames.select(sequence="monday"), frames.select(sequence="tuesday")
    names = run(ROOT / "docs/howto/network.md", {"images": images, "monday": monday, "tuesday": tuesday})
    assert (robot / "runs/small/bundle/model.onnx").is_file()
    assert (robot / "runs/soft/run.json").is_file()
    assert names["result"].name == "mean_colour"
    assert (robot / "runs/colour/bundle/model.onnx").is_file()


def test_every_link_of_the_readme_leads_somewhere():
    links = re.findall(r"\]\(([^)#]+)", README.read_text(encoding="utf-8"))
    missing = [link for link in links if not link.startswith("http") and not (ROOT / link).exists()]
    assert not missing


def test_the_readme_gives_the_score_of_the_claims_as_the_report_does():
    report = (ROOT / "docs/results/reproduced/report.md").read_text(encoding="utf-8")
    (score,) = re.findall(r"^Of \d+ claims .*$", report, flags=re.MULTILINE)
    assert score in " ".join(README.read_text(encoding="utf-8").split())
