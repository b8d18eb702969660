"""What a test sees of a figure or of a file."""

from __future__ import annotations

from pathlib import Path

import cv2
import matplotlib
import numpy as np


def text_of(figure) -> str:
    """Return all the words in a figure."""
    return "\n".join(text.get_text() for text in figure.findobj(matplotlib.text.Text))


def lines_of(figure, panel: int = 0) -> dict[str, list]:
    """Return the points of each line of a panel, by label."""
    return {line.get_label(): line.get_xydata().tolist() for line in figure.axes[panel].lines}


def whole_png(path: Path) -> bool:
    """Whether a file is a PNG that ends well and shows something."""
    contents = path.read_bytes()
    picture = cv2.imdecode(np.frombuffer(contents, np.uint8), cv2.IMREAD_COLOR)
    ends_well = contents.startswith(b"\x89PNG") and contents.endswith(b"IEND\xaeB`\x82")
    return ends_well and picture is not None and min(picture.shape[:2]) > 300 and picture.std() > 10
