from __future__ import annotations

import subprocess
import sys

import pytest


@pytest.mark.parametrize("name", ["augment.Augment", "siamloc.models.build"])
def test_what_is_not_installed_is_named_with_the_extra_that_has_it(name):
    code = f"import sys; sys.modules['torch'] = None; import augment, siamloc; {name}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "this needs torch, which is not installed here: run pip install '.[train]'" in done.stderr
