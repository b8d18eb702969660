"""Small panoramas for the tests."""

import torch


def panoramas(count=3, height=24, width=64, seed=0, dtype=torch.uint8):
    """Return random pictures with smooth and rough parts (B, 3, H, W)."""
    generator = torch.Generator().manual_seed(seed)
    rough = torch.rand(count, 3, height, width, generator=generator)
    smooth = torch.linspace(0, 1, height).view(1, 1, -1, 1) * torch.rand(count, 3, 1, 1, generator=generator)
    levels = (255 * (0.4 * rough + 0.6 * smooth)).round()
    levels[:, :, :2, :5] = 0
    levels[:, :, 2:4, :5] = 255
    return levels.to(torch.uint8) if dtype == torch.uint8 else levels / 255


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def turned(params, columns, width):
    """Return the parameters that have the same effect on a batch shifted right by a number of columns."""
    return {
        key: (value + columns) % width if key.rpartition(".")[2] == "column" else value for key, value in params.items()
    }


def described(policy, params):
    """Return the effects that each frame got: "darken + bulb light + rotate", or "original"."""
    words = [[] for _ in params["heading"]]
    for step in policy.slots:
        for frame in params[f"{step.name}.on"].nonzero()[:, 0].tolist():
            light = params.get(f"{step.name}.light")
            tone = "" if light is None else " light" if light[frame] else " dark"
            words[frame].append(step.effect.name + tone)
    return [" + ".join(some) or "original" for some in words]


def frame_params(params, frame):
    """Return the parameters of one frame as plain numbers."""
    return {key: value[frame].item() for key, value in params.items()}
