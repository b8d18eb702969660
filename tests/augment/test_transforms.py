import copy
import pickle
import subprocess
import sys
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
import torch
from PIL import Image
from torch import nn
from torch.utils.data import DataLoader, Dataset

import augment
from augment import Augment
from augment.ranges import Range
from augment.torchvision_compat import ensure_torchvision
from tests.augment.pictures import generator, panoramas

ensure_torchvision()
from torchvision import tv_tensors  # noqa: E402
from torchvision.transforms import v2  # noqa: E402

ROOT = Path(__file__).parents[2]


def build(name="thesis", seed=0):
    return Augment(augment.effect(name) if name in augment.EFFECTS else augment.policy(name), seed=seed)


@pytest.mark.parametrize("name", [*augment.EFFECTS, *augment.POLICIES])
def test_every_effect_and_policy_is_a_module_and_a_transform(name):
    transform, batch = build(name), panoramas(4)
    assert isinstance(transform, nn.Module)
    assert isinstance(transform, v2.Transform)
    params = transform.make_params([batch])
    assert torch.equal(transform.transform(batch, params), transform.effect.apply(batch, params))
    assert torch.equal(transform.eval()(batch), batch)


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float32, torch.float64, torch.float16])
@pytest.mark.parametrize("shape", [(3, 24, 64), (5, 3, 24, 64), (2, 2, 3, 24, 64), (0, 3, 24, 64)])
def test_shape_and_dtype_stay(shape, dtype):
    picture = (torch.rand(shape, generator=generator()) * (255 if dtype == torch.uint8 else 1)).to(dtype)
    before = picture.clone()
    out = build("darken")(picture)
    assert (type(out), out.shape, out.dtype) == (torch.Tensor, picture.shape, dtype)
    assert torch.equal(picture, before)
    assert out.numel() == 0 or not torch.equal(out, picture)


def test_type_of_the_picture_stays():
    picture = panoramas(1)[0]
    wanted = build("darken")(picture)
    for kind in (tv_tensors.Image, tv_tensors.Video):
        out = build("darken")(kind(picture[None]))
        assert type(out) is kind
        assert torch.equal(out[0], wanted)
    out = build("darken")(Image.fromarray(picture.permute(1, 2, 0).numpy()))
    assert isinstance(out, Image.Image)
    assert np.array_equal(np.asarray(out), wanted.permute(1, 2, 0).numpy())


def test_the_seed_alone_decides():
    batch = panoramas(3)
    torch.manual_seed(1)
    before = torch.get_rng_state()
    first, again, other = build(seed=4), build(seed=4), build(seed=5)
    drawn = [first(batch) for _ in range(4)]
    assert torch.equal(torch.get_rng_state(), before)
    torch.manual_seed(2)
    assert all(torch.equal(again(batch), out) for out in drawn)
    assert not torch.equal(other(batch), drawn[0])
    assert not torch.equal(drawn[0], drawn[1])
    again.calls = 2
    assert torch.equal(again(batch), drawn[2])


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda module: pickle.loads(pickle.dumps(module))])
@pytest.mark.parametrize("name", [*augment.EFFECTS, *augment.POLICIES])
def test_a_copy_draws_what_the_original_would(name, duplicate):
    original, batch = build(name), panoramas(3)
    original(batch)
    other = duplicate(original)
    assert torch.equal(original(batch), other(batch))


def test_in_compose_and_in_sequential():
    batch = panoramas(2)
    wanted = build("blur")(build("darken")(batch).float() / 255)
    steps = [build("darken"), v2.ToDtype(torch.float32, scale=True), build("blur")]
    assert torch.allclose(v2.Compose(steps)(batch), wanted, atol=1e-6)
    module = nn.Sequential(build("darken"), nn.Identity())
    assert torch.equal(module(batch), build("darken")(batch))
    assert torch.equal(module.eval()(batch), batch)
    assert list(module.state_dict()) == []
    assert "Augment(Policy('thesis', 25 slots), seed=0)" in repr(nn.Sequential(build()))


def test_policies_need_no_torchvision():
    code = "import sys, augment; augment.policy('strong'); print('torch' in sys.modules, 'torchvision' in sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert loaded.stdout.split() == ["True", "False"]


def test_gradients_reach_the_picture():
    picture = panoramas(1, dtype=torch.float32).requires_grad_()
    build("contrast")(picture).sum().backward()
    assert picture.grad.abs().sum() > 0


def test_a_sample_of_pictures_and_other_things():
    left, right = (tv_tensors.Image(torch.full((3, 8, 16), 200, dtype=torch.uint8)) for _ in range(2))
    box = tv_tensors.BoundingBoxes([[1, 1, 4, 4]], format="XYXY", canvas_size=(8, 16))
    mask, label, text = tv_tensors.Mask(torch.eye(8, 16)), torch.tensor(3), "corridor"
    out = build("darken")({"pair": (left, right), "marks": [mask, box], "label": label, "room": text})
    assert torch.equal(out["pair"][0], out["pair"][1])
    assert not torch.equal(out["pair"][0], left)
    assert torch.equal(out["marks"][0], mask)
    assert torch.equal(out["marks"][1], box)
    assert (out["label"], out["room"]) == (label, text)
    first, second = build("darken")(torch.full((3, 8, 16), 200, dtype=torch.uint8), label)
    assert int(first.max()) < 200
    assert second is label
    assert build("rotate")([mask])[0] is mask
    pose = np.zeros(3)
    assert build("darken")(left, pose)[1] is pose


class OwnTurn(augment.Effect):
    """A turn that does not say so by `moves`."""

    name = "own turn"
    RANGES: ClassVar = {"shift": Range(3, 3, neutral=0)}

    def complete(self, params, count, height, width):
        return {**params, "heading": params["shift"] * 0.1}

    def limits(self, height, width):
        return {**super().limits(height, width), "heading": Range(0, 1)}

    def render(self, batch, values):
        return batch.roll(3, dims=-1)


@pytest.mark.parametrize("effect", ["rotate", "view"])
def test_what_cannot_be_moved_with_the_picture(effect):
    picture = tv_tensors.Image(panoramas(1)[0])
    box = tv_tensors.BoundingBoxes([[1, 1, 4, 4]], format="XYXY", canvas_size=(24, 64))
    in_policy = Augment(augment.Policy({"all_of": [{"effect": "blur"}, {"effect": effect}]}))
    for moving in (build(effect), in_policy):
        with pytest.raises(augment.AugmentError, match=f"{effect} moves the image but cannot move BoundingBoxes"):
            moving(picture, box)
    with pytest.raises(augment.AugmentError, match="own turn moves the image but cannot move BoundingBoxes"):
        Augment(OwnTurn())(picture, box)
    still = augment.effect("rotate", circular=False), augment.Policy({"effect": effect, "probability": 0})
    for one in still:
        assert Augment(one)(picture, box)[1] is box


@pytest.mark.parametrize(
    ("sample", "message"),
    [
        (torch.zeros(1, 8, 16), r"an image has shape \(..., 3, H, W\), got \(1, 8, 16\)"),
        (torch.zeros(8, 16), r"an image has shape"),
        (np.zeros((3, 8, 16), np.uint8), "the sample holds no image, which is a tensor"),
        (torch.full((3, 8, 16), 2.0), "a float batch lies in"),
        (torch.zeros(3, 8, 16, dtype=torch.int64), "a batch is a tensor .*, uint8, or float32"),
        (Image.new("L", (16, 8)), "a Pillow image must be RGB, got L"),
        ([tv_tensors.Image(torch.zeros(3, 8, w)) for w in (16, 32)], "the images of one sample must have the same"),
    ],
)
def test_samples_that_make_no_sense(sample, message):
    with pytest.raises(augment.AugmentError, match=message):
        build()(sample)


def test_arguments_that_make_no_sense():
    with pytest.raises(augment.AugmentError, match=r"Augment takes an effect or a policy, such as .*, got 'thesis'"):
        Augment("thesis")
    for seed in (-1, 1.5, True):
        with pytest.raises(augment.AugmentError, match="seed of Augment must be a whole number from 0 to"):
            Augment(augment.effect("blur"), seed=seed)


class Grey(Dataset):
    """Equal pictures, so that what comes out shows the draws."""

    def __init__(self):
        self.transform = v2.Compose([build("darken")])

    def __len__(self):
        return 8

    def __getitem__(self, number):
        return self.transform(torch.full((3, 4, 8), 200, dtype=torch.uint8))


def epochs(workers, seed):
    loader = DataLoader(Grey(), batch_size=4, num_workers=workers, generator=generator(seed))
    return [torch.cat(list(loader))[:, 0, 0, 0].tolist() for _ in range(2)]


@pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork:DeprecationWarning")
@pytest.mark.parametrize("workers", [0, 2])
def test_workers_and_epochs_differ_and_can_be_repeated(workers):
    first, second = epochs(workers, 1)
    assert first != second
    assert first[:4] != first[4:]
    assert epochs(workers, 1) == [first, second]
    assert (epochs(workers, 2)[0] == first) == (workers == 0)
