"""Shared by the tests of the report: two measured runs with a picture of every frame."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.siamloc.report import pages, rich


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A trained run with localization and room retrieval."""
    folder = tmp_path_factory.mktemp("run")
    return pages.write_run(folder / "vgg16", folder)


@pytest.fixture(scope="session")
def full(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with every kind of measurement."""
    folder = tmp_path_factory.mktemp("full")
    return rich.write_run(folder / "vgg16", folder)
