"""The extras that install what an import misses, and how to say so."""

from __future__ import annotations

from importlib.util import find_spec

_OURS = ("siamloc", "analytic", "augment", "foundation")
EXTRAS = {
    "onnxruntime": "robot",
    "aiohttp": "live",
    **dict.fromkeys(("torch", "torchvision", "lightning", "hydra", "scipy", "sklearn", "matplotlib", "onnx"), "train"),
    "embreex": "simulate",
    "hydra_plugins": "sweeps",
    "rosbags": "recordings",
    "timm": "timm",
    "huggingface_hub": "timm",
    "wandb": "wandb",
    "mlflow": "mlflow",
}
"""The extra that installs a module; modules that are not listed come with the extra `train`."""


def need(module: str) -> None:
    """Make sure, before long work, that a module is installed.

    Raises:
        ModuleNotFoundError: it is not; the message names the extra that installs it.
    """
    if find_spec(module) is None:
        raise ModuleNotFoundError(lacking(ModuleNotFoundError(name=module)), name=module)


def lacking(error: ModuleNotFoundError, wider: str = "train") -> str | None:
    """Return a sentence that names the extra with the package that an import misses; None for our own modules.

    Args:
        error: what the import raises.
        wider: the extra to name instead of `train`, if the command also needs the rest of that extra.
    """
    package = (error.name or "").partition(".")[0]
    if package in _OURS:
        return None
    extra = EXTRAS.get(package, "train")
    return f"this needs {package}, which is not installed here: {installing(wider if extra == 'train' else extra)}"


def installing(extra: str) -> str:
    """Return how to install an extra: from the folder of the source, since no index holds the package.

    >>> installing("live")
    "run pip install '.[live]' in the folder of siamloc's source"
    """
    return f"run pip install '.[{extra}]' in the folder of siamloc's source"
