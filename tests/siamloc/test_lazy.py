"""Names that are loaded when they are first used."""

from __future__ import annotations

import importlib

import pytest

PARTS = ("data", "evaluation", "maps", "models", "pretraining", "report", "runtime", "simulate", "training")
PACKAGES = ["siamloc", *(f"siamloc.{part}" for part in PARTS)]


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_name_is_there_and_listed_and_others_are_attribute_errors(package):
    module = importlib.import_module(package)
    for name in module.__all__:
        assert getattr(module, name) is not None
        assert name in dir(module)
    with pytest.raises(AttributeError, match="nothing"):
        _ = module.nothing
