"""Files; see `foundation.files`."""

from foundation.files import *  # noqa: F403
