"""`DataJob`: the base of the jobs that read data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from siamloc.data.decoding import Preprocessing
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.data.protocol import Protocol
from siamloc.data.reading import DataSettings
from siamloc.jobs.job import Job

if TYPE_CHECKING:
    from siamloc.maps import VisualMap


@dataclass(frozen=True, kw_only=True)
class DataJob(Job):
    """Base of the jobs that read data.

    Attributes:
        data: which frames to read.
        unwrap: how omnidirectional images become panoramas: `kind` and the parameters of the camera.
        protocol: which frames have which role.
    """

    GROUPS: ClassVar = {"unwrap": "none", "protocol": "by_sequence", "data": "manifest"}

    data: DataSettings
    unwrap: Mapping[str, Any]
    protocol: Protocol

    def __post_init__(self) -> None:
        super().__post_init__()
        Preprocessing.checked(self.data.image_size, self.unwrap)

    @property
    def preprocessing(self) -> Preprocessing:
        """How images become panoramas."""
        return Preprocessing.checked(self.data.image_size, self.unwrap)

    def open_roles(self, *names: str, known: VisualMap | None = None) -> tuple[PanoramaLibrary, dict[str, FrameTable]]:
        """Return the panoramas that these roles of the protocol need, and the readable frames of each role.

        Args:
            names: roles to fill.
            known: a saved map whose sequences are opened as well.

        Raises:
            ConfigError: a role without frames, or data without the map's frames or with different ones.
        """
        table = self.data.read()
        roles = self.protocol.roles(table, *names)
        if known is not None:
            known.check_frames(table)
        tables = [*roles.values(), *([] if known is None else [known.frames])]
        sequences = sorted({name for frames in tables for name in frames.sequence.tolist()})
        images = self.data.library(table.take(np.isin(table.sequence, sequences)), self.unwrap)
        return images, {name: images.readable(frames) for name, frames in roles.items()}
