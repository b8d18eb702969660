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


def test_report_and_file_agree(exported):
    network, path, report = exported
    assert report["path"] == str(path)
    assert report["bytes"] == path.stat().st_size
    assert report["identity"] == network.identity
    assert report["parity"]["batches"] == [1, 2, 7]
    assert 0 <= report["parity"]["max_abs_difference"] <= report["parity"]["tolerance"] == 1e-4
    assert report["parity"]["max_abs_value"] > 0.1
    expected = report["parity"]["max_abs_difference"] / report["parity"]["max_abs_value"]
    assert report["parity"]["max_relative_difference"] == expected
    json.dumps(report, allow_nan=False)


def test_the_folder_holds_the_file_and_nothing_else(exported):
    _, path, _ = exported
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]


def test_the_file_is_valid_and_says_what_it_is(exported):
    network, path, report = exported
    onnx.checker.check_model(str(path), full_check=True)
    model = onnx.load(path, load_external_data=False)
    metadata = {entry.key: entry.value for entry in model.metadata_props}
    assert (metadata["format"], metadata["format_version"]) == ("siamloc-network", "2")
    assert json.loads(metadata["identity"]) == network.identity
    assert model.opset_import[0].version == report["opset"]


def test_input_and_output_are_named_and_only_the_batch_is_free(exported):
    _, path, _ = exported
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    (entrance,), (exit_,) = session.get_inputs(), session.get_outputs()
    assert (entrance.name, entrance.type, entrance.shape[1:]) == ("panorama", "tensor(uint8)", [3, *SIZE])
    assert (exit_.name, exit_.shape[1:]) == ("descriptor", [5])
    assert isinstance(entrance.shape[0], str)


def test_the_file_computes_what_describe_computes(exported):
    network, path, _ = exported
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
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


def test_it_is_quiet(tmp_path, capfd, recwarn, caplog):
    export_onnx(build("simple1", "fc500_500_5", SIZE), tmp_path / "network.onnx", SIZE)
    assert capfd.readouterr() == ("", "")
    assert not recwarn.list
    assert not [record for record in caplog.records if record.levelno >= logging.INFO]


def test_a_network_of_ones_own_is_exported_whole(tmp_path):
    class Own(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.network = torch.nn.AdaptiveAvgPool2d(2)  # a name that says nothing
            self.head = torch.nn.Linear(12, 4)

        def forward(self, panoramas):
            return self.head(self.network(panoramas).flatten(1))

    report = export_onnx(Own(), tmp_path / "network.onnx", (16, 32))
    session = onnxruntime.InferenceSession(tmp_path / "network.onnx", providers=["CPUExecutionProvider"])
    assert session.get_outputs()[0].shape[1:] == [4]
    assert report["identity"]["class"].endswith("Own")


@pytest.mark.slow
@pytest.mark.parametrize("size", [(128, 512), (37, 131), (4, 16), (5, 17)])
def test_the_simple_branches_export_at_any_size(tmp_path, size):
    report = export_onnx(build("simple2", "fc500_100_10", size), tmp_path / "network.onnx", size)
    assert report["parity"]["max_abs_difference"] <= 1e-4


def test_a_lightning_module_is_exported_as_its_network(tmp_path):
    module = SiameseModule(build("simple1", "fc500_500_5", SIZE))
    report = export_onnx(module, tmp_path / "network.onnx", SIZE)
    assert report["identity"] == module.network.identity
    assert parity(module, tmp_path / "network.onnx") == report["parity"]


def test_weights_too_large_for_one_file_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(onnx_model, "MOST_BYTES", 1000)
    with pytest.raises(ConfigError, match="2 GB or more does not fit"):
        export_onnx(build("simple1", "fc500_500_5", SIZE), tmp_path / "network.onnx", SIZE)
    assert not list(tmp_path.iterdir())


def test_a_file_of_other_weights_fails_the_comparison(exported):
    _, path, _ = exported
    other = build("vgg11_bn", "fc500_500_5", SIZE, seed=1)
    with pytest.raises(SiamlocError, match=r"differ by .* from the network's, .* of the largest value .*do not use"):
        parity(other, path)


def test_a_network_of_another_length_fails_the_comparison(exported):
    _, path, _ = exported
    with pytest.raises(SiamlocError, match=r"shape \(1, 5\) instead of \(1, 10\)"):
        parity(build("vgg11_bn", "fc500_100_10", SIZE), path)


def test_values_that_are_not_finite_fail_the_comparison(tmp_path):
    network = build("simple1", "fc500_500_5", SIZE)
    with torch.no_grad():
        network.head.layers[-1].bias[0] = float("nan")
    with pytest.raises(SiamlocError, match="differ by nan"):
        export_onnx(network, tmp_path / "network.onnx", SIZE)
    assert not list(tmp_path.iterdir())


def test_a_file_that_differs_never_replaces_the_older_one(tmp_path, monkeypatch):
    def refuse(network, path):
        raise SiamlocError("differs")

    path = tmp_path / "network.onnx"
    path.write_text("older")
    monkeypatch.setattr(onnx_model, "parity", refuse)
    with pytest.raises(SiamlocError, match="differs"):
        export_onnx(build("simple1", "fc500_500_5", SIZE), path, SIZE)
    assert path.read_text() == "older"
    assert list(tmp_path.iterdir()) == [path]


def test_another_image_size_is_refused(tmp_path):
    with pytest.raises(DataError, match=r"built for panoramas of shape \(B, 3, 32, 64\)"):
        export_onnx(build("simple1", "fc500_500_5", SIZE), tmp_path / "network.onnx", (64, 64))


def test_half_precision_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"needs float32 weights, got torch\.bfloat16"):
        export_onnx(build("simple1", "fc500_500_5", SIZE).bfloat16(), tmp_path / "network.onnx", SIZE)


def test_other_files_are_refused(tmp_path):
    (tmp_path / "text.onnx").write_text("no graph")
    for name in ("text.onnx", "missing.onnx"):
        with pytest.raises(FormatError, match="not an ONNX file that onnxruntime can run"):
            parity(build("simple1", "fc500_500_5", SIZE), tmp_path / name)


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

    report = export_onnx(module, tmp_path / "network.onnx", size)
    assert report["parity"]["batches"] == [1, 2, 7]
    assert report["parity"]["max_abs_difference"] <= 1e-4
    (tmp_path / "network.onnx").unlink()
