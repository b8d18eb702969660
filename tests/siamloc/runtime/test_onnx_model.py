"""Exported files: what they hold, that they compute the same, and that a bad one never gets its name."""

from __future__ import annotations

import json
import logging
from itertools import cycle

import numpy as np
import onnx
import onnxruntime
import pytest
import torch

from siamloc.errors import ConfigError, DataError, FormatError, SiamlocError
from siamloc.models import BRANCHES, HEADS, SiameseModule, as_descriptor, build
from siamloc.runtime import export_onnx, onnx_model, parity

SIZE = (32, 64)
# The smallest panorama whose grid of features has two columns, so that the head's reading order matters.
SIZES = {"alexnet": (64, 96)}


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """A network with batch normalization, its file, and the report of the export."""
    path = tmp_path_factory.mktemp("export") / "new" / "network.onnx"
    network = build("vgg11_bn", "fc500_500_5", SIZE)
    network(torch.rand(8, 3, *SIZE))  # moves the running statistics away from their start
    return network, path, export_onnx(network, path, SIZE)


def small(**options):
    return build("simple1", "fc500_500_5", SIZE, **options)


def test_report_and_file_agree(exported):
    network, path, found = exported
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]
    assert found["batches"] == [1, 2, 7]
    assert 0 <= found["max_abs_difference"] <= found["tolerance"] == 1e-4
    assert found["max_abs_value"] > 0.1
    assert found["max_relative_difference"] == found["max_abs_difference"] / found["max_abs_value"]
    json.dumps(found, allow_nan=False)
    onnx.checker.check_model(str(path), full_check=True)
    model = onnx.load(path, load_external_data=False)
    metadata = {entry.key: entry.value for entry in model.metadata_props}
    assert (metadata["format"], metadata["format_version"]) == ("siamloc-network", "2")
    assert json.loads(metadata["identity"]) == network.identity
    assert model.opset_import[0].version == onnx_model.OPSET


def test_the_file_computes_what_describe_computes_for_any_batch(exported):
    network, path, _ = exported
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    (entrance,), (exit_,) = session.get_inputs(), session.get_outputs()
    assert (entrance.name, entrance.type, entrance.shape[1:]) == ("panorama", "tensor(uint8)", [3, *SIZE])
    assert (exit_.name, exit_.shape[1:]) == ("descriptor", [5])
    assert isinstance(entrance.shape[0], str)
    images = np.random.default_rng(1).integers(0, 256, (5, 3, *SIZE), dtype=np.uint8)
    (got,) = session.run(None, {"panorama": images})
    np.testing.assert_allclose(got, as_descriptor(network).describe(images).position, atol=1e-4)


def test_the_modes_and_the_random_state_stay(tmp_path):
    network = build("vgg11_bn", "fc500_500_5", SIZE)
    frozen = network.branch.features[1].eval()
    before, statistics = torch.random.get_rng_state(), network.identity
    export_onnx(network, tmp_path / "network.onnx", SIZE)
    assert [part for part in network.modules() if not part.training] == [frozen]
    assert torch.equal(torch.random.get_rng_state(), before)
    assert network.identity == statistics


def test_a_lightning_module_is_exported_as_its_network_and_without_a_word(tmp_path, capfd, recwarn, caplog):
    module = SiameseModule(small())
    found = export_onnx(module, tmp_path / "network.onnx", SIZE)
    assert capfd.readouterr() == ("", "")
    assert not recwarn.list
    assert not [record for record in caplog.records if record.levelno >= logging.INFO]
    assert parity(module, tmp_path / "network.onnx") == found


def test_a_network_of_ones_own_is_exported_whole(tmp_path):
    class Own(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.network = torch.nn.AdaptiveAvgPool2d(2)  # a name that says nothing
            self.head = torch.nn.Linear(12, 4)

        def forward(self, panoramas):
            return self.head(self.network(panoramas).flatten(1))

    export_onnx(Own(), tmp_path / "network.onnx", (16, 32))
    session = onnxruntime.InferenceSession(tmp_path / "network.onnx", providers=["CPUExecutionProvider"])
    assert session.get_outputs()[0].shape[1:] == [4]
    metadata = session.get_modelmeta().custom_metadata_map
    assert json.loads(metadata["identity"])["class"].endswith("Own")


@pytest.mark.slow
@pytest.mark.parametrize("size", [(128, 512), (37, 131), (4, 16), (5, 17)])
def test_the_simple_branches_export_at_any_size(tmp_path, size):
    found = export_onnx(build("simple2", "fc500_100_10", size), tmp_path / "network.onnx", size)
    assert found["max_abs_difference"] <= 1e-4


def test_files_of_other_networks_and_other_files_fail_the_comparison(exported, tmp_path):
    _, path, _ = exported
    (tmp_path / "text.onnx").write_text("no graph")
    for head, file, error, says in (
        ("fc500_500_5", path, SiamlocError, r"differ by .* from the network's, .* of the largest value .*do not use"),
        ("fc500_100_10", path, SiamlocError, r"shape \(1, 5\) instead of \(1, 10\)"),
        ("fc500_500_5", tmp_path / "text.onnx", FormatError, "not an ONNX file that onnxruntime can run"),
        ("fc500_500_5", tmp_path / "missing.onnx", FormatError, "not an ONNX file that onnxruntime can run"),
        ("fc500_500_5", tmp_path / "\udcfc.onnx", ConfigError, "locale of this process lacks letters .*PYTHONUTF8=1"),
    ):
        with pytest.raises(error, match=says):
            parity(build("vgg11_bn", head, SIZE, seed=1), file)


def test_a_file_with_other_orientation_parts_fails_the_comparison(tmp_path):
    network = build("simple1", "fourier", SIZE, outputs=16, circular=True)
    export_onnx(network, tmp_path / "network.onnx", SIZE)
    network.orientation.signs[0] *= -1  # one of its 64 sums
    with pytest.raises(SiamlocError, match=r"the orientation parts of .* do not use the file"):
        parity(network, tmp_path / "network.onnx")


def test_what_cannot_be_exported_is_refused_and_keeps_the_older_file(tmp_path, monkeypatch):
    path, broken = tmp_path / "network.onnx", small()
    path.write_text("older")
    with torch.no_grad():
        broken.head.layers[-1].bias[0] = float("nan")
    for network, size, error, says in (
        (broken, SIZE, SiamlocError, "differ by nan"),
        (small(), (64, 64), DataError, r"built for panoramas of shape \(B, 3, 32, 64\)"),
        (small().bfloat16(), SIZE, ConfigError, r"needs float32 weights, got torch\.bfloat16"),
    ):
        with pytest.raises(error, match=says):
            export_onnx(network, path, size)
    monkeypatch.setattr(onnx_model, "MOST_BYTES", 1000)
    with pytest.raises(ConfigError, match="2 GB or more does not fit"):
        export_onnx(small(), path, SIZE)
    assert path.read_text() == "older"
    assert list(tmp_path.iterdir()) == [path]


OF_THE_THESIS = [name for name, head in HEADS.items() if len(head.widths) == 3]
OURS = [name for name in HEADS if name not in (*OF_THE_THESIS, "fc4096_4096")]
# Each branch with a head, each head with several branches; `benchmarks.parity` exports every combination.
NETWORKS = [
    ("alexnet", "fc4096_4096", False),  # the single network of [T] table 5.19
    *((branch, head, False) for branch, head in zip(BRANCHES, cycle(OF_THE_THESIS)) if branch != "panoresnet"),
    *((branch, head, True) for branch, head in zip(["simple1", "alexnet", "densenet121", "vgg11_bn"], cycle(OURS))),
    *(("panoresnet", head, circular) for head in OURS for circular in (True, False)),
]


@pytest.mark.slow
@pytest.mark.parametrize(("branch", "head", "circular"), NETWORKS)
def test_every_network_trains_a_step_and_exports(tmp_path, branch, head, circular):
    size = SIZES.get(branch, SIZE)
    module = SiameseModule(build(branch, head, size, circular=circular))
    images = torch.randint(0, 256, (2, 4, 3, *size), generator=torch.Generator().manual_seed(0), dtype=torch.uint8)
    same = torch.tensor([True, False, True, False])
    layers = (torch.nn.Linear, torch.nn.Conv2d)  # the last with weights; of the branch where the head has none
    last = [part for part in module.network.modules() if isinstance(part, layers)][-1]
    before = last.weight.clone()
    optimizer = module.configure_optimizers()
    loss = module.training_step({"first": images[0], "second": images[1], "label": (~same).float(), "same": same}, 0)
    loss.backward()
    assert torch.isfinite(loss)
    for name, parameter in module.named_parameters():
        assert parameter.grad is not None, name
        assert torch.isfinite(parameter.grad).all(), name
        assert parameter.ndim == 1 or parameter.grad.any(), name
    optimizer.step()
    assert not torch.equal(before, last.weight)

    found = export_onnx(module, tmp_path / "network.onnx", size)
    assert found["batches"] == [1, 2, 7]
    assert found["max_abs_difference"] <= 1e-4
    (tmp_path / "network.onnx").unlink()
