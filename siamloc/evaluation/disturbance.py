"""`Disturbance`: disturb query images at several levels ([T] 3.4.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from siamloc.errors import ConfigError

Images = NDArray[np.uint8]

_UNITS = {"noise": "variance", "occlusion": "share of the columns", "turn": "degrees", "effect": "strength"}


@dataclass(frozen=True)
class Disturbance:
    """A disturbance of query images, at several levels.

    Attributes:
        name: "noise", "occlusion", "turn", or an effect of `augment`.
        levels: noise variances for images in [0, 1]; shares of the columns; degrees turned left; strengths in [-1, 1].
        kind: "effect" for an effect of `augment`, even one called noise; otherwise the name.
        circular: whether columns wrap around.

    Raises:
        ConfigError: a turn of images whose columns do not wrap around.
        AugmentError: an unknown effect.
    """

    name: str
    levels: tuple[float, ...]
    kind: str
    circular: bool = True

    def __post_init__(self) -> None:
        if self.kind == "turn" and not self.circular:
            raise ConfigError(
                "images whose columns do not wrap around cannot be turned: leave turn out "
                "(task.robustness.turn=[]), or say that they do (circular=true)"
            )
        if self.kind == "effect":
            self._effect()

    @property
    def unit(self) -> str:
        """Unit of the levels."""
        return _UNITS[self.kind]

    def apply(self, images: Images, level: float, rows: NDArray[np.int64], seed: int = 0) -> Images:
        """Return disturbed images; random draws differ between images, but not between levels.

        Args:
            images: (B, 3, H, W) uint8, RGB.
            level: one of the levels.
            rows: indices of the queries (B,), which determine the draws together with the seed.
            seed: seed of all draws.
        """
        from analytic import disturb

        if self.kind == "turn":
            return np.roll(images, round(level / 360 * images.shape[-1]), axis=-1)
        if self.kind == "effect":
            return self._with_effect(images, level, rows, seed)
        made = []
        for image, row in zip(images, rows.tolist(), strict=True):
            rng = np.random.default_rng((seed, row))
            if self.kind == "noise":
                made.append(disturb.noise(image, level, rng))
            else:
                made.append(disturb.occlude(image, level, rng, circular=self.circular))
        return np.stack(made)

    def _with_effect(self, images: Images, strength: float, rows: NDArray[np.int64], seed: int) -> Images:
        """Apply an effect with given strengths; everything else (places, forms) is drawn."""
        import torch

        effect, batch = self._effect(), torch.from_numpy(np.ascontiguousarray(images))
        height, width = batch.shape[2:]
        strong = effect.at(strength, batch)
        draws = []
        for row in rows.tolist():
            state = int(np.random.SeedSequence((seed, row)).generate_state(1)[0])
            draws.append(effect.draw(torch.Generator().manual_seed(state), batch[:1]))
        params = {
            key: strong[key] if span.neutral is not None else torch.cat([draw[key] for draw in draws])
            for key, span in effect.spans(height, width).items()
        }
        changed: Images = effect.apply(batch, effect.complete(params, len(batch), height, width)).numpy()
        return changed

    def _effect(self) -> Any:
        import augment

        return augment.effect(self.name, circular=self.circular)
