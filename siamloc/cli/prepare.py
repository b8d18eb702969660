"""`siamloc prepare`: check a data set and decode its images once."""

from __future__ import annotations

import numpy as np
from omegaconf import DictConfig

from siamloc.cli.steps import open_library, read_frames
from siamloc.data.frames import FrameTable


def main(config: DictConfig) -> None:
    """Read, report, decode."""
    frames = read_frames(config)
    print(report(frames, config.data.unit))
    library = open_library(config, frames)
    rows, columns = library.image_shape[1:]
    print(f"decoded: {len(library)} panoramas of {rows} x {columns} px in {config.data.cache}")
    if library.rejected:
        first = library.rejected[0]
        print(f"left out: {len(library.rejected)} images, the first {first['path']}: {first['reason']}")


def report(frames: FrameTable, unit: str) -> str:
    """Return what a table holds, as text: a line per sequence, and what is missing."""
    lines = [f"{len(frames)} frames"]
    for name, rows in frames.rows_by("sequence").items():
        part = frames.take(rows)
        lightings = ", ".join(sorted(set(part.lighting.tolist()) - {""})) or "lighting unknown"
        rooms = sorted(set(part.room.tolist()) - {""})
        named = f"{len(rooms)} rooms ({', '.join(rooms)})" if rooms else "no rooms"
        label = name or "(no sequence)"
        lines.append(f"  {label}: {len(part)} frames, {lightings}, {named}, {_spacing(part, unit)}")
    without = int((~frames.has_position).sum())
    if without:
        lines.append(f"  {without} frames have no position: they can be located, but not scored or mapped")
    return "\n".join(lines)


def _spacing(frames: FrameTable, unit: str) -> str:
    known = frames.xy[frames.has_position]
    if len(known) < 2:
        return "no positions" if not len(known) else "one position"
    steps = np.linalg.norm(np.diff(known, axis=0), axis=1)
    return f"path of {steps.sum():.1f} {unit}, median step {np.median(steps):.3g} {unit}"
