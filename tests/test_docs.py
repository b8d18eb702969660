"""The documentation site builds without a warning, covers the public names, and loads nothing from elsewhere."""

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

from siamloc.cli.help import COMMANDS

ROOT = Path(__file__).parents[1]
REFERENCE = sorted((ROOT / "docs/reference").glob("*.md"))
PROSE = (".py", ".md", ".yaml", ".ipynb")
PAGES = [ROOT / "README.md", *(page for page in sorted((ROOT / "docs").rglob("*.md")) if page not in REFERENCE)]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    pytest.importorskip("mkdocs", reason="the extra `docs` is not installed")
    pytest.importorskip("material", reason="the extra `docs` is not installed")
    pytest.importorskip("mkdocstrings", reason="the extra `docs` is not installed")
    folder = tmp_path_factory.mktemp("site")
    options = ["--strict", "--quiet", "--site-dir", str(folder)]
    command = [sys.executable, "-W", "ignore", "-m", "mkdocs", "build", *options]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert built.returncode == 0, built.stdout + built.stderr
    return folder


@pytest.mark.slow
def test_no_page_loads_anything_from_elsewhere(site):
    loads = re.compile(r"""<(?:script|img|iframe|source|link)\b[^>]*?\b(?:src|href)=["']?((?:https?:)?//[^"'> ]+)""")
    found = {
        (page.name, address)
        for page in site.rglob("*.html")
        for address in loads.findall(page.read_text(encoding="utf-8"))
    }
    assert not found
    imported = re.compile(r"(?:@import|url\()\s*[\"']?(?:https?:)?//")
    assert not [sheet for sheet in site.rglob("*.css") if imported.search(sheet.read_text(encoding="utf-8"))]


@pytest.mark.slow
@pytest.mark.parametrize("page", REFERENCE, ids=lambda page: page.stem)
def test_the_reference_names_everything_public(site, page):
    module = page.read_text(encoding="utf-8").splitlines()[0].removeprefix("# ")
    text = (site / f"reference/{page.stem}.html").read_text(encoding="utf-8")
    assert "Unpack" not in text, "settings are shown one by one"
    anchors = set(re.findall(r'id="([\w.]+)"', text))
    package = importlib.import_module(module)
    public = {name for name in package.__all__ if callable(getattr(package, name))}
    assert not sorted(public - {anchor.rpartition(".")[2] for anchor in anchors})


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_names_and_commands_of_a_page_exist(page):
    text = page.read_text(encoding="utf-8")
    names = re.sub(r"[\w./-]+\.(?:md|py|json)\b", "", text)
    for dotted in set(re.findall(r"\b((?:siamloc|analytic|augment|foundation)(?:\.\w+)+)", names)):
        value = importlib.import_module(dotted.partition(".")[0])
        for name in dotted.split(".")[1:]:
            value = (
                getattr(value, name) if hasattr(value, name) else importlib.import_module(f"{value.__name__}.{name}")
            )
    commands = set(re.findall(r"(?:^|`|\$\()siamloc ([a-z]+)", text, flags=re.MULTILINE))
    assert commands <= {name.partition(" ")[0] for name in COMMANDS} | {"completion"}


def test_wi_surf_has_one_spelling():
    folders = [ROOT / name for name in ("analytic", "siamloc", "conf", "docs", "examples", "benchmarks")]
    files = [ROOT / "README.md", *(file for folder in folders for file in folder.rglob("*") if file.suffix in PROSE)]
    read = (file for file in files if "reproduced" not in file.parts)  # pages and records that a command writes
    assert not [file for file in read if re.search("Wi-S|Wisurf|WiSURF", file.read_text(encoding="utf-8"))]


def test_the_files_to_open_exist():
    text = (ROOT / "docs/design.md").read_text(encoding="utf-8").partition("## Which file to open")[2]
    names = set(re.findall(r"`([\w/]+\.(?:py|yaml|md))`", text.partition("## Sources")[0]))
    homes = (ROOT, *(ROOT / home for home in ("siamloc", "siamloc/reproduce", "analytic/mapper")))
    assert len(names) > 40
    assert not sorted(name for name in names if not any((home / name).is_file() for home in homes))
