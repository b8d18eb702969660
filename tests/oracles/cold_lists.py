"""Read a list of rooms by hand: the oracle of `siamloc.data.cold`."""

from __future__ import annotations

from pathlib import Path


def read_list(path: Path) -> list[tuple[str, str, float, float, float, float]]:
    """Return (image, room, time, x, y, theta) of each line, cut out of the text character by character."""
    frames = []
    for line in path.read_text().splitlines():
        image, _, room = line.strip().partition(" ")
        stem = image[: image.rindex(".")]
        words = stem.split("_")
        assert [word[0] for word in words] == ["t", "x", "y", "a"]
        time, x, y, theta = (float(word[1:]) for word in words)
        frames.append((image, room, time, x, y, theta))
    return frames
