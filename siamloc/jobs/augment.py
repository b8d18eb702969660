"""`siamloc augment expand` and `siamloc augment preview`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

from foundation.files import PICTURES, is_picture, write_picture
from foundation.settings import Rule, Seed, Text, Thousand
from siamloc.jobs.choices import Folder
from siamloc.jobs.job import Say, quiet
from siamloc.jobs.run_job import DataJob

Depth = Annotated[int, Rule("a whole number from 1 to 10,000", lambda value: 1 <= value <= 10_000)]
Picture = Annotated[str, Rule(f"a picture's name, ending {' '.join(PICTURES)}", is_picture)]


@dataclass(frozen=True, kw_only=True)
class Expand(DataJob):
    """Write an augmented data set in the input's own layout.

    Makes `depth` images of every frame (the original, spots of light and darkness, global light, blur and the other
    effects, their combinations, rotations) and writes them in the layout of the data set: COLD's folders and names
    with the turned heading, a manifest, or an image folder. augmentation.csv holds the parameters of every image.
    Images are panoramas of data.image_size, already unwrapped.

        data=manifest|cold|folder   kind of data set, with data.manifest=FILE or data.root=FOLDER
        out=FOLDER                  output folder
        depth=16                    images per frame; 16, 44, 128, 129 and 246 in the thesis
        sequences=[...]             names or patterns of the sequences to expand; all if not given
        resume=true                 continue an interrupted run in its folder; makes only what is missing
        seed=0 workers=2
        data.on_error=raise         stop at the first unreadable image instead of leaving it out

    Example:
        $ siamloc augment expand data=cold data.root=/data/COLD sequences=['*seq2_cloudy3'] depth=16 out=expanded
    """

    MORE: ClassVar[Mapping[str, Any]] = {"out": "???"}

    out: Folder
    depth: Depth = 16
    sequences: tuple[Text, ...] | Text | None = ()
    seed: Seed = 0
    workers: Thousand = 2
    resume: bool = False

    def run(self, say: Say = quiet) -> Any:
        """Write the augmented data set."""
        from siamloc import data

        frames = self.data.read()
        if self.sequences:
            frames = frames.select(sequence=self.sequences)
        expanded = data.expand(
            frames,
            self.out,
            unwrap=self.unwrap,
            **{key: getattr(self.data, key) for key in ("image_size", "circular", "on_error")},
            **{key: getattr(self, key) for key in ("depth", "seed", "resume", "workers")},
        )
        say(expanded.summary())
        return expanded


@dataclass(frozen=True, kw_only=True)
class Preview(DataJob):
    """Draw every effect at several strengths on one sheet.

    Without images or data it shows rooms of the simulated building.

        out=augmentation.png      output file; .jpg and .webp work, too
        images=[a.jpeg,folder]    panoramas to show the effects on
        data=... unwrap=...       or frames spread over a data set
        count=6                   number of panoramas used in turn

    Example:
        $ siamloc augment preview out=augmentation.png
    """

    MORE: ClassVar[Mapping[str, Any]] = {"data": {"manifest": None}}

    out: Picture = "augmentation.png"
    images: tuple[Text, ...] | Text | None = ()
    count: Thousand = 6

    def run(self, say: Say = quiet) -> Path:
        """Draw the contact sheet, and return its path."""
        import torch

        import augment
        from siamloc import simulate
        from siamloc.runtime.stream import named

        paths = []
        if self.images:
            listed = named(self.images, self.preprocessing.second)
            paths = [str(path) for name, files in listed for path in files or [Path(name)]]
        elif self.data.where:
            paths = self.data.read().path.tolist()
        if paths:
            panoramas = self.preprocessing.panoramas(paths, self.count, self.data.on_error)
        else:
            panoramas = simulate.panoramas(self.count)
        count, circular = len(panoramas), self.data.circular
        write_picture(self.out, augment.preview(torch.from_numpy(panoramas), circular=circular))
        say(f"{self.out}: {len(augment.EFFECTS) - (not circular)} effects on {count} image{'s' * (count > 1)}")
        return Path(self.out)
