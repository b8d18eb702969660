"""Properties that touch the disk take as long as the disk takes: no deadline for a single example."""

from __future__ import annotations

from hypothesis import settings

settings.register_profile("unhurried", deadline=None)
settings.load_profile("unhurried")
