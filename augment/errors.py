"""The exception of this package, and the spelling hint at the end of its messages."""

from __future__ import annotations

from foundation.errors import ConfigError, hint

__all__ = ["AugmentError", "hint"]


class AugmentError(ConfigError):
    """The error for a parameter, policy or batch that cannot be used; the message says which, and what to do."""
