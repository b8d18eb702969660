"""The exception of this package."""

from __future__ import annotations


class AnalyticError(ValueError):
    """A parameter, an image or a description that cannot be used; one sentence says which and what to do."""
