"""Physically motivated augmentation of panoramas: light, optics and motion, batched and replayable.

    effect = augment.effect("bulb", tone="light")
    params = effect.draw(torch.Generator().manual_seed(0), batch)   # separate ones for every frame
    brighter = effect.apply(batch, params)                          # the same images each time

A batch has shape (B, 3, H, W), RGB, uint8 or float32 in [0, 1]; columns are azimuth and wrap around unless
`circular=False`. `augment.policy` combines effects at random; `augment.Augment` turns an effect or a policy into a
torch module and torchvision transform. `augment.expand` writes expanded data sets to disk. Importing the package does
not load torch.
"""

from foundation.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)
