"""Each effect against its formula, computed pixel by pixel."""

import numpy as np
import pytest
import torch

import augment
from tests.augment.pictures import frame_params, generator, panoramas
from tests.oracles import augment as oracle


def boxed(size, **options):
    mask = np.full((size, size), 1 / size**2)
    return lambda picture, p: mixed(picture, oracle.convolve(picture, mask, **options), p)


def mixed(picture, other, p):
    return picture + p["strength"] * (other - picture)


def sharpened(picture, p, **options):
    s = p["strength"]
    return oracle.convolve(picture, [[0, -s, 0], [-s, 1 + 4 * s, -s], [0, -s, 0]], **options)


def motion(picture, p):
    length = 2 * round((p["length"] * picture.shape[2] / 512 - 1) / 2) + 1
    return oracle.convolve(picture, np.full((1, length), 1 / length))


TABLE = torch.randn(2**21, generator=torch.Generator().manual_seed(20230705)).numpy()
CASES = [
    ("bulb", {"radius": (20, 60)}, lambda i, p: oracle.spot(i, p, oracle.round_distance)),
    ("bulb", {"radius": 400, "intensity": 3}, lambda i, p: oracle.spot(i, p, oracle.round_distance)),
    ("square", {"radius": (20, 60)}, lambda i, p: oracle.spot(i, p, oracle.square_distance)),
    ("trapezoid", {"radius": (20, 60)}, lambda i, p: oracle.spot(i, p, oracle.trapezoid_distance)),
    ("brighten", {}, oracle.brighten),
    ("darken", {}, oracle.darken),
    ("contrast", {}, oracle.contrast),
    ("gamma", {}, oracle.gamma),
    ("exposure", {}, oracle.exposure),
    ("white_balance", {}, oracle.white_balance),
    ("saturate", {}, oracle.saturate),
    ("equalize", {}, oracle.equalize),
    ("equalize", {"strength": (0.2, 0.8)}, oracle.equalize),
    ("sharpen", {}, sharpened),
    ("sharpen", {"strength": (0.2, 1.5)}, sharpened),
    ("sharpen", {"circular": False}, lambda i, p: sharpened(i, p, circular=False)),
    ("blur", {}, boxed(5)),
    ("blur", {"circular": False}, boxed(5, circular=False)),
    ("blur", {"strength": (0.1, 0.9), "size": 3}, boxed(3)),
    ("motion_blur", {"length": (20, 70)}, motion),
    ("rotate", {}, oracle.rotate),
    ("occlude", {"level": (0, 200)}, oracle.occlude),
    ("noise", {}, lambda i, p: oracle.noise(i, p, TABLE)),
    ("vignette", {}, oracle.vignette),
    ("vignette", {"circular": False, "centre": 0.5}, lambda i, p: oracle.vignette(i, p, circular=False)),
    ("shadow", {}, oracle.shadow),
    ("relight", {}, oracle.relight),
    ("doorway", {}, oracle.doorway),
    ("windows", {}, oracle.windows),
    ("windows", {"level": 255, "strength": (0.2, 0.9), "share": (0.05, 0.9)}, oracle.windows),
    ("view", {}, oracle.view),
    ("view", {"circular": False}, lambda i, p: oracle.view(i, p, circular=False)),
    ("sun_patch", {}, oracle.sun_patch),
    ("sun_patch", {"length": 5, "breadth": 4, "distance": 1.8}, oracle.sun_patch),
]


@pytest.mark.parametrize(("name", "ranges", "formula"), CASES, ids=[f"{c[0]}-{i}" for i, c in enumerate(CASES)])
def test_formula(name, ranges, formula):
    effect = augment.effect(name, **ranges)
    batch = panoramas(6, 20, 48)
    if name == "sun_patch":
        batch = panoramas(6, 24, 64)
    params = effect.draw(generator(11), batch)
    bits = effect.apply(batch, params)
    exact = effect.apply(batch.float() / 255, params)
    changed = 0
    for frame in range(len(batch)):
        p = frame_params(params, frame)
        wanted = formula(batch[frame].numpy().astype(np.float64), p)
        np.testing.assert_allclose(exact[frame].numpy() * 255, wanted, atol=2e-2)
        assert np.abs(bits[frame].numpy() - wanted).max() <= 0.51
        changed += not np.array_equal(bits[frame].numpy(), batch[frame].numpy())
    assert changed >= 3


def test_equalize_is_torchvisions():
    from augment.torchvision_compat import ensure_torchvision

    ensure_torchvision()
    from torchvision.transforms.v2.functional import equalize

    batch = panoramas(4, 32, 128)
    batch[3] = 77  # one level only: nothing to spread
    assert torch.equal(augment.effect("equalize")(batch, generator()), equalize(batch))


def test_a_wide_box_wraps_more_than_once():
    effect, batch = augment.effect("blur", size=35), panoramas(1, 40, 12)
    wanted = boxed(35)(batch[0].numpy().astype(float), {"strength": 1})
    np.testing.assert_allclose(effect(batch / 255, generator())[0].numpy() * 255, wanted, atol=2e-2)
    assert np.abs(effect(batch, generator())[0].numpy() - wanted).max() <= 0.51
