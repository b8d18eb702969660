"""`Augment`: an effect or a policy as a torch module and a torchvision transform."""

from __future__ import annotations

from math import prod
from typing import Any

import torch
from torch import Tensor
from torch.utils.data import get_worker_info

from augment.base import Effect, Params, seeded
from augment.errors import AugmentError
from augment.torchvision_compat import ensure_torchvision
from foundation.settings import Seed, checked

ensure_torchvision()
from torchvision import tv_tensors  # noqa: E402
from torchvision.transforms import v2  # noqa: E402
from torchvision.transforms.v2 import functional  # noqa: E402


class Augment(v2.Transform):
    """Augment images with an effect or a policy: in `v2.Compose`, in `nn.Sequential`, in a data set.

    In training mode every call draws new parameters for each image; after `eval()` images stay as they are.

    Images are tensors (..., 3, H, W), uint8, or floating point in [0, 1], `tv_tensors.Image` or `tv_tensors.Video`,
    or RGB images of Pillow; type, shape and dtype stay the same. A sample may be nested, as for all transforms of
    torchvision; all images in it, such as the two of a stereo camera, get the same parameters. Effects that move the
    image, such as `rotate` and `view`, refuse masks, boxes and key points. Everything else in a sample stays as it is,
    as do plain tensors after the first image. To repeat a draw, keep the parameters: call `make_params([picture])`
    once, and `transform(picture, params)` as often as needed.

    Draws depend only on `seed` and the number of earlier calls, not on torch's global generator. A copy draws what
    the original would. In a worker of a DataLoader, the worker's seed is mixed in, so that workers and epochs differ;
    to repeat them, give the loader a seeded `generator`. Processes that train together each need their own seed.

    Args:
        effect: an effect from `augment.effect`, `augment.policy` or `Policy`.
        seed: seed of the draws.

    Attributes:
        effect: the effect or policy.
        seed: seed of the draws.
        calls: number of draws so far; set it to continue where an earlier run stopped.

    Raises:
        AugmentError: not an effect, a negative seed, a sample without an image, or images of a wrong shape, dtype or
            range.

    Example:
        >>> import torch, augment
        >>> darker = augment.Augment(augment.effect("darken", amount=(30, 60)), seed=0)
        >>> picture = torch.full((3, 128, 512), 100, dtype=torch.uint8)
        >>> [int(darker(picture).max()) for _ in range(3)]
        [66, 54, 53]
        >>> int(darker.eval()(picture).max())
        100
    """

    def __init__(self, effect: Effect, seed: int = 0) -> None:
        super().__init__()
        if not isinstance(effect, Effect):
            raise AugmentError(f"Augment takes an effect or a policy, such as augment.policy('thesis'), got {effect!r}")
        self.effect = effect
        self.seed = checked(seed, Seed, "seed of Augment", AugmentError)
        self.calls = 0

    def extra_repr(self) -> str:
        """Return what the module's repr shows."""
        return f"{self.effect!r}, seed={self.seed}"

    def forward(self, *inputs: Any) -> Any:
        """Return the sample with augmented images; after `eval()` the sample as it is."""
        if self.training:
            return super().forward(*inputs)
        return inputs if len(inputs) > 1 else inputs[0]

    def make_params(self, flat_inputs: list[Any]) -> Params:
        """Draw the parameters for the images of a sample; none if it has only masks, boxes and the like.

        Raises:
            AugmentError: it has none of these, or images of different sizes.
        """
        if not flat_inputs:
            raise AugmentError(
                "the sample holds no image, which is a tensor (..., 3, H, W) or an RGB image of Pillow: turn an array "
                "(3, H, W) into a tensor with torch.from_numpy"
            )
        shapes = {_shape(item) for item in flat_inputs if _is_picture(item)}
        if not shapes:
            return {}
        if len(shapes) > 1:
            raise AugmentError(f"the images of one sample must have the same number and size, got {sorted(shapes)}")
        count, height, width = shapes.pop()
        worker, call = get_worker_info(), self.calls
        self.calls += 1
        generator = seeded(self.seed, call, *([] if worker is None else [worker.seed]))
        params = self.effect.draw(generator, torch.empty(count, 3, height, width, device="meta"))
        marks = [type(item).__name__ for item in flat_inputs if not _is_picture(item)]
        for one, own, changed in self.effect.parts(params) if marks else ():
            if changed.any() and (one.moves or ("heading" in own and own["heading"].any())):
                raise AugmentError(
                    f"{one.name} moves the image but cannot move {marks[0]} with it: leave one of them out"
                )
        return params

    def transform(self, inpt: Any, params: Params) -> Any:
        """Apply parameters to one item of a sample."""
        if not _is_picture(inpt):
            return inpt
        if not isinstance(inpt, Tensor):
            return functional.to_pil_image(self.transform(functional.pil_to_tensor(inpt), params))
        batch = inpt.as_subclass(Tensor).reshape(-1, *inpt.shape[-3:])
        out = self.effect.apply(batch.float() if batch.is_floating_point() else batch, params).to(inpt.dtype)
        return tv_tensors.wrap(out.reshape(inpt.shape), like=inpt)


def _is_picture(item: Any) -> bool:
    """Return True for an image, False for masks, boxes and other marks in one."""
    return not isinstance(item, tv_tensors.TVTensor) or isinstance(item, tv_tensors.Image | tv_tensors.Video)


def _shape(picture: Any) -> tuple[int, int, int]:
    """Return number, height and width of the images in an item of a sample."""
    if not isinstance(picture, Tensor):
        if picture.mode != "RGB":
            raise AugmentError(f"a Pillow image must be RGB, got {picture.mode}: use picture.convert('RGB')")
        return 1, picture.height, picture.width
    if picture.ndim < 3 or picture.shape[-3] != 3:
        raise AugmentError(f"an image has shape (..., 3, H, W), got {tuple(picture.shape)}")
    return prod(picture.shape[:-3]), picture.shape[-2], picture.shape[-1]
