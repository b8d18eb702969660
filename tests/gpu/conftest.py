"""The two short drives of the trainings, and the pretended GPU."""

from __future__ import annotations

import pytest

from tests.siamloc.training.conftest import SIZE, drives, frames, images

__all__ = ["SIZE", "drives", "frames", "gpu", "images"]


@pytest.fixture
def gpu():
    from tests.gpu.pretend import Pretend

    with Pretend() as gpu:
        yield gpu
