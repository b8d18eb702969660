"""What a training does for its device: panoramas stored there, a compiled network, and steps that never wait."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

import siamloc
from siamloc.data.library import PanoramaLibrary
from siamloc.errors import ConfigError
from siamloc.models.places import PlaceModule
from siamloc.training import batches, trainer
from siamloc.training.trainer import check_trainer
from siamloc.training.worst_queries import WorstQueries

PAIRS = {"batch_size": 4, "monitor": "loss", "pairs": {"label": "room", "epoch_pairs": 10}}
PLACES = {"pairs": {"places": 4, "images": 2, "radius": 1.0, "epoch_batches": 2}}
ADAMW = {"name": "adamw", "learning_rate": 0.01}


def network(head="flat", **options):
    return siamloc.models.build("simple1", head, (16, 64), outputs=16, **options)


@pytest.fixture
def fit(images, drives, tmp_path):
    """Train for two epochs, and return the run and the weights."""

    def run(name, **more):
        net = network()
        options = {"validation": drives[1], "epochs": 2, "optimizer": ADAMW, "augmentation": "lighting", **more}
        run = siamloc.training.fit(net, images, drives[0], run=tmp_path / name, **options)
        return run, net.state_dict()

    return run


def same(first, second):
    return list(first) == list(second) and all(torch.equal(first[name], second[name]) for name in first)


@pytest.mark.parametrize("settings", [PAIRS, PLACES], ids=["pairs", "places"])
def test_panoramas_on_the_device_give_the_same_training(fit, monkeypatch, settings):
    plain = fit("plain", augment_where="gpu", **settings)
    gathered = []
    monkeypatch.setattr(WorstQueries, "on_fit_end", lambda *_: None)  # which reads images when the training is over
    batch = PanoramaLibrary.batch
    monkeypatch.setattr(PanoramaLibrary, "batch", lambda self, rows: gathered.append(len(rows)) or batch(self, rows))
    monkeypatch.setattr(batches, "room_for", lambda device: 32 * 3 * 16 * 64)
    there = fit("there", augment_where="gpu", **settings)
    assert same(plain[1], there[1])
    assert plain[0].curves().keys() == there[0].curves().keys()
    assert all((plain[0].curves()[name] == there[0].curves()[name]).all() for name in ("epoch", "train/loss"))
    assert gathered.index(32) == len(gathered) - 1  # all of them, once, and then no others; before, batches are checked


def test_panoramas_that_are_too_many_or_are_changed_before_stay_where_they_are(fit, monkeypatch):
    monkeypatch.setattr(batches, "Resident", None)
    monkeypatch.setattr(batches, "room_for", lambda device: 32 * 3 * 16 * 64 - 1)
    few = fit("few", augment_where="gpu", **PLACES)
    monkeypatch.setattr(batches, "room_for", lambda device: 1 << 40)
    changed = fit("changed", augment_where="cpu", validation=None, **PLACES)
    assert few[1].keys() == changed[1].keys()


@pytest.mark.parametrize("settings", [PAIRS, PLACES], ids=["pairs", "places"])
def test_a_compiled_network_learns_the_same_under_the_same_names(fit, monkeypatch, settings):
    monkeypatch.setattr(trainer, "BACKEND", "aot_eager")
    more = {"average": 0.9, "trainer": {"precision": "auto"}, "epochs": 1, **settings}
    calls = []
    make = torch.compile
    monkeypatch.setattr(torch, "compile", lambda work, **options: calls.append(options) or make(work, **options))
    (run, weights), (_, plain) = fit("compiled", compile=True, **more), fit("plain", compile=False, **more)
    assert len(calls) == 1
    assert list(weights) == list(plain)
    for name in plain:
        torch.testing.assert_close(weights[name], plain[name], atol=1e-5, rtol=1e-4)
    assert same(siamloc.models.load(run).state_dict(), weights)
    fit("compiled", **{**more, "compile": False, "epochs": 2}, resume=True)


@pytest.mark.parametrize(
    ("settings", "relative"), [(PAIRS, False), (PLACES, False), (PLACES, True)], ids=["pairs", "places", "relative"]
)
def test_the_modern_network_is_one_graph_compiled_once(images, drives, tmp_path, monkeypatch, settings, relative):
    """Pairs have a smaller last batch. A network that learns displacements has two parts, each a graph of its own."""
    graphs = []
    monkeypatch.setattr(trainer, "BACKEND", lambda graph, inputs: graphs.append(graph) or graph.forward)
    recipe = siamloc.training.recipe("modern")
    options = {name: recipe.training[name] for name in ("average", "clip", "optimizer")} | settings
    options |= {"validation": drives[1], "epochs": 2, "compile": True, "trainer": dict(recipe.trainer)}
    network = recipe.build((16, 64), relative=relative)
    siamloc.training.fit(network, images, drives[0], run=tmp_path / "run", **options)
    assert len(graphs) == 1 + relative


def refuse(graph, inputs):
    raise RuntimeError("no such thing")


def test_a_network_that_cannot_be_compiled_is_one_sentence_or_a_note(fit, monkeypatch, tmp_path, capfd):
    monkeypatch.setattr(trainer, "BACKEND", refuse)
    with pytest.raises(ConfigError, match=r"torch cannot compile this network here: .*no such thing.*leave compile"):
        fit("run", compile=True, **PLACES)
    assert not (tmp_path / "run").exists()
    module = PlaceModule(network())
    images = torch.rand(2, 3, 16, 64, generator=torch.Generator().manual_seed(0))
    with trainer.compiled(module, "auto"):
        assert torch.equal(module.computed(module.network, images), module.network(images))
        assert module.compiled is None
    assert "note: training without torch.compile, which fails here" in capfd.readouterr().err


@pytest.mark.parametrize("fast", [True, False])
def test_the_fastest_precision_of_a_cpu_follows_from_its_instructions(monkeypatch, fast):
    trainer = {"accelerator": "cpu", "precision": "auto"}
    processor = Path("/proc/cpuinfo")
    if processor.is_file():
        known = "avx512_bf16" in processor.read_text().split()
        assert check_trainer(trainer).precision == ("bf16-mixed" if known else "32-true")
    monkeypatch.setattr(torch.cpu, "_is_avx512_bf16_supported", lambda: fast)
    assert check_trainer(trainer).precision == ("bf16-mixed" if fast else "32-true")


class Greedy(torch.nn.Module):
    """A network whose training step asks for far more memory than any machine has."""

    def __init__(self, error=None):
        super().__init__()
        self.layer, self.error = torch.nn.Linear(3, 4), error

    def forward(self, images):
        if self.training and self.error is None:
            torch.empty(1 << 60, dtype=torch.uint8)
        elif self.training:
            raise self.error
        return torch.nn.functional.normalize(self.layer(images.mean((2, 3))))


LACKS = [
    None,
    MemoryError("Unable to allocate 3 TiB for an array"),
    torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 20.00 GiB. GPU 0 has a total capacity of 15.77 GiB"),
    RuntimeError("CUDA error: CUBLAS_STATUS_ALLOC_FAILED when calling `cublasCreate(handle)`"),
]


@pytest.mark.parametrize("error", LACKS, ids=["here", "numpy", "gpu", "cublas"])
def test_too_little_memory_is_one_sentence(images, drives, tmp_path, error):
    for settings, batch in ((PAIRS, "batch_size=4"), (PLACES, "pairs.places and pairs.images")):
        says = f"^there is too little memory for {batch}, trainer.precision=32-true and augment.where=auto: take "
        with pytest.raises(ConfigError, match=says):
            siamloc.training.fit(Greedy(error), images, drives[0], run=tmp_path / "run", **settings)
    assert not (tmp_path / "run").exists()


def test_other_errors_of_a_step_stay_what_they_are(images, drives, tmp_path):
    network = Greedy(RuntimeError("an illegal memory access was encountered"))
    with pytest.raises(RuntimeError, match="an illegal memory access"):
        siamloc.training.fit(network, images, drives[0], run=tmp_path / "run", **PAIRS)


@pytest.mark.skipif(torch.cuda.is_available(), reason="with a GPU")
@pytest.mark.parametrize("name", ["gpu", "cuda"])
def test_a_gpu_that_is_missing_is_one_sentence(fit, tmp_path, name):
    with pytest.raises(ConfigError, match=f"^trainer.accelerator={name} needs a GPU, and torch finds none here: use a"):
        fit("run", trainer={"accelerator": name}, **PAIRS)
    assert not (tmp_path / "run").exists()


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_the_random_state_of_the_gpu_stays_as_it_was(fit):
    before = torch.cuda.get_rng_state()
    fit("run", trainer={"accelerator": "gpu"}, **PAIRS)
    assert torch.equal(torch.cuda.get_rng_state(), before)


@pytest.mark.parametrize("settings", [PAIRS, PLACES], ids=["pairs", "places"])
def test_the_default_device_changes_nothing(fit, monkeypatch, settings):
    plain = fit("plain", **settings)
    net = network()
    monkeypatch.setitem(globals(), "network", lambda: net)
    with torch.device("meta"):
        there = fit("there", **settings)
    assert same(plain[1], there[1])


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
@pytest.mark.parametrize("settings", [PAIRS, PLACES], ids=["pairs", "places"])
def test_a_gpu_is_never_waited_for_within_a_step(fit, monkeypatch, settings):
    """CUDA raises where something waits; the trainer itself may between epochs."""
    from siamloc.training.pace import Pace

    class Strict(Pace):
        def on_train_batch_start(self, trainer, pl_module, batch, batch_idx):
            super().on_train_batch_start(trainer, pl_module, batch, batch_idx)
            torch.cuda.set_sync_debug_mode("error" if batch_idx else "default")

        def on_train_batch_end(self, trainer, pl_module, outputs, batch, batch_idx):
            torch.cuda.set_sync_debug_mode("default")
            super().on_train_batch_end(trainer, pl_module, outputs, batch, batch_idx)

    pace = Strict()
    trainer = {"accelerator": "gpu", "precision": "auto", "callbacks": [pace], "log_every_n_steps": 1000}
    fit("run", trainer=trainer, average=0.9, **settings)
    assert 0 <= pace.waiting <= 1 or pace.images_per_second != pace.images_per_second
