"""Effects that users write: one formula, or less, is enough for every device and dtype."""

import re
from pathlib import Path
from typing import ClassVar

import pytest
import torch

import augment
from augment.base import Effect
from augment.layers import Layer
from augment.photometric import PointEffect, Tone
from augment.ranges import Range
from augment.spots import Square
from tests.augment.pictures import generator, panoramas

STRENGTH = {"strength": Range(0.2, 0.8, minimum=0, maximum=1, neutral=0)}


class Grey(Effect):
    """I' = I + strength (mean of the channels - I)."""

    name = "grey"
    RANGES: ClassVar = STRENGTH

    def render(self, batch, values):
        return torch.lerp(batch, batch.mean(dim=1, keepdim=True).expand_as(batch), values["strength"])


class Solarize(PointEffect):
    name = "solarize"
    RANGES: ClassVar = STRENGTH

    def curve(self, level, values):
        return torch.where(level > 0.5, level + values["strength"] * (1 - 2 * level), level)


class Dusk(Layer):
    """Darker from row to row."""

    name = "dusk"
    RANGES: ClassVar = STRENGTH

    def layer(self, rows, columns, values, height, width):
        return torch.exp(-values["strength"] * rows / height)


class Diamond(Square):
    name = "diamond"

    def distance(self, across, down, values):
        return across.abs() + down.abs()


class Negative(Tone):
    name = "negative"
    RANGES: ClassVar = STRENGTH

    def curve(self, level, values):
        return torch.lerp(level, 1 - level, values["strength"])


class Still(Effect):
    name = "still"

    def render(self, batch, values):
        return batch.clone()


@pytest.mark.parametrize("kind", [Grey, Solarize, Dusk, Diamond, Negative])
def test_8_bit_and_float_follow_the_formula(kind):
    effect, batch = kind(), panoramas(5, 32, 128)
    params = effect.draw(generator(), batch)
    bits, exact = effect.apply(batch, params).float(), effect.apply(batch / 255, params) * 255
    assert float((bits - exact).abs().max()) <= 0.5 + 1e-3
    assert (bits - batch).abs().amax(dim=(1, 2, 3)).min() > 5
    assert torch.equal(effect.apply(batch, effect.at(0, batch)), batch)


def test_the_effect_of_the_guide_works():
    guide = (Path(__file__).parents[2] / "docs/guide/augmentation.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(import torch\nfrom augment.base.*?)\n\n\nsiamloc", guide, flags=re.DOTALL)
    names = {}
    exec(code, names)
    effect, batch = names["Fade"](strength=(0.2, 0.5)), panoramas(3)
    spread = batch.float().std(dim=1).mean()
    assert effect(batch, generator()).float().std(dim=1).mean() < 0.9 * spread


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float32])
def test_an_effect_that_gives_another_shape_is_refused(dtype):
    class OneChannel(Grey):
        def render(self, batch, values):
            return batch.mean(dim=1, keepdim=True)

    batch = torch.zeros((2, 3, 8, 16), dtype=dtype)
    with pytest.raises(
        augment.AugmentError, match=r"`render` of grey must return a tensor .*3, 8, 16\), got .*1, 8, 16"
    ):
        OneChannel()(batch, generator())


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float32])
def test_an_effect_that_gives_nan_is_refused_and_infinity_is_white(dtype):
    class Divided(Grey):
        def render(self, batch, values):
            return batch / 0

    batch = torch.ones((2, 3, 8, 16), dtype=dtype)
    torch.testing.assert_close(Divided()(batch, generator()), batch * (255 if dtype == torch.uint8 else 1))
    with pytest.raises(augment.AugmentError, match="`render` of grey must return numbers, got NaN"):
        Divided()(batch * 0, generator())


def test_an_effect_without_a_name_is_refused():
    class Nameless(Effect):
        render = Still.render

    with pytest.raises(augment.AugmentError, match="the effect Nameless has no name: set `name` in the class"):
        Nameless()


def test_an_effect_without_parameters_is_refused():
    with pytest.raises(augment.AugmentError, match="still draws nothing: give it at least one range"):
        Still()(panoramas(1), generator())
