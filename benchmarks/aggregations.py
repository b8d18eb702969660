"""Compare ways to sum up the features of a panorama in 2,048 numbers, on the branch of the shipped network.

`magnitudes` is the head that ships, without weights, and `gem` and `bands` are heads of siamloc. The others are common
in visual place recognition: residuals to clusters [Arandjelovic 2016], optimal transport to clusters with a dustbin
[Izquierdo 2024], and attention of learned queries. Those with weights are trained on views of random buildings with
the loss of pretraining, and are also measured before that. The branch does not change: it was trained with
`magnitudes`, so the table says which head to put on it, not what another branch would learn with another head.

They learn from the same batches, those of pretraining without augmentation, from a seed that the shipped network was
not trained with. They are judged in other buildings, drawn alike: the map is the first drive under its first light; the
queries are the second drive, under three other lights.

    OMP_NUM_THREADS=1 python -m benchmarks.aggregations [--seeds 3]
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

import siamloc
from benchmarks.report import Report, milliseconds, parser
from siamloc.data.places import PlaceSettings
from siamloc.models.batch_losses import make_loss
from siamloc.models.origins import Origins
from siamloc.models.registry import PRETRAINED_SIZE
from siamloc.pretraining import RECIPE, ViewSettings
from siamloc.pretraining.view_batches import Renderer, ViewBatches
from siamloc.simulate import Views

OUTPUTS, CLUSTERS, QUERIES, HIDDEN = 2048, 16, 16, 256  # a panorama has 64 cells of features
LIGHTS, SPACING = 3, 0.3
VIEWS = ViewSettings(cameras="panoramas")
STEPS = (2, 10, 20)  # one frame in so many is in the map
JUDGED_IN, JUDGING, POSES = 700_000_000, 30, 160  # seed of the first building, number of buildings, poses of a drive
LEARNED_FROM, BATCHES, RATE = 7, 400, 1e-3  # seed of the batches, their number, and the largest learning rate
BY_PANORAMA = 200  # timed


class Clusters(nn.Module):
    """Sums of the residuals of reduced features to learned centres, softly assigned [Arandjelovic 2016]."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        size = OUTPUTS // CLUSTERS
        self.assign, self.reduce = nn.Conv2d(channels, CLUSTERS, 1), nn.Conv2d(channels, size, 1)
        self.centres = nn.Parameter(0.1 * torch.randn(CLUSTERS, size))

    def forward(self, features: Tensor) -> Tensor:
        share = self.assign(features).flatten(2).softmax(dim=1)
        sums = share @ self.reduce(features).flatten(2).mT - share.sum(dim=2, keepdim=True) * self.centres
        return F.normalize(F.normalize(sums, dim=2).flatten(1))


class Transport(nn.Module):
    """Sums of reduced features by optimal transport to learned clusters and a dustbin [Izquierdo 2024]."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.score, self.reduce = (
            nn.Sequential(nn.Conv2d(channels, HIDDEN, 1), nn.ReLU(), nn.Conv2d(HIDDEN, outputs, 1))
            for outputs in (CLUSTERS, OUTPUTS // CLUSTERS)
        )
        self.dustbin = nn.Parameter(torch.ones(1))

    def forward(self, features: Tensor) -> Tensor:
        score = self.score(features).flatten(2)
        cells = score.shape[2]
        score = torch.cat([score, self.dustbin.expand(len(score), 1, cells)], dim=1)
        wanted = torch.ones(CLUSTERS + 1)  # one cell for each cluster, and the rest for the dustbin
        wanted[-1] = cells - CLUSTERS
        wanted = wanted.log()
        rows = score.new_zeros(len(score), CLUSTERS + 1, 1)
        for _ in range(3):
            columns = -torch.logsumexp(score + rows, dim=1, keepdim=True)
            rows = wanted[:, None] - torch.logsumexp(score + columns, dim=2, keepdim=True)
        share = (score + rows + columns).exp()[:, :-1]
        return F.normalize(F.normalize(share @ self.reduce(features).flatten(2).mT, dim=2).flatten(1))


class Attention(nn.Module):
    """Means of reduced features, weighted by how well they match learned queries."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.match, self.reduce = nn.Conv2d(channels, QUERIES, 1), nn.Conv2d(channels, OUTPUTS // QUERIES, 1)

    def forward(self, features: Tensor) -> Tensor:
        share = self.match(features).flatten(2).softmax(dim=2)
        return F.normalize(F.normalize(share @ self.reduce(features).flatten(2).mT, dim=2).flatten(1))


HEADS: dict[str, Callable[[int], nn.Module]] = {
    "magnitudes": lambda _: siamloc.models.pretrained().head,
    "gem": lambda _: _head("gem"),
    "bands": lambda _: _head("bands"),
    "clusters": Clusters,
    "transport": Transport,
    "attention": Attention,
}


@dataclass
class Seen:
    """The features (N, C, h, w) of one building's images in half precision, and where they come from."""

    features: Tensor
    views: Views


def main() -> None:
    """Train and judge each head, print a table and write the file."""
    arguments = parser(__doc__)
    arguments.add_argument("--seeds", type=int, default=3)
    options = arguments.parse_args()
    report = Report("aggregations", options.out)
    judging = list(seen())
    made: dict[str, list[nn.Module]] = {name: [] for name in HEADS}
    for name, seed in product(HEADS, range(options.seeds)):
        torch.manual_seed(seed)
        made[name].append(HEADS[name](judging[0].features.shape[1]))
    made["magnitudes"] = made["magnitudes"][:1]  # without weights, all are the same
    rows: dict[str, dict[str, Any]] = {}
    for name, heads in made.items():
        weights = sum(one.numel() for one in heads[0].parameters())
        rows[name] = {"weights": weights, **timed(heads[0], judging[0])}
        rows[name]["at first"] = [judged(head, judging) for head in heads]
    print(f"\n{table(rows)}\n", flush=True)
    trained = {name: heads for name, heads in made.items() if rows[name]["weights"]}
    learn([head for heads in trained.values() for head in heads])
    for name, heads in trained.items():
        rows[name]["trained"] = [judged(head, judging) for head in heads]
    print(f"\n{table(rows)}\n")
    settings = {**asdict(VIEWS), "batches": BATCHES, "judging": JUDGING, "outputs": OUTPUTS, "seeds": options.seeds}
    report.write({"settings": settings, "rows": rows})


@cache
def branch() -> nn.Module:
    """Return the shipped network without its head: it returns features (B, C, h, w)."""
    network = siamloc.models.pretrained().eval()
    network.register_module("head", nn.Identity())
    return network


def seen() -> Iterator[Seen]:
    """Draw the buildings to judge in, two drives through each under three lights, and describe their images."""
    settings = replace(VIEWS, poses=POSES, lights=LIGHTS, spacing=SPACING)
    wanted = [settings.drawn(JUDGED_IN + n, PRETRAINED_SIZE) for n in range(JUDGING)]
    with closing(Renderer(2)) as renderer:
        for one in wanted:
            renderer.begin(one)
        for one in wanted:
            views = renderer.views(one)
            with torch.no_grad():
                parts = [branch()(part / 255).half() for part in torch.from_numpy(views.images).split(64)]
            yield Seen(torch.cat(parts), replace(views, images=views.images[:0].copy()))


def learn(heads: Sequence[nn.Module]) -> None:
    """Train heads on the same batches, with the loss of pretraining."""
    places = PlaceSettings.of({**RECIPE.training["pairs"], "epoch_batches": BATCHES})
    loss = make_loss(**(RECIPE.loss or {}))
    optimizers = [torch.optim.AdamW(head.parameters(), lr=RATE, weight_decay=0.01) for head in heads]
    cycles = [torch.optim.lr_scheduler.OneCycleLR(one, RATE, total_steps=BATCHES, pct_start=0.2) for one in optimizers]
    with closing(Renderer(1)) as renderer:
        batches = ViewBatches(renderer, PRETRAINED_SIZE, VIEWS, places, LEARNED_FROM)
        for number in range(BATCHES):
            item = batches[0, number]
            origins = Origins(**{key: item[key] for key in ("xy", "building", "room", "frame", "overlap")})
            with torch.no_grad():
                features = branch()(item["images"] / 255)
            for head, optimizer, cycle in zip(heads, optimizers, cycles, strict=True):
                optimizer.zero_grad()
                loss(head(features), origins).backward()
                nn.utils.clip_grad_norm_(head.parameters(), 1.0)
                optimizer.step()
                cycle.step()


def judged(head: nn.Module, buildings: list[Seen]) -> dict[str, Any]:
    """Return, for each map, the mean error in m above the floor and the share of right rooms; means over buildings."""
    found: dict[str, list[tuple[float, float]]] = {str(every): [] for every in STEPS}
    for building in buildings:
        views = building.views
        with torch.no_grad():
            described = torch.cat([head(part.float()) for part in building.features.split(64)])
        first, asked = np.flatnonzero(views.light == 0), np.flatnonzero(views.light >= LIGHTS)
        for every in STEPS:
            known = first[::every]
            best = known[(described[asked] @ described[known].T).argmax(dim=1).numpy()]
            apart = np.linalg.norm(views.xy[asked, None] - views.xy[known], axis=2).min(axis=1)
            error = np.linalg.norm(views.xy[asked] - views.xy[best], axis=1)
            right = views.room[asked] == views.room[best]
            found[str(every)].append((float(error.mean() - apart.mean()), float(right.mean())))
    return {
        step: {
            "excess": statistics.mean(error for error, _ in pairs),
            "rooms": statistics.mean(room for _, room in pairs),
        }
        for step, pairs in found.items()
    }


def timed(head: nn.Module, building: Seen) -> dict[str, float]:
    """Return the median time of a head for one panorama."""
    features = building.features[:1].float()
    with torch.no_grad():
        return milliseconds(lambda: head(features), BY_PANORAMA)


def table(rows: dict[str, dict[str, Any]]) -> str:
    """Return a table of the excess and the rooms, means over the seeds."""
    lines = [
        f"| head | | {' | '.join(f'{every * SPACING:g} m' for every in STEPS)} |",
        "|---|---|" + "---|" * len(STEPS),
    ]
    for name, row in rows.items():
        for when in ("at first", "trained"):
            if when in row:
                cells = [
                    f"{statistics.mean(one[str(every)]['excess'] for one in row[when]):.3f}; "
                    f"{statistics.mean(one[str(every)]['rooms'] for one in row[when]):.1%}"
                    for every in STEPS
                ]
                lines.append(f"| {name} | {when} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _head(name: str) -> nn.Module:
    """Return a head of siamloc with new weights, drawn from torch's generator."""
    made = siamloc.models.build(
        *("panoresnet_wide", name, PRETRAINED_SIZE),
        seed=int(torch.randint(1 << 30, ())),
        circular=True,
        outputs=OUTPUTS,
    )
    return made.head


if __name__ == "__main__":
    main()
