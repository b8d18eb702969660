"""`doctor`: what is installed here, what it lets one do, and whether it computes what it should."""

from __future__ import annotations

import platform
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np
from numpy.typing import NDArray

from analytic import Descriptor, descriptor
from foundation.extras import EXTRAS, installing
from foundation.threads import processors
from siamloc.versions import PACKAGES, installed, versions

COMMANDS = {
    "robot": ("localize",),
    "live": ("live",),
    "train": (
        *("augment expand", "augment preview", "compare", "evaluate", "export", "fetch", "map", "prepare"),
        *("report", "reproduce", "survey", "train", "walk"),
    ),
    "simulate": ("demo", "pretrain", "simulate"),
    "sweeps": ("-m hydra/launcher=joblib",),
    "recordings": ("prepare FILE.bag",),
    "timm": ("train model.branch=timm/NAME",),
    "wandb": ("train trainer.logger=wandb",),
    "mlflow": ("train trainer.logger=mlflow",),
}
"""What each extra is for."""
_BASES = dict.fromkeys(("simulate", "sweeps", "recordings", "timm", "wandb", "mlflow"), "train")
# Some entries of the descriptors of the known picture, computed once, and how far entries computed here may be off.
_NETWORK = {0: 0.014456, 712: 0.033819, 1176: 0.121093, 1884: -0.119783, 2246: 0.118354, 2645: 0.136942}
_HOG = {0: 0.757930, 1: 0.341794, 3: 1.303485, 5: 10.832738}
_TOLERANCE = 1e-3  # processors and versions of torch differ by 1e-5 at most


@dataclass(frozen=True)
class Checkup:
    """What `doctor` finds.

    Attributes:
        versions: versions of Python, siamloc and the packages that are installed.
        devices: where networks can train and describe images, such as "cpu (2 processors)".
        providers: onnxruntime's execution providers, and whether each one computes here; empty without onnxruntime.
        missing: the modules that each extra lacks here, by the name of the extra.
        described: what described the known picture: "the shipped network" or, without torch, "hog".
        problems: a sentence about each thing that is wrong; a package that is not installed is no problem.
    """

    versions: Mapping[str, str]
    devices: tuple[str, ...]
    providers: Mapping[str, bool]
    missing: Mapping[str, tuple[str, ...]]
    described: str
    problems: tuple[str, ...]

    def text(self) -> str:
        """Return the findings as lines for a terminal, or for a report of a bug."""
        return "\n".join(self._lines())

    def _lines(self) -> Iterator[str]:
        yield from (f"{name:<13} {version}" for name, version in self.versions.items())
        yield f"platform      {platform.platform()}"
        yield f"devices       {', '.join(self.devices)}"
        works = [f"{name} {'works' if works else 'does not work'}" for name, works in self.providers.items()]
        yield f"providers     {', '.join(works) or 'none, without onnxruntime'}"
        yield "\nextras and their commands"
        for extra, lacks in self.missing.items():
            state = f"lacks {', '.join(lacks)}: {installing(extra)}" if lacks else "installed"
            yield f"{extra:<13} {', '.join(COMMANDS[extra])}\n{'':<13} {state}"
        yield f"\nself-test     {self.described} described a picture"
        yield from (f"problem       {problem}" for problem in self.problems or ["none"])


def doctor() -> Checkup:
    """Look at what is installed here, and let it describe a picture whose description is known.

    Takes about two seconds with torch. Nothing is written or downloaded.

    Example:
        >>> found = doctor()
        >>> found.problems
        ()
        >>> found.providers["CPUExecutionProvider"]
        True
    """
    missing = {extra: tuple(_lacking(extra)) for extra in COMMANDS}
    several = {name: found for name in PACKAGES if len(found := installed(name)) > 1}
    problems = [
        f"{' and '.join(found)} share the files of one module, and the last one installed wins: uninstall all of them, "
        "then install one"
        for found in several.values()
    ]
    providers = _providers(problems)
    described = "the shipped network" if not missing["train"] else "hog"
    try:
        by: Descriptor = descriptor("hog")
        expected = _HOG
        if not missing["train"]:
            from siamloc.models import as_descriptor, pretrained

            by, expected = as_descriptor(pretrained()), _NETWORK
        got = by.describe(_picture()).position[0]
        apart = max(abs(float(got[index]) - value) for index, value in expected.items())
        if not apart <= _TOLERANCE:
            problems.append(
                f"{described} describes a picture otherwise than it should, by {apart:.2g}: install the tested set of "
                "versions, constraints.txt"
            )
    except Exception as error:  # whatever a broken installation raises
        problems.append(f"{described} cannot describe a picture ({type(error).__name__}: {error})")
    return Checkup(versions(), tuple(_devices(missing["train"])), providers, missing, described, tuple(problems))


def _lacking(extra: str) -> list[str]:
    """Return the modules that are not installed, of an extra and of the extra that it includes."""
    return [module for module, of in EXTRAS.items() if of in (extra, _BASES.get(extra)) and find_spec(module) is None]


def _providers(problems: list[str]) -> dict[str, bool]:
    if find_spec("onnxruntime") is None:
        return {}
    from siamloc.runtime.describing import working_providers

    try:
        found = working_providers()
    except Exception as error:  # such as a library that cannot be loaded
        problems.append(f"onnxruntime cannot be used ({type(error).__name__}: {error})")
        return {}
    problems += [
        f"onnxruntime has {name}, which does not work here: its device or libraries are missing"
        for name, works in found.items()
        if not works
    ]
    return found


def _devices(lacks: tuple[str, ...]) -> Iterator[str]:
    yield f"cpu ({processors()} processors)"
    if "torch" not in lacks:
        import torch

        if torch.cuda.is_available():
            yield from (f"cuda:{i} ({torch.cuda.get_device_name(i)})" for i in range(torch.cuda.device_count()))


def _picture() -> NDArray[np.uint8]:
    """Draw a panorama (1, 3, 64, 256) of smooth waves."""
    azimuth, elevation = np.arange(256) * (2 * np.pi / 256), np.arange(64)[:, None] * (np.pi / 64)
    one, two = np.sin(3 * azimuth) * np.cos(elevation), np.cos(5 * azimuth + 2 * elevation)
    three = np.sin(azimuth + 4 * elevation)
    return np.rint(127 + 60 * np.stack([one + two, two + three, three + one])).astype(np.uint8)[None]
