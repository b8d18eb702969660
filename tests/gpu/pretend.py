"""A pretended GPU, which shows without one what a GPU would mind.

    with Pretend() as gpu:
        images = images.to("pretend", non_blocking=True)
        ...
    assert not gpu.waits

Its tensors are computed on the CPU. As CUDA does, it refuses to mix tensors of two devices and to read a tensor as an
array, chooses the precision of operations under autocast, and convolves in TF32 unless this is switched off. Every wait
of the host is recorded, and so is every transfer, with the line that caused it. Kernels that CUDA lacks, memory, time
and randomness on the device remain unknown, and code that asks for `device.type == "cuda"` takes its other branch.
"""

from __future__ import annotations

import sys
from collections import Counter
from contextlib import ExitStack, nullcontext
from functools import cache
from pathlib import Path
from unittest import mock

import pytest
import torch
from torch import Tensor
from torch.utils import backend_registration
from torch.utils._python_dispatch import TorchDispatchMode

if not hasattr(backend_registration, "_setup_privateuseone_for_python_backend"):
    pytest.skip("this version of torch takes no devices that are written in Python", allow_module_level=True)

NAME = "pretend"
ROOT = f"{Path(__file__).parents[2]}/"
aten = torch.ops.aten

_WAITS = (
    "_local_scalar_dense nonzero masked_select argwhere equal is_nonzero bincount _linalg_check_errors "
    "_unique2 unique_dim unique_consecutive"
)
_COPIES = (aten._to_copy, aten.copy_, aten._copy_from, aten.copy)
_INDEXED = (aten.index, aten.index_put, aten.index_put_, aten._index_put_impl_, aten._unsafe_index)
_CONVOLUTIONS = (aten.convolution, aten.convolution_backward)
# What CUDA computes in half and in full precision under autocast.
_HALF = "conv1d conv2d conv3d addmm addmv addr matmul mm mv bmm baddbmm addbmm linear einsum"
_FULL = (
    "acos asin cosh erfinv exp expm1 log log10 log2 log1p reciprocal rsqrt sinh tan pow.Tensor_Scalar "
    "pow.Tensor_Tensor pow.Scalar softplus layer_norm group_norm cosine_similarity nll_loss smooth_l1_loss mse_loss "
    "binary_cross_entropy_with_logits dist pdist cdist renorm logsumexp prod softmax.int log_softmax.int cumprod "
    "cumsum sum sum.dim_IntList norm.Scalar norm.ScalarOpt_dim"
)


class PretendTensor(torch.Tensor):
    """A tensor that says that it is on the device; its numbers are in `held`, in main memory."""

    held: Tensor
    __torch_function__ = torch._C._disabled_torch_function_impl
    is_cuda = True

    @staticmethod
    def __new__(cls, held):
        layout = {"strides": held.stride(), "storage_offset": held.storage_offset(), "dtype": held.dtype}
        made = torch.Tensor._make_wrapper_subclass(cls, held.shape, **layout, device=torch.device(NAME, 0))
        made.held = held
        return made

    def __reduce_ex__(self, protocol):
        return self.held.detach().clone().__reduce_ex__(protocol)  # a checkpoint is read on the CPU

    def __repr__(self, **_):
        return f"pretend({self.held!r})"

    @classmethod
    def __torch_dispatch__(cls, func, types, args=(), kwargs=None):
        return (_current[-1] if _current else Pretend()).run(func, args, kwargs or {})


class Pretend(TorchDispatchMode):
    """Offer the device, and record what happens there.

    Attributes:
        waits: how often the host waited for the device, by "reason at file:line".
        copies: transfers without a wait, by "kind at file:line".
        operations: kernels to launch, roughly, by name.
    """

    def __init__(self):
        super().__init__()
        self.waits, self.copies, self.operations = Counter(), Counter(), Counter()

    def __enter__(self):
        _register()
        self._undo = ExitStack()
        change = self._undo.enter_context
        change(mock.patch("torch.cuda.Event", _Event))
        change(mock.patch("torch.cuda.current_stream", return_value=None))
        change(mock.patch.object(torch.Tensor, "pin_memory", lambda values, *_: pinned(values)))
        # Otherwise autograd would want a thread of the device, which there is only if the device came before autograd.
        change(torch.autograd.set_multithreading_enabled(False))
        self._undo.callback(torch._C._set_only_lift_cpu_tensors, torch._C._only_lift_cpu_tensors())
        torch._C._set_only_lift_cpu_tensors(True)  # `torch.tensor(..., device=...)` shows its transfer
        _current.append(self)
        return super().__enter__()

    def __exit__(self, *raised):
        super().__exit__(*raised)
        _current.remove(self)
        self._undo.close()

    @classmethod
    def _should_skip_dynamo(cls):
        return False  # torch would wrap each call otherwise, which takes longer than the operations

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        return self.run(func, args, kwargs or {})

    def clear(self):
        for record in (self.waits, self.copies, self.operations):
            record.clear()

    def run(self, func, args, kwargs):
        """Run an operation on tensors of any device."""
        given = [*_leaves(args), *_leaves(tuple(kwargs.values()))]
        here = [value for value in given if isinstance(value, PretendTensor)]
        wanted = next((value.type for value in given if isinstance(value, torch.device)), None)
        if not here and wanted != NAME:
            pin = kwargs.get("pin_memory")
            found = func(*args, **{**kwargs, "pin_memory": False} if pin else kwargs)
            return pinned(found) if pin else found
        packet = func.overloadpacket
        if _composed(func):
            with self._again():  # in inference mode, composed operations arrive whole
                found = func.decompose(*args, **kwargs)
            if found is not NotImplemented:
                return found
        fetched = False
        if packet in _COPIES:
            fetched = self._transfer(packet, args, kwargs, wanted)
        else:
            _check_devices(func, args, given, here)
            self._note(func, args, kwargs)
        args_on_cpu = _mapped(_on_cpu, args)
        kwargs_on_cpu = {name: _mapped(_on_cpu, value) for name, value in kwargs.items() if name != "pin_memory"}
        if packet in _CONVOLUTIONS and torch.backends.cudnn.allow_tf32:
            args_on_cpu = _mapped(_as_tf32, args_on_cpu)
        with torch.inference_mode(False) if torch.is_inference_mode_enabled() else nullcontext():
            found = func(*args_on_cpu, **kwargs_on_cpu)
            if fetched:
                return args[0] if packet is aten.copy_ else found
            known = {id(tensor.held): tensor for tensor in here}  # of operations in place
            return _mapped(lambda value: _on_device(value, known), found)

    def _again(self):
        """Record operations within one, too."""
        stack = ExitStack()
        TorchDispatchMode.__enter__(self)
        stack.push(lambda *raised: TorchDispatchMode.__exit__(self, *raised))
        return stack

    def _transfer(self, packet, args, kwargs, wanted):
        """Record a transfer between the devices, and return whether it goes to main memory."""
        if packet is aten._to_copy:
            source, target, eager = args[0], None, kwargs.get("non_blocking", False)
            to = wanted or source.device.type
        else:
            target, source = args[:2]
            to, eager = target.device.type, args[2] if len(args) > 2 else kwargs.get("non_blocking", False)
        if source.device.type == to:
            self.operations[str(packet)] += 1
        elif to == "cpu":
            free = eager and hasattr(target, "pinned")
            (self.copies if free else self.waits)[f"copy to the host at {_line()}"] += 1
        else:
            kind = "copy from pinned memory" if hasattr(source, "pinned") else "copy to the device"
            (self.copies if eager else self.waits)[f"{kind} at {_line()}"] += 1
        return to == "cpu"

    def _note(self, func, args, kwargs):
        """Record an operation that is no transfer, and whether it waits."""
        name, launches, waits = _kind(func)
        if launches:
            self.operations[name] += 1
        if name == "repeat_interleave":
            waits = kwargs.get("output_size") is None
        if func.overloadpacket in _INDEXED:
            indices = [index for index in args[1] if index is not None]
            waits = any(index.dtype in (torch.bool, torch.uint8) or index.device.type == "cpu" for index in indices)
        if waits:
            self.waits[f"{name} at {_line()}"] += 1


@cache
def _kind(func):
    """Return the name of an operation, whether it launches a kernel, and whether it always waits."""
    name = str(func.overloadpacket).removeprefix("aten.")
    view = any(part.alias_info and not part.alias_info.is_write for part in func._schema.returns)
    nothing = view or name in ("_unsafe_view", "_reshape_alias") or "empty" in name
    return name, not nothing, name in _WAITS.split()


@cache
def _composed(func):
    return torch._C._dispatch_has_kernel_for_dispatch_key(func.name(), "CompositeImplicitAutograd")


_current = []
_libraries = []  # torch forgets what a library adds once the library is gone


def pinned(values):
    """Copy a tensor to memory that is said to be pinned."""
    if isinstance(values, PretendTensor):
        raise RuntimeError("a tensor on the device cannot be pinned")
    values = values.clone()
    values.pinned = True
    return values


def _check_devices(func, args, given, here):
    """Raise RuntimeError for tensors in main memory next to those on the device, except for numbers and indices."""
    tensors = [value for value in given if isinstance(value, Tensor)]
    others = [tensor for tensor in tensors if not isinstance(tensor, PretendTensor) and tensor.ndim]
    if func.overloadpacket in _INDEXED:
        others = [tensor for tensor in others if not any(tensor is index for index in args[1])]
    if here and others:
        shapes = ", ".join(f"{tuple(tensor.shape)} on {tensor.device}" for tensor in tensors)
        raise RuntimeError(f"{func} got tensors on two devices ({shapes}) at {_line()}")


def _leaves(values):
    return [leaf for value in values for leaf in (_leaves(value) if isinstance(value, list | tuple) else (value,))]


def _mapped(change, value):
    if isinstance(value, list | tuple):
        return type(value)([_mapped(change, part) for part in value])
    return change(value)


def _on_cpu(value):
    if isinstance(value, PretendTensor):
        return value.held
    return torch.device("cpu") if isinstance(value, torch.device) and value.type == NAME else value


def _on_device(value, known):
    if not isinstance(value, Tensor) or isinstance(value, PretendTensor):
        return value
    before = known.get(id(value))
    return before if before is not None and before.shape == value.shape else PretendTensor(value)


def _as_tf32(value):
    """Round float32 to the 10 bits that TF32 keeps of the mantissa."""
    if not isinstance(value, Tensor) or value.dtype != torch.float32 or value.ndim < 2:
        return value
    bits = value.contiguous().view(torch.int32)
    return ((bits + 0x0FFF + ((bits >> 13) & 1)) & ~0x1FFF).view(torch.float32)


def _line():
    """Return the innermost line of the project that leads here; of the caller's libraries if there is none."""
    frame, other = sys._getframe(1), ""
    while frame is not None:
        name = frame.f_code.co_filename
        if name.startswith(ROOT) and "site-packages" not in name and name != __file__:
            return f"{name.removeprefix(ROOT)}:{frame.f_lineno}"
        if not other and "/lightning/" in name:
            other = f"{name.partition('/site-packages/')[2]}:{frame.f_lineno}"
        frame = frame.f_back
    return other


class _Event:
    """A CUDA event that has always happened."""

    def __init__(self, **_): ...
    def record(self, *_): ...
    def synchronize(self): ...
    def elapsed_time(self, _):
        return 1.0


def _register():
    """Make the device known to torch, for which it exists only within `Pretend`."""
    if _libraries:
        return

    class Module(backend_registration._DummyBackendModule):
        def is_available(self):
            return bool(_current)

        def get_amp_supported_dtype(self):
            return [torch.bfloat16, torch.float16]

    class Hook(backend_registration._DummyPrivateUse1Hook):
        def is_available(self):
            return bool(_current)

    torch.zeros(1, requires_grad=True).sum().backward()  # autograd counts devices once, and starts threads for them
    backend_registration._setup_privateuseone_for_python_backend(NAME, Module(), Hook())
    others, library = torch.library.Library("_", "IMPL"), torch.library.Library("aten", "IMPL")
    _libraries.extend([others, library])
    others.fallback(torch.library.fallthrough_kernel, "AutocastPrivateUse1")
    for names, full in ((_HALF, False), (_FULL, True)):
        for name in names.split():
            packet, _, overload = name.partition(".")
            target = getattr(getattr(aten, packet), overload or "default")
            library.impl(name, _autocast(target, full), "AutocastPrivateUse1")


def _autocast(target, full):
    """Return an operation that converts what it gets as CUDA does under autocast."""
    key = torch._C.DispatchKeySet(torch._C.DispatchKey.AutocastPrivateUse1)

    def call(*args, **kwargs):
        wanted = torch.float32 if full else torch.get_autocast_dtype(NAME)

        def converted(value):
            floating = isinstance(value, PretendTensor) and value.is_floating_point() and value.dtype != torch.float64
            return value.to(wanted) if floating and value.dtype != wanted else value

        with torch._C._ExcludeDispatchKeyGuard(key):
            return target(*_mapped(converted, args), **{name: converted(value) for name, value in kwargs.items()})

    return call
