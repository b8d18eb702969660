"""The examples in the docstrings run, and print what they show."""

import doctest
import importlib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MODULES = [
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    for package in ("analytic", "augment", "foundation", "siamloc")
    for path in sorted((ROOT / package).rglob("*.py"))
    if ">>> " in path.read_text(encoding="utf-8")
]


@pytest.mark.parametrize("module", MODULES)
def test_examples(module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    imported = importlib.import_module(module)
    found = [test for test in doctest.DocTestFinder().find(imported) if test.examples]
    assert found, f"doctest finds none of the examples of {module}"
    assert not doctest.testmod(imported).failed
