"""Policies by name, or from a YAML file.

The policies that ship with the package are the YAML files in this folder. A file contains a tree of effects, as in
`Policy`, in which a step may also be another policy of the package:

    circular: true            # optional, like `name` and `rotate`
    all_of:
      - policy: lighting      # all of it
        probability: 0.8
      - effect: noise         # with any parameters of the effect
        variance: [0.0005, 0.005]
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from augment.compose import Policy
from augment.errors import AugmentError, hint
from augment.registry import POLICIES
from foundation.errors import known, not_yaml
from foundation.settings import checked

Tree = dict[str, Any]

_FOLDER = Path(__file__).parent
_ROOTS = ("all_of", "one_of", "effect", "policy")


def policy(
    name: str | Path | Mapping[str, Any], *, circular: bool | None = None, rotate: float | None = None
) -> Policy:
    """Return a policy by its name, or from a YAML file.

    Args:
        name: "none" (every image stays as it is), "thesis" (the combinations of [T] 5.3.2), "lighting" (everything that
            light and exposure do indoors, without changes of geometry), "strong" (lighting, optics, motion, noise and
            occlusion together), "any_light" (lighting, and another time of day: lamps, windows, rooms behind doors),
            a file that ends in .yaml or .yml, or plain values as `policy_from_config` takes them.
        circular: False for cameras whose columns do not wrap around; nothing is rotated then. If None, the setting of
            the file, or else True.
        rotate: probability of the rotation among the outermost steps; a rotation is added at the end if there is none.
            If None, that of the policy: one half in "thesis", none in "lighting" and "any_light", 1 in "strong".

    Raises:
        AugmentError: an unknown name, a file that is missing or invalid, or a probability outside [0, 1].

    Example:
        >>> import augment
        >>> augment.policy("thesis")
        Policy('thesis', 25 slots)
        >>> augment.policy("thesys")
        Traceback (most recent call last):
        augment.errors.AugmentError: unknown policy 'thesys': did you mean 'thesis'? valid: none, thesis, lighting, \
strong, any_light, or a .yaml file
    """
    changes = {key: value for key, value in (("circular", circular), ("rotate", rotate)) if value is not None}
    if isinstance(name, Mapping):
        return policy_from_config({**name, **changes})
    if name in POLICIES:
        return policy_from_config({"name": name, **_read(_FOLDER / f"{name}.yaml"), **changes})
    path = Path(str(name))
    if path.suffix.lower() not in (".yaml", ".yml"):
        raise AugmentError(f"unknown policy {name!r}: {hint(name, POLICIES)}, or a .yaml file")
    described = _read(path)
    if not set(_ROOTS) & set(described) and described.get("name") not in POLICIES:
        raise AugmentError(f"{path} describes no policy: it needs one of {', '.join(_ROOTS)}")
    try:
        return policy_from_config({"name": path.stem, **described, **changes})
    except AugmentError as error:
        raise AugmentError(f"{path}: {error}") from error


def policy_from_config(config: Mapping[str, Any]) -> Policy:
    """Return the policy that plain values describe, as they appear in a configuration file.

    Args:
        config: a tree (`all_of`, `one_of`, `effect`, see `Policy`; or `policy`, a name) with an optional `name`; or
            `name` alone, as `policy` takes it. `circular` and `rotate` as in `policy`.

    Raises:
        AugmentError: an unknown key, name or parameter, or an invalid value.

    Example:
        >>> import augment
        >>> augment.policy_from_config({"name": "thesis", "rotate": 0.9})
        Policy('thesis', 25 slots)
        >>> augment.policy_from_config({"name": "dim", "all_of": [{"policy": "lighting"}, {"effect": "noise"}]})
        Policy('dim', 20 slots)
    """
    if not isinstance(config, Mapping):
        raise AugmentError(f"a policy is a mapping with a name, all_of, one_of or effect, got {config!r}")
    options = dict(config)
    circular, rotate = options.pop("circular", None), options.pop("rotate", None)
    checked(circular, bool | None, "circular of a policy", AugmentError)
    name = options.pop("name", None)
    if set(_ROOTS) & set(options):
        tree = _turned(_resolved(options), rotate)
        return Policy(tree, name=str(name or "own"), circular=circular is not False)
    if name is None:
        raise AugmentError("a policy needs a name, or its own tree under all_of, one_of or effect")
    for key in options:
        raise AugmentError(f"policy {name} has no parameter {key!r}: {hint(key, ('name', 'rotate', 'circular'))}")
    return policy(name, circular=circular, rotate=rotate)


def _read(path: Path) -> Tree:
    """Return the contents of a policy's file."""
    try:
        described = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise AugmentError(f"{path} cannot be read: {error.strerror}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise AugmentError(not_yaml(path, error)) from error
    if not isinstance(described, dict):
        raise AugmentError(f"{path} must contain a mapping with one of {', '.join(_ROOTS)}, got {described!r}")
    return described


def _resolved(step: Any) -> Any:
    """Return a tree with every step that names a policy of the package replaced by that policy's tree."""
    if not isinstance(step, Mapping):
        return step
    if "policy" in step:
        name, rest = step["policy"], {key: value for key, value in step.items() if key != "policy"}
        file = f"{known(name, POLICIES, 'policy of a step', AugmentError)}.yaml"
        return {"all_of": [_resolved(_read(_FOLDER / file))], **rest}
    groups = {key: [_resolved(child) for child in step[key]] for key in ("all_of", "one_of") if _is_list(step.get(key))}
    return {**step, **groups}


def _turned(tree: Tree, rotate: float | None) -> Tree:
    """Return a tree whose rotation has another probability; None leaves the tree as it is."""
    if rotate is None:
        return tree
    steps = tree["all_of"] if [*tree] == ["all_of"] and _is_list(tree["all_of"]) else [tree]
    there = [isinstance(step, Mapping) and step.get("effect") == "rotate" for step in steps]
    turn = {"probability": rotate}
    changed = [{**step, **turn} if found else step for step, found in zip(steps, there, strict=True)]
    return {"all_of": changed if any(there) or not rotate else [*changed, {"effect": "rotate", **turn}]}


def _is_list(value: Any) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str)
