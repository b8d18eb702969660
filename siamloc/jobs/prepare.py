"""`siamloc prepare`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from analytic import Descriptor
from foundation.files import write_picture
from foundation.words import as_words
from siamloc.data import AutoRing, PanoramaLibrary, check, contents, extract, find_mounting, summary
from siamloc.data.extracting import MANIFEST, Contents, Extraction, drive_name, writes_camera
from siamloc.data.image_files import read_image
from siamloc.data.reading import DataSettings
from siamloc.data.ring import draw_ring
from siamloc.jobs.job import Given, Say, quiet
from siamloc.jobs.run_job import DataJob

_PANORAMAS = {"data.image_size": list(DataSettings.image_size), "data.circular": DataSettings.circular}


@dataclass(frozen=True)
class RecordingKeys(Extraction):
    """A recording to prepare, and what to take from it.

    Attributes:
        file: the recording: a ROS bag, a video, or a folder of pictures.
        out: the folder for its images; if None, the recording is only looked into.
    """

    file: Path | None = None
    out: Path | None = None


@dataclass(frozen=True, kw_only=True)
class Prepare(DataJob):
    """Check a data set and decode its images once.

    Reads the frames, summarizes them and any problems with them, and decodes (unwraps, resizes) every image into
    the panorama store, where training and evaluation find them.

        data=manifest|cold|folder|trajectory|360loc|rawseeds   kind of data set
        data.manifest=FILE          the CSV, for data=manifest, or a pattern that fits several: '*_frames/frames.csv'
        data.root=FOLDER            the folder, for data=cold, folder, 360loc and rawseeds
        data.images=FOLDER data.poses=FILE   images and poses over time, for data=trajectory
        data.image_size=[128,512]   rows and columns of a panorama
        data.circular=false         for ordinary cameras, whose columns do not wrap around
        unwrap=none|equirectangular|dual_fisheye|polar|calibrated|...   the camera, whose images become panoramas
        unwrap=auto                 the ring of a mirror, found in the pictures of each drive, and where its front is
        unwrap.file=camchain.yaml   its calibration, for unwrap=calibrated
        data.on_error=raise         stop at the first unreadable image instead of leaving it out

    A recording (a ROS 1 or ROS 2 bag, a video, or a folder of pictures) is only looked into: what is inside, and the
    command that extracts it. With recording.out, its images and their manifest are written first:

        drive.bag                   the recording
        recording.out=FOLDER        where its images and frames.csv go
        recording.images=TOPIC      and poses=, odometry=: a topic, a frame such as map:base_link, or a file of poses
        recording.every=5           every fifth image; recording.rate=5 for at most five per second on average
        recording.offset=0.2        seconds to add to the times of the images; recording.clock=bag for the recorder's

    Example:
        $ siamloc prepare data=manifest data.manifest=my_robot.csv
    """

    SHARED = True
    ALONE = "recording.file"

    recording: RecordingKeys = field(default_factory=RecordingKeys)

    @classmethod
    def completed(cls, values: dict[str, Any], given: Given) -> dict[str, Any]:
        """Return the values with the manifest that the recording gets."""
        values = super().completed(values, given)
        recording = values["recording"]
        if recording.get("file") is None:
            return values
        return {**values, "data": {**values["data"], "manifest": str(Path(recording["out"] or "") / MANIFEST)}}

    @property
    def has_camera(self) -> bool:
        """Whether the camera is known before the job runs: extracting the recording may write its calibration."""
        return self.recording.out is None or not writes_camera(self.recording.out, self.unwrap)

    def run(self, say: Say = quiet) -> PanoramaLibrary | Contents:
        """Read, decode and check the data; return the panoramas, or the contents of a recording."""
        from siamloc import models

        if self.recording.file is not None:
            second = self.unwrap.get("second")
            found = contents(self.recording.file, self.recording.times, second)
            say(found.describe())
            if self.recording.out is None:
                usual, given = RecordingKeys().plain(), self.recording.plain()
                chosen = {key: value for key, value in given.items() if key != "file" and value != usual[key]}
                chosen = {"file": self.recording.file, **found.proposal, **chosen}
                if chosen.get("images", "none") == "none":
                    say(f"there is nothing to extract: no topic of {self.recording.file} holds images")
                    return found
                chosen |= {"out": f"{drive_name(found.file)}_frames"}
                panoramas = {"data.image_size": list(self.data.image_size), "data.circular": self.data.circular}
                kept = {key: value for key, value in panoramas.items() if value != _PANORAMAS[key]}
                words = as_words({**{f"recording.{key}": value for key, value in chosen.items()}, **kept})
                camera = "" if self.preprocessing.camera is None else f" {self.preprocessing.words()}"
                say(f"next: siamloc prepare {words}{camera}")
                return found
            extract(self.recording.file, self.recording.out, second=second, settings=self.recording)
        frames = self.data.read()
        say(summary(frames))
        images = self.data.library(frames, self.unwrap)
        rows, columns = images.image_size
        say(f"decoded: {len(images)} panoramas of {rows} x {columns} px in {images.settings()['cache']}")
        network = models.as_descriptor(models.pretrained(), "cpu") if images.circular else None
        rings = network is not None and _show_rings(images, network, say)
        for finding in check(frames, images, network, mounting=not rings):
            say(f"note: {finding}")
        return images


def _show_rings(images: PanoramaLibrary, network: Descriptor, say: Say) -> bool:
    """Say for each drive which ring was found, and where its front is; draw it. Return whether there are rings."""
    rings = {drive: ring for drive, ring in images.cameras.items() if isinstance(ring, AutoRing)}
    for drive, ring in rings.items():
        frames = images.frames.select(sequence=drive)
        mounted = find_mounting(network, images, frames)
        proposed = mounted.ring(ring)
        x, y = ring.centre or (0.0, 0.0)
        path = Path(images.settings()["cache"]) / f"ring_{drive.replace('/', '_') or 'drive'}.png"
        picture = read_image(frames.path[0])
        write_picture(path, draw_ring(picture, proposed, images.preprocessing.view)[..., ::-1])
        given = ring == images.preprocessing.camera
        say(
            f"ring: {'as given' if given else 'found'} in {drive or 'the drive'}, unwrap.centre=[{x:.1f},{y:.1f}] "
            f"unwrap.inner={ring.inner:.1f} unwrap.outer={ring.outer:.1f}; see {path}"
        )
        deviation = "" if np.isnan(mounted.yaw) else f" +- {mounted.yaw_deviation:.1f} degrees"
        front = "as given" if np.isnan(mounted.yaw) else "found"
        side = "as given" if mounted.mirrored is None else "found"
        say(
            f"direction: unwrap.forward={proposed.forward:.1f} {front}{deviation}, "
            f"unwrap.mirrored={str(proposed.mirrored).lower()} {side}{''.join('; ' + why for why in mounted.reasons)}"
        )
    return bool(rings)
