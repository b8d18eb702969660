"""`siamloc map`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from analytic.mapper import IncrementalMapper
from foundation.files import check_writable
from foundation.settings import defaults_of
from foundation.words import as_words
from siamloc import maps
from siamloc.errors import ConfigError
from siamloc.jobs.job import Given, Say, quiet
from siamloc.jobs.options import words_of
from siamloc.jobs.run_job import RunJob, files_in
from siamloc.jobs.stored import map_places, titles_of
from siamloc.jobs.sweep import swept
from siamloc.maps import Built, Refinement, VisualMap
from siamloc.maps.axes import warn_of_axes
from siamloc.maps.history import UPKEEP
from siamloc.maps.maintenance import Maintenance
from siamloc.runs import Run
from siamloc.runtime.bundle import THUMBNAILS
from siamloc.runtime.exportable import check_not_updated


@dataclass(frozen=True)
class Drives(Maintenance):
    """The drives that maintain a map, one after the other, and how much evidence calls for an update.

    Attributes:
        sequences: names or shell patterns of the drives; a map is made instead of maintained if there are none.

    Raises:
        ConfigError: other settings without sequences, or a value of the wrong type or out of range.
    """

    sequences: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.sequences and self.plain() != defaults_of(Drives):
            raise ConfigError("the settings of update need drives: add update.sequences=[NAME]")


@dataclass(frozen=True, kw_only=True)
class MapFrames(RunJob):
    """Describe the map frames of a run.

    Writes map.npz into the run: descriptors, poses and rooms of the frames that the robot knows.

        run=FOLDER                      the run, or a sweep: each of its runs; only a trained network needs one
        protocol.map.sequences=[...]    sequences of the map; the training sequences if not given
        protocol.map.every=5            or protocol.map.spacing=0.5
        descriptor=pretrained           the network that ships with siamloc, no training needed; 64 x 256 pixels
        descriptor=hog                  or an analytic descriptor; all groups are listed below
        descriptor=[pretrained,hsv,hog] several as one, with weights learned on protocol.validation.sequences=[...]
        heading=hog                     estimates headings for a network that cannot (the heads fourier and magnitudes
                                        with circular=true can); heading.step=4 halves the size of its part of the map
        mounting.yaw=90                 how the camera is mounted, which a network that compares otherwise estimates:
                                        the panorama's middle looks 90 degrees to the left of the heading;
                                        mounting.mirrored=true, mounting.ahead=0.3, mounting.left=-0.1; what is not said
                                        is straight, so mounting.yaw=0 alone switches the estimate off
        build=incremental|incremental_sparse|spectral|som|sample|rooms
                                        also group the frames into nodes, and write that coarse layer
        build.nodes=40 build.y=1.5      its parameters; `siamloc map build=... --cfg job` lists them
        update.sequences=[tuesday]      maintain the map instead, by drives with positions, or without if the map can
                                        locate them: frames join it where it is out of date, and frames that several
                                        drives contradict leave it; with build=NAME, its nodes follow. Draws
                                        staleness.png: where the building has changed
        update.growth=1.5               up to 1.5 times as many frames; update.per_square_metre=12, update.megabytes=5
        update.contradicted=3           out of date: 3 of update.window=5 frames in a row contradict the map
        -m descriptor.bins=8,16         a sweep: each map in its own folder, evaluation/hog/descriptor.bins-8, where an
                                        evaluation of the same sweep finds it

    Example:
        $ siamloc map run=runs/vgg16 protocol.map.every=5
    """

    REPLACES_MAP = True

    update: Drives

    @classmethod
    def completed(cls, values: dict[str, Any], given: Given) -> dict[str, Any]:
        """Return values together with the settings of the run; refuse to update a map that does not exist."""
        values = super().completed(values, given)
        if isinstance(values["update"], Mapping) and values["update"].get("sequences"):
            titles = titles_of(values)
            label = titles["descriptor"]
            folder = values["run"] or Path("runs") / (values["data"].get("name") or "data") / label
            if not (path := map_places(Run(Path(str(folder))), titles)[0]).is_file():
                command = f"siamloc map {as_words({'run': folder, 'descriptor': label})}"
                raise ConfigError(f"no map yet in {path}: `{command}` makes one")
        return values

    def run(self, say: Say = quiet) -> VisualMap:
        """Describe the map frames of the run, and group them into nodes if requested."""
        if self.update.sequences:
            return self._maintained(say)
        run, label, target = self.here, self.descriptor.title, map_places(self.here, self.titles)[0]
        check_writable(target)  # as all that follows, before any image is decoded
        check_not_updated(target)
        described, heading = self.make_descriptor(), self.make_heading(say)
        images, roles = self.open_roles("map", *self.learned_from)
        made = {"role": self.protocol.map.plain()}
        given: dict[str, Any] = {"distance": self.distance, "mounting": self.mounting.known, "made": made}
        given |= {"heading": heading, "validation": roles.get("validation")}
        known = maps.build(described, images, roles["map"], **given)
        known.save(target)
        run.record_written([target])
        warn_of_axes(known)
        bare = len(known) - int(known.frames.has_position.sum())
        without = f", {bare} of which have no position: images most like them get none" if 0 < bare < len(known) else ""
        say(f"map: {target}, {len(known)} frames{without}, descriptors of {known.width} numbers")
        if "fusion" in known.made:
            say(f"weights: {known.made['fusion']}")
        if known.heading is not None and known.orientation is not None:
            size = known.orientation[0].nbytes
            what = "headings" if known.heading_by.tells_heading else "comparison"
            if what == "comparison" or np.isfinite(known.frames.theta).any():
                say(f"{what}: by {known.heading['name']}, {size} bytes a frame")
        if self.build.name != "none":
            folder = self.layer_folder(label)
            say(self.group(known, folder).summary(folder))
        if not swept():
            protocol = self.for_evaluation(self.protocol, self.data.read, "query")
            task = "mapping" if bare == len(known) and protocol is not None else "hierarchical"
            self._say_next(say, "export" if protocol is None else "evaluate", protocol or {}, task)
        return known

    def _maintained(self, say: Say) -> VisualMap:
        """Maintain the saved map, and the saved nodes over it if a build is named."""
        from siamloc.report.draw.look import save
        from siamloc.report.draw.staleness import staleness_picture

        path, built, label = map_places(self.here, self.titles)[0], None, self.descriptor.title
        known = self.load_map(path, self.make_descriptor())
        assert known is not None  # or the job could not have been made
        folder = self.layer_folder(label)
        stored = {one.parent: Built.load(one.parent) for one in self.here.folder.glob("layers/**/layer.npz")}
        over = {one: layer for one, layer in stored.items() if layer.map_digest == known.digest}
        if self.build.name != "none":
            if (built := over.pop(folder, None)) is None:
                # `siamloc map` makes the map as well, and would lose what updates changed
                command, task = ("evaluate", {"task": "mapping"}) if UPKEEP in known.made else ("map", {})
                words = as_words({**self.named, **words_of("build", self.build), **task})
                raise ConfigError(f"{folder} has no nodes over the map {path}: `siamloc {command} {words}` makes them")
            if (folder / "mapper.npz").is_file():
                mapper = IncrementalMapper.load(folder / "mapper.npz", known.descriptor, extend=True)
                built = replace(built, mapper=mapper)
        if over:
            other = min(over)
            name = other.relative_to(self.here.folder / "layers").parts[0].removeprefix(f"{label}-")
            update = f"update them as well, with `siamloc map build={name} update.sequences=[...]`, or "
            raise ConfigError(
                f"{other} holds nodes over this map, which would not fit the map after an update: "
                f"{update if built is None else ''}remove the folder"
            )
        frames = self.data.read()
        known.check_frames(frames, whole=False)
        try:
            drives = frames.select(sequence=self.update.sequences)
        except ConfigError as error:
            raise ConfigError(f"update.sequences: {error}") from error
        images = self.data.library(drives, self.unwrap)
        drives = images.readable(drives)
        settings = self.update.narrowed(Maintenance)
        before, updates = known.digest, []
        for name, rows in drives.rows_by("sequence").items():
            found = maps.update(known, images, drives.take(rows), built=built, settings=settings)
            known, built = found.known, found.built
            updates.append(found)
            say(f"{name}: {found.summary()}" if name else found.summary())
        if known.digest != before:
            # Removed first and written last: an interruption leaves no nodes next to a map that they do not fit.
            (folder / "layer.npz").unlink(missing_ok=True)
        known.save(path)
        if built is not None and known.digest != before:
            built.save(folder)
        picture = path.with_name("staleness.png")
        self.here.record_written([path, picture, *(files_in(folder) if built is not None else [])])
        save(staleness_picture(*updates), picture)
        say(f"picture: {picture}")
        if not swept():
            refined = Refinement.saved(path.with_name("refinement.json")) if self.build.name == "none" else None
            more: dict[str, Any] = {} if refined is None else {"task.refine": refined.method}
            if (self.here.bundle / THUMBNAILS).exists():
                more["thumbnails"] = True
            self._say_next(say, "export", more)
        return known

    def _say_next(self, say: Say, command: str, more: Mapping[str, Any], task: str = "hierarchical") -> None:
        """Say which command goes on with the map, with more settings; with nodes, the task is named."""
        further: dict[str, Any] = {}
        if self.build.name != "none":
            further = {
                "task": task,
                **words_of("build", self.build),
                **({"seed": self.seed} if self.seed else {}),
            }
        say(f"next: siamloc {command} {as_words({**self.named, **more, **further})}")
