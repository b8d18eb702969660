"""`siamloc survey`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

from foundation.files import check_writable
from foundation.words import as_words
from siamloc.data import read
from siamloc.data.checks import wrong_pictures, wrong_sizes
from siamloc.data.protocol import Protocol
from siamloc.jobs.choices import Device, Folder
from siamloc.jobs.job import Say, quiet
from siamloc.jobs.run_job import DataJob
from siamloc.maps.surveying import Survey, SurveySettings, survey
from siamloc.models.registry import PRETRAINED_SIZE


@dataclass(frozen=True, kw_only=True)
class SurveyDrives(DataJob):
    """Estimate where the frames of drives were taken, without true positions.

    Uses the images and, if there is any, the odometry of the robot. Writes into the folder: surveyed.csv, a manifest of
    the frames with x, y and theta, with which `train`, `map` and `evaluate` go on; survey.json, figures; survey.png,
    odometry, path and loops; and survey.gif, the drive as a film.

        data.manifest=FILE              the images in capture order, with odom_x, odom_y (m) and odom_theta (rad) if
                                        there is odometry
        protocol.map.sequences=[...]    the drives to survey together; all if not given
        protocol.map.every=2            fewer frames
        anchors=FILE                    a manifest with the true x, y and theta of a few of the frames, which fix
                                        position, direction and scale
        network=runs/robot              the run of a network that compares images, instead of the shipped one
        survey.apart=3.0                metres of way between two frames that may close a loop
        survey.alike=8                  similar frames that each frame is compared with
        survey.drift=0.5                degrees by which the heading of odometry is off after a metre
        survey.height=0.95              height of the camera above the floor in metres, which tells the scale unless
                                        most frames have odometry
        out=survey                      the folder

    Example:
        $ siamloc survey data.manifest=monday.csv out=monday
    """

    MORE: ClassVar[Mapping[str, Any]] = {"data": {"image_size": list(PRETRAINED_SIZE)}}

    network: str = "pretrained"
    anchors: Path | None = None
    survey: SurveySettings = field(default_factory=SurveySettings)
    device: Device = "auto"
    out: Folder = "survey"

    def run(self, say: Say = quiet) -> Survey:
        """Survey the frames, and write the folder."""
        from siamloc import models
        from siamloc.report.draw.survey import save_survey

        check_writable(Path(self.out) / "survey.json")  # before an hour of comparisons
        network = models.pretrained() if self.network == "pretrained" else models.load(self.network)
        anchors = None if self.anchors is None else read("manifest", manifest=str(self.anchors))
        every = self.protocol.map.sequences is None
        role = replace(self.protocol.map, sequences=("*",)) if every else self.protocol.map
        images, roles = replace(self, protocol=Protocol(map=role)).open_roles("map")
        for fault in (*wrong_sizes(roles["map"], images), *wrong_pictures(roles["map"], images)):
            say(f"note: {fault}")
        described = models.as_descriptor(network, self.device)
        found = survey(described, images, roles["map"], anchors=anchors, settings=self.survey)
        for note in found.notes:
            say(f"note: {note}")
        say(found.summary())
        save_survey(found, self.out, self.plain())
        shipped = self.network == "pretrained"
        by = {"descriptor": "pretrained"} if shipped else {"run": self.network}
        given = by | {"data.manifest": str(Path(self.out) / "surveyed.csv"), "protocol.map.sequences": ["*"]}
        plain = shipped and self.preprocessing.camera is None  # a run has a camera of its own
        camera = "" if plain else f" {self.preprocessing.words()}"
        say(f"next: siamloc map {as_words(given)}{camera}")
        return found
