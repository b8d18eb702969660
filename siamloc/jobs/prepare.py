"""`siamloc prepare`."""

from __future__ import annotations

from dataclasses import dataclass

from siamloc.data import PanoramaLibrary, check, summary
from siamloc.jobs.job import Say, quiet
from siamloc.jobs.run_job import DataJob


@dataclass(frozen=True, kw_only=True)
class Prepare(DataJob):
    """Check a data set and decode its images once.

    Reads the frames, summarizes them and any problems with them, and decodes (unwraps, resizes) every image into
    the panorama store, where training and evaluation find them.

        data=manifest|cold|folder|trajectory|360loc|rawseeds   kind of data set
        data.manifest=FILE          the CSV, for data=manifest
        data.root=FOLDER            the folder, for data=cold, folder, 360loc and rawseeds
        data.images=FOLDER data.poses=FILE   images and poses over time, for data=trajectory
        data.image_size=[128,512]   rows and columns of a panorama
        data.circular=false         for ordinary cameras, whose columns do not wrap around
        unwrap=none|polar|hyperbolic  how omnidirectional images are unwrapped to panoramas
        data.on_error=raise         stop at the first unreadable image instead of leaving it out

    Example:
        $ siamloc prepare data=manifest data.manifest=my_robot.csv
    """

    SHARED = True

    def run(self, say: Say = quiet) -> PanoramaLibrary:
        """Read, decode and check the data; return the panoramas."""
        frames = self.data.read()
        say(summary(frames))
        images = self.data.library(frames, self.unwrap)
        rows, columns = images.image_size
        say(f"decoded: {len(images)} panoramas of {rows} x {columns} px in {images.settings()['cache']}")
        for finding in check(frames, images):
            say(f"note: {finding}")
        return images
