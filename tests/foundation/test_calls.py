"""Arguments of public calls are checked against their annotations."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from benchmarks.torture import STRANGE, outcome_of
from benchmarks.torture_calls import call_cases, public_calls
from foundation.calls import typed
from foundation.errors import ConfigError
from foundation.settings import Count, Settings
from siamloc.data import FrameTable

if TYPE_CHECKING:
    from siamloc.nowhere import Elsewhere
    from torch import nn


class Draws(Protocol):
    def draw(self) -> None: ...


@typed
def called(
    frames: FrameTable | None = None,
    k: Count = 1,
    *,
    folder: str | Path | PathLike[str] | None = None,
    elsewhere: Elsewhere | nn.Module | None = None,
    names: Sequence[str] = (),
    way: Literal["a", "b"] = "a",
    array: NDArray[np.float64] | None = None,
    anything: ArrayLike = 0,
    function: Callable[[int], int] | None = None,
    draws: Draws | None = None,
    options: Mapping[str, Any] | None = None,
) -> str:
    return "called"


class Elsewhere2:
    pass


Elsewhere2.__name__ = "Elsewhere"


def test_what_the_annotations_allow_passes():
    one = {"frames": FrameTable(path=["a.png"]), "k": np.int64(3), "folder": "a", "elsewhere": Elsewhere2()}
    more = {"names": ["a", "b"], "array": np.zeros(3), "anything": "whatever", "function": abs}
    assert called(**one, **more, draws=Elsewhere2(), options={"a": 1}) == "called"
    assert called(folder=Path("a"), names=np.array(["a"]), options=None) == "called"


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"frames": "abc"}, "frames must be a FrameTable, or null, got 'abc'"),
        ({"k": 0}, "k must be a whole number from 1 to 10 million, got 0"),
        ({"folder": 3}, "folder must be a text, or a path, or a PathLike, or null, got 3"),
        ({"elsewhere": 3}, "elsewhere must be an Elsewhere, or a Module, or null, got 3"),
        ({"names": "abc"}, "names must be a list, each item a text, got 'abc'"),
        ({"way": "c"}, "way must be a or b, got 'c'"),
        ({"array": [1.0]}, r"array must be an array, or null, got \[1.0\]"),
        ({"function": 3}, r"function must be a \w+, or null, got 3"),
        ({"draws": "abc"}, "draws must be a Draws, or null, got 'abc'"),
        ({"options": 3}, "options must be a mapping of keys to values, or null, got 3"),
    ],
)
def test_what_they_do_not_allow_is_refused(given, says):
    with pytest.raises(ConfigError, match=says):
        called(**given)


@dataclass(frozen=True)
class Group(Settings):
    k: Count = 1


def test_plain_values_become_the_group_of_settings_that_a_call_takes():
    @typed
    def k_of(group: Group | None = None, *, other: Group | None = None) -> list[int]:
        return [one.k for one in (group, other) if one is not None]

    assert k_of({"k": 2}) == k_of(Group(2)) == [2]
    assert k_of(group={"k": 2}, other={"k": 3}) == k_of({"k": 2}, other=Group(3)) == [2, 3]
    assert k_of(other={"k": 3}) == [3]
    with pytest.raises(ConfigError, match="unknown key kk"):
        k_of({"kk": 2})


def test_whole_numbers_of_numpy_become_plain_ones():
    @typed
    def kind_of(k: Count, array: NDArray[np.int64] | None = None) -> list[type]:
        return [type(k), type(array)]

    assert kind_of(np.int64(3), np.array([3])) == [int, np.ndarray]


def test_public_calls_refuse_nonsense():
    """Every 11th case: with 21 strange values and arguments of all kinds, each is covered."""
    wrong = [
        f"{name}: {outcome}"
        for name, case, nonsense in itertools.islice(call_cases(STRANGE), 0, None, 11)
        if (outcome := outcome_of(case, nonsense, 60.0)).kind not in ("refused", "accepted")
    ]
    assert not wrong
    assert len(list(public_calls())) > 80


def test_pixels_are_not_copied_to_a_list_to_see_that_they_are_no_name_of_a_file():
    class Pixels(np.ndarray):
        def tolist(self):
            raise AssertionError("all pixels were copied")

    Pixels.__module__ = "numpy"

    @typed
    def shape(image: str | Path | NDArray[np.uint8]) -> tuple[int, ...]:
        return image.shape

    assert shape(np.zeros((2, 3, 3), np.uint8).view(Pixels)) == (2, 3, 3)
    with pytest.raises(ConfigError, match="image must be"):
        shape(3)
