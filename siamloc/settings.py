"""Settings; see `foundation.settings`."""

from foundation.settings import *  # noqa: F403
