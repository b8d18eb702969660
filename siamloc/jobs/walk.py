"""`siamloc walk`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from siamloc.jobs.choices import Folder
from siamloc.jobs.job import Job, Say, quiet
from siamloc.walking import Walked, WalkSettings, walk


@dataclass(frozen=True, kw_only=True)
class Walk(WalkSettings, Job):
    """Make a robot that knows where it is from one recording of a drive.

    Finds the camera, chooses key frames, surveys them, makes a map, learns the expected errors, and writes the robot's
    bundle and a report into one folder, which is then a run. True poses are not needed. Says in a line what it decides.

        monday.mp4                      the recording: a video, a ROS bag, or a folder of pictures
        recording.odometry=FILE         poses by the robot's wheels over time, or the topic of a bag; without any, the
                                        scale of the map may be off by a tenth or more
        survey.height=0.95              height of the camera above the floor in metres, which tells the scale unless
                                        most pictures have odometry; not for a ring of two radii
        unwrap=polar unwrap.inner=60    another camera than the one found; unwrap.forward=90 and unwrap.mirrored=false
                                        say what the pictures of a ring do not show
        recording.rate=5                pictures per second that are looked at, at most
        spacing=0.3                     metres between key frames, at least
        survey.apart=3.0                metres of way between two frames that may close a loop
        left_out=3                      every third key frame is left out of the map, to learn and measure errors
        lost_above=1.0                  expected error in metres above which the robot counts as lost
        out=walk                        the folder
        overwrite=true                  replace a bundle in it even if robots updated its map

    Example:
        $ siamloc walk monday.mp4 out=robot
    """

    GROUPS: ClassVar[Mapping[str, str]] = {"unwrap": "auto"}
    MORE: ClassVar[Mapping[str, Any]] = {"file": "???"}
    ALONE = "file"

    file: Path
    unwrap: Mapping[str, Any]
    out: Folder = "walk"
    overwrite: bool = False

    def run(self, say: Say = quiet) -> Walked:
        """Make the map, the bundle and the report."""
        return walk(self.file, self.out, say=say, overwrite=self.overwrite, settings=self.narrowed(WalkSettings))
