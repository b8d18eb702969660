"""Make `import torchvision` work with a torch build that its compiled operators were not made for.

torchvision registers the schema of its operators `nms` and `qnms` from its compiled library. Where that library
does not load (a CPU build of torch with the default torchvision wheel, or any other pair of builds that do not match),
`import torchvision` stops with "operator torchvision::nms does not exist", and so do torchmetrics and lightning,
which import it. Everything this project uses of torchvision (models, weight enums, transforms v2) is pure
Python, so it is enough to declare the two schemas and import again.

Call `ensure_torchvision` before the first import of torchvision or lightning in a module.
"""

from __future__ import annotations

import importlib
import sys
from typing import Any

_MISSING = "operator torchvision::nms does not exist"
_SCHEMAS = (
    "nms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor",
    "qnms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor",
)
_library: Any = None  # torch drops the declarations when this object is collected


def ensure_torchvision() -> None:
    """Import torchvision; declare the two missing operator schemas first, if and only if they are missing.

    Raises whatever `import torchvision` raises, unless it is the missing operator.

    Example:
        >>> ensure_torchvision()
        >>> from torchvision.transforms import v2
    """
    global _library
    if "torchvision" in sys.modules:
        return
    try:
        importlib.import_module("torchvision")
    except RuntimeError as error:
        if _MISSING not in str(error):
            raise
    else:
        return
    for name in [name for name in sys.modules if name.partition(".")[0] == "torchvision"]:
        del sys.modules[name]
    from torch.library import Library

    _library = Library("torchvision", "DEF")
    for schema in _SCHEMAS:
        _library.define(schema)
    importlib.import_module("torchvision")
