"""`siamloc doctor`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from siamloc.errors import SiamlocError
from siamloc.jobs.job import Job, Say, quiet

if TYPE_CHECKING:
    from siamloc.checkup import Checkup


@dataclass(frozen=True)
class Doctor(Job):
    """Show what is installed, what it lets you do, and whether it works.

    Shows versions, devices and onnxruntime's execution providers, names what each command lacks and the extra that
    installs it, and lets the shipped network describe a picture whose description is known (HOG without torch).
    The exit status is 2 if something is wrong. Attach the output to a report of a bug.

    Example:
        $ siamloc doctor
    """

    BY_HYDRA: ClassVar[bool] = False

    def run(self, say: Say = quiet) -> Checkup:
        """Say the findings, and return them.

        Raises:
            SiamlocError: something is wrong.
        """
        from siamloc.checkup import doctor

        found = doctor()
        say(found.text())
        if found.problems:
            raise SiamlocError(f"problems found: {len(found.problems)}, listed above")
        return found
