"""Which execution providers of onnxruntime describe images."""

import logging

import onnx
import onnxruntime
import pytest
from onnx import TensorProto, helper

from siamloc.errors import ConfigError, FormatError
from siamloc.runtime.describing import _SMALLEST, session_of, working_providers

CPU, CUDA = "CPUExecutionProvider", "CUDAExecutionProvider"


class Session:
    """What onnxruntime makes of a network where only the processor works."""

    def __init__(self, network, options, providers):
        self.given = providers

    def get_providers(self):
        return [CPU]


@pytest.fixture
def with_cuda(monkeypatch):
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: [CUDA, "AzureExecutionProvider", CPU])
    monkeypatch.setattr(onnxruntime, "InferenceSession", Session)


def test_the_smallest_network_is_the_one_it_should_be():
    shape = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [2]) for name in "xy"]
    graph = helper.make_graph([helper.make_node("Relu", ["x"], ["y"])], "g", shape[:1], shape[1:])
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    assert onnx.load_from_string(_SMALLEST) == made


def test_the_processor_works():
    assert working_providers()[CPU] is True


def test_a_silent_fall_back_to_the_processor_is_a_warning(with_cuda, caplog):
    with caplog.at_level(logging.WARNING, "siamloc"):
        session = session_of("network.onnx", providers=None)
    assert session.given == [CUDA, CPU], "the processor last, and no provider that nobody asked for"
    assert f"{CUDA} does not work here, and {CPU} computes instead" in caplog.text
    assert working_providers() == {CUDA: False, CPU: True}


def test_who_asks_for_the_processor_is_not_warned(with_cuda, caplog):
    assert session_of("network.onnx", providers=(CPU,)).given == [CPU]
    assert not caplog.records


def test_unknown_providers_and_other_files_are_one_sentence(tmp_path):
    with pytest.raises(ConfigError, match="no provider 'CUDA'"):
        session_of("network.onnx", providers=("CUDA",))
    (tmp_path / "network.onnx").write_bytes(b"no network")
    with pytest.raises(FormatError, match="not an ONNX file"):
        session_of(tmp_path / "network.onnx", providers=None)
