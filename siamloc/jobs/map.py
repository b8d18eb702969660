"""`siamloc map`."""

from __future__ import annotations

from dataclasses import dataclass

from siamloc import maps
from siamloc.jobs.choices import OF_A_RUN
from siamloc.jobs.job import Say, quiet
from siamloc.jobs.options import choices, option
from siamloc.jobs.run_job import RunJob, files_in
from siamloc.jobs.stored import map_places
from siamloc.jobs.sweep import of_layer, own_folder, swept
from siamloc.maps import VisualMap


@dataclass(frozen=True, kw_only=True)
class MapFrames(RunJob):
    """Describe the map frames of a run.

    Writes map.npz into the run: descriptors, poses and rooms of the frames that the robot knows.

        run=FOLDER                      the run, or a sweep: each of its runs; only a trained network needs one
        protocol.map.sequences=[...]    sequences of the map; the training sequences if not given
        protocol.map.every=5            or protocol.map.spacing=0.5
        descriptor=pretrained           the network that ships with siamloc, no training needed; 64 x 256 pixels
        descriptor=hog                  or an analytic descriptor; all groups are listed below
        heading=hog                     estimates headings for a network that cannot (the heads fourier and magnitudes
                                        with circular=true can); heading.step=4 halves the size of its part of the map
        build=incremental|spectral|som|sample|rooms
                                        also group the frames into nodes, and write that coarse layer
        build.nodes=40 build.y=1.5      its parameters; `siamloc map build=... --cfg job` lists them
        -m descriptor.bins=8,16         a sweep: each map in its own folder, evaluation/hog/descriptor.bins-8, where an
                                        evaluation of the same sweep finds it

    Example:
        $ siamloc map run=runs/vgg16 protocol.map.every=5
    """

    REPLACES_MAP = True

    def run(self, say: Say = quiet) -> VisualMap:
        """Describe the map frames of the run, and group them into nodes if requested."""
        run, label = self.here, self.descriptor.title
        described, heading = self.make_descriptor(), self.make_heading(say)  # before any image is decoded
        images, roles = self.open_roles("map")
        made = {"role": self.protocol.map.plain()}
        known = maps.build(described, images, roles["map"], heading=heading, distance=self.distance, made=made)
        target = map_places(run, self.titles)[0]
        known.save(target)
        run.record_written([target])
        say(f"map: {target}, {len(known)} frames, descriptors of {known.width} numbers")
        if known.heading is not None and known.orientation is not None:
            size = known.orientation[0].nbytes
            say(f"headings: by {known.heading['name']}, {size} bytes a frame")
        if self.build.name != "none":
            folder = own_folder(run.layer(label, self.build.title), self.titles, of_layer)
            built = maps.group(known, folder=folder, **self.way)
            run.record_written(files_in(folder))
            say(built.summary(folder))
        if not swept():
            further = "" if self.descriptor.name in OF_A_RUN else f" descriptor={label}{self._changed()}"
            if self.build.name != "none":
                further = f" task=hierarchical build={self.build.title}"
            say(f"next: siamloc evaluate run={run.folder}{further}")
        return known

    def _changed(self) -> str:
        """Return the parameters of the descriptor that are not those of its option, as words of the command line."""
        chosen, title = self.descriptor.parameters, self.descriptor.title
        usual = option("descriptor", title if title in choices("descriptor") else self.descriptor.name).values
        return "".join(f" descriptor.{key}={value}" for key, value in chosen.items() if value != usual.get(key))
