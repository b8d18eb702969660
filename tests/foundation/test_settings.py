import inspect
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from foundation.calls import takes
from foundation.errors import ConfigError
from foundation.settings import Count, Natural, NotNegative, Positive, Probability, Settings, Share, Size, defaults_of


@dataclass(frozen=True)
class Inner(Settings):
    WHERE = "train.inner"

    rate: Positive = 0.5
    name: Literal["sgd", "adam"] = "sgd"


@dataclass(frozen=True)
class Training(Settings):
    WHERE = "train"

    epochs: Count = 30
    seed: Natural = 0
    decay: NotNegative = 0.0
    share: Share | None = None
    chance: Probability = 0.5
    size: Size = (128, 512)
    radii: tuple[Positive, ...] = (0.5, 1.0)
    where: Path | None = None
    flag: bool = False
    names: tuple[str, ...] | None = None
    inner: Inner = field(default_factory=Inner)


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"epochs": 1.5}, "train.epochs must be a whole number from 1 to 10 million, got 1.5"),
        ({"epochs": True}, "train.epochs must be a whole number from 1 to 10 million, got True"),
        ({"epochs": 10**12}, "train.epochs must be a whole number from 1 to 10 million, got 1000000000000"),
        ({"decay": 1e30}, r"train.decay must be a number from 0, at most 10,000,000,000 in size, got 1e\+30"),
        ({"radii": [1, -1e30]}, r"train.radii must be a list, each item a number above 0, got \[1, -1e\+30\]"),
        ({"seed": "abc"}, "train.seed must be a whole number from 0 to 10 million, got 'abc'"),
        ({"decay": float("nan")}, "train.decay must be a number from 0, got nan"),
        ({"share": 3}, "train.share must be a number from 0 to 1, or null, got 3"),
        ({"chance": 1}, "train.chance must be a number between 0 and 1, got 1"),
        ({"size": [128]}, r"train.size must be \[rows, columns\], each from 1 to 16,384 pixels, got \[128\]"),
        ({"radii": "abc"}, "train.radii must be a list, each item a number above 0, got 'abc'"),
        (
            {"names": ["a", 20240105]},
            r"a text, or null, got \['a', 20240105\]: put .* in quotes, such as '\[\"2024_01_05\"\]'",
        ),
        ({"names": ["a", None]}, r"a text, or null, got \['a', None\]$"),
        ({"where": 3}, "train.where must be a path, or null, got 3"),
        ({"flag": 1}, "train.flag must be true or false, got 1"),
        ({"inner": 3}, "train.inner must be a group with the keys rate, name, got 3"),
        ({"inner": {"name": "lion"}}, "train.inner.name must be sgd or adam, got 'lion'"),
        ({"inner": {"rte": 1}}, "unknown key train.inner.rte: did you mean 'rate'"),
        ({"epoch": 3}, "unknown key train.epoch: did you mean 'epochs'"),
    ],
)
def test_a_mistake_is_one_sentence_that_names_the_key(values, says):
    with pytest.raises(ConfigError, match=says):
        Training.of(values)


def test_values_take_the_form_that_the_annotation_asks_for():
    made = Training.of({"size": [64, 256], "radii": [1], "where": "runs/a", "inner": {"rate": 1}})
    assert made.size == (64, 256)
    assert made.radii == (1,)
    assert made.where == Path("runs/a")
    assert made.inner == Inner(rate=1)
    assert Training.of(made.plain()) == made


def test_numbers_and_arrays_of_numpy_are_values_like_any_other():
    made = Training(epochs=np.int64(3), radii=np.array([0.5, 2]), decay=np.float32(0.5), flag=np.bool_(True))
    assert made == Training(epochs=3, radii=(0.5, 2.0), decay=0.5, flag=True)
    assert json.dumps(made.plain())
    with pytest.raises(ConfigError, match=r"train\.epochs must be a whole number from 1 to 10 million, got array"):
        Training(epochs=np.array([1, 2]))


def test_defaults_are_plain_and_leave_out_what_has_none():
    @dataclass(frozen=True)
    class Reader(Settings):
        root: str
        inner: Inner = field(default_factory=Inner)

    assert defaults_of(Reader) == {"inner": {"rate": 0.5, "name": "sgd"}}
    with pytest.raises(ConfigError, match="root is not set: give it as root=VALUE"):
        Reader.of({})


@takes(Training)
def fit(network, *, run=None, settings):
    return network, run, settings


def test_a_function_takes_the_fields_as_keywords_and_shows_them():
    assert fit("net", settings={"epochs": 5})[2] == Training(epochs=5)
    assert fit("net", run="r", epochs=3)[2] == Training(epochs=3)
    assert fit("net", settings=Training(epochs=4))[2].epochs == 4
    assert list(inspect.signature(fit).parameters)[:4] == ["network", "run", "epochs", "seed"]
    assert inspect.signature(fit).parameters["epochs"].default == 30


@dataclass(frozen=True)
class Base(Settings):
    """Whatever.

    Attributes:
        first: one line
            and another.
    """

    first: Count = 1


@dataclass(frozen=True)
class Both(Base):
    """More.

    Attributes:
        second: another.
    """

    second: Count = 2


def test_settings_are_narrowed_to_those_of_a_base_groups_too():
    @dataclass(frozen=True)
    class Outer(Settings):
        part: Base = field(default_factory=Base)

    @dataclass(frozen=True)
    class Wider(Outer):
        part: Both = field(default_factory=Both)
        more: Count = 7

    found = Wider(part=Both(first=5)).narrowed(Outer)
    assert found == Outer(part=Base(first=5))
    assert found.plain() == {"part": {"first": 5}}


def test_the_docstring_of_a_function_tells_of_its_fields_those_of_a_base_first():
    def call(*, settings):
        pass

    call.__doc__ = "Do something.\n\nArgs:\n    settings: the fields\n        together.\n\nReturns:\n    Nothing.\n"
    told = "Args:\n    first: one line\n        and another.\n    second: another.\n\nReturns:"
    assert told in takes(Both)(call).__doc__


@pytest.mark.parametrize(
    ("keywords", "says"),
    [
        ({"epoch": 3}, "fit has no setting 'epoch': did you mean 'epochs'"),
        ({"epochs": 0}, "train.epochs must be a whole number from 1 to 10 million, got 0"),
        ({"settings": Training(), "epochs": 3}, "fit takes settings=... or epochs, not both"),
        ({"rnu": "r"}, "fit has no setting 'rnu': did you mean 'run'"),
        ({"settings": 3}, "settings must be a group with the keys epochs, seed"),
    ],
)
def test_a_function_refuses_what_it_does_not_know(keywords, says):
    with pytest.raises(ConfigError, match=says):
        fit("net", **keywords)
