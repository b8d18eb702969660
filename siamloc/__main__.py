"""`python -m siamloc`."""

import sys

from siamloc.cli import main

sys.exit(main())
