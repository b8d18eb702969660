"""`write_projector`: write a map for TensorBoard's projector, which shows descriptors as points."""

from __future__ import annotations

from pathlib import Path

from foundation.calls import typed
from foundation.files import write_text
from siamloc.maps.visual_map import VisualMap

_COLUMNS = ("room", "lighting", "sequence", "x", "y", "path")
_CONFIG = """embeddings {
  tensor_name: "map"
  tensor_path: "map.tsv"
  metadata_path: "map_frames.tsv"
}
"""


@typed
def write_projector(known: VisualMap, folder: str | Path) -> list[Path]:
    """Write the descriptors of a map with the room, lighting, sequence, position and path of each frame.

    `tensorboard --logdir FOLDER` shows them under Projector, where "Color by" offers the room. If the folder also holds
    the curves of a training, both are shown. No other package is needed to write or read the files.

    Args:
        known: the map (n, D).
        folder: folder to write to; created if missing.

    Returns:
        The files: descriptors, frames, and `projector_config.pbtxt`, which leads TensorBoard to the others.

    Raises:
        StorageError: the disk is full or cannot be written to.

    Example:
        >>> import siamloc, tempfile
        >>> images = siamloc.data.example()
        >>> known = siamloc.maps.build("thumbnail", images, images.frames)
        >>> [path.name for path in write_projector(known, tempfile.mkdtemp())]
        ['map.tsv', 'map_frames.tsv', 'projector_config.pbtxt']
    """
    folder = Path(folder)
    vectors = ("\t".join(f"{value:.7g}" for value in row) for row in known.descriptors[:].tolist())
    columns = [getattr(known.frames, name).tolist() for name in _COLUMNS]
    rows = ("\t".join(map(_cell, row)) for row in zip(*columns, strict=True))
    texts = {
        "map.tsv": "\n".join(vectors) + "\n",
        "map_frames.tsv": "\n".join(["\t".join(_COLUMNS), *rows]) + "\n",
        "projector_config.pbtxt": _CONFIG,  # written last, since it names the others
    }
    for name, text in texts.items():
        write_text(folder / name, text)
    return [folder / name for name in texts]


def _cell(value: object) -> str:
    """Return a value as text without tabs and line ends, which would start another cell."""
    text = f"{value:g}" if isinstance(value, float) else " ".join(str(value).split())
    return text or "(unknown)"
