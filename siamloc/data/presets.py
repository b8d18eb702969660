"""Rings that are found in the pictures: of any camera below a mirror, and of the COLD database's."""

from __future__ import annotations

from dataclasses import dataclass

from foundation.settings import NotNegative, Positive
from siamloc.data.panorama import Array, PanoramaView, PolarRing
from siamloc.errors import ConfigError


@dataclass(frozen=True)
class AutoRing(PolarRing):
    """A ring whose centre and radii a `PanoramaLibrary` finds in the pictures of each drive (`find_ring`).

    Values that are given are kept where the pictures do not surely show a ring near them. Which way the robot faces in
    the picture, and whether it is mirrored, is as given: `find_mounting` says what it should be.
    """

    def sampling(self, view: PanoramaView, image_size: tuple[int, int]) -> tuple[Array, Array]:
        """Return the columns (H, W) and rows (H, W) in the omnidirectional image of a panorama's pixels.

        Raises:
            ConfigError: no centre or radius, which single pictures do not show; or as for `PolarRing`.
        """
        if self.centre is None or self.inner is None or self.outer is None:
            raise ConfigError(
                "unwrap=auto finds the ring in the pictures of a drive, not in single ones: see what `siamloc prepare` "
                "finds, and give it as unwrap=polar with unwrap.centre, unwrap.inner and unwrap.outer"
            )
        return super().sampling(view, image_size)


@dataclass(frozen=True)
class ColdRing(AutoRing):
    """The ring of the COLD database, in its pictures of 640 x 480, corrected by those of each drive.

    The values come from papers and code of people who worked with the data: nothing of them could be checked against
    the archives, least of all where the robot's front is, which `siamloc prepare data=cold` finds. Correct them here,
    in this one place.
    """

    centre: tuple[float, float] | None = (331.0, 240.0)
    inner: NotNegative | None = 20.0
    outer: Positive | None = 228.0
    forward: float = 270.0
    mirrored: bool = True
