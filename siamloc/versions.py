"""The versions that matter for a report: of Python, of siamloc, and of the packages that are installed."""

from __future__ import annotations

import platform
from collections.abc import Iterable
from contextlib import suppress
from importlib import metadata

from siamloc import __version__

PACKAGES = {
    "numpy": ("numpy",),
    "opencv": ("opencv-python-headless", "opencv-python", "opencv-contrib-python-headless", "opencv-contrib-python"),
    "onnxruntime": ("onnxruntime", "onnxruntime-gpu", "onnxruntime-openvino"),
    **{name: (name,) for name in ("torch", "torchvision", "lightning")},
    "hydra": ("hydra-core",),
    **{name: (name,) for name in ("onnx", "scipy", "scikit-learn", "embreex", "rosbags", "aiohttp")},
}
"""The distributions of each package, of which one is enough."""


def installed(package: str) -> dict[str, str]:
    """Return the installed distributions of a package, with their versions.

    Args:
        package: a name in `PACKAGES`.

    Example:
        >>> list(installed("numpy"))
        ['numpy']
    """
    found = {}
    for distribution in PACKAGES[package]:
        with suppress(metadata.PackageNotFoundError):
            found[distribution] = metadata.version(distribution)
    return found


def versions(packages: Iterable[str] = PACKAGES) -> dict[str, str]:
    """Return the versions of Python, siamloc and the packages that are installed.

    Args:
        packages: names in `PACKAGES`.

    Example:
        >>> list(versions(["numpy"]))
        ['python', 'siamloc', 'numpy']
    """
    found = {"python": platform.python_version(), "siamloc": __version__}
    return found | {name: version for name in packages for version in list(installed(name).values())[:1]}
