"""The pretended GPU notices what a GPU would mind."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tests.gpu.pretend import NAME


def here():
    return torch.arange(6.0).view(2, 3)


def there():
    return here().to(NAME, non_blocking=True)


def test_a_mixing_of_devices_is_an_error(gpu):
    assert torch.equal((there() + torch.tensor(2.0)).cpu(), here() + 2)  # as CUDA permits
    for mixed in (lambda: there() + here(), lambda: torch.cat([there(), here()]), lambda: there().add_(here())):
        with pytest.raises(RuntimeError, match=r"tensors on two devices .* at tests/gpu/test_pretend\.py:\d+"):
            mixed()
    with pytest.raises(RuntimeError, match="numpy"):
        np.asarray(there())


WAITING = {
    "a number is read": lambda: there().sum().item(),
    "a number decides": lambda: bool(there().any()),
    "what is true is counted": lambda: there()[there() > 2],
    "a copy to main memory": lambda: there().cpu(),
    "one that only claims not to wait": lambda: there().to("cpu", non_blocking=True),
    "a blocking copy to the device": lambda: here().to(NAME),
    "a tensor is made on the device": lambda: torch.tensor([1.0, 2.0], device=NAME),
    "an index in main memory": lambda: there()[torch.tensor([1])],
}


@pytest.mark.parametrize("wait", WAITING.values(), ids=WAITING)
def test_a_wait_is_recorded_with_its_line(gpu, wait):
    wait()
    ((where, count),) = gpu.waits.items()
    assert count == 1
    assert where.endswith(f"at tests/gpu/test_pretend.py:{wait.__code__.co_firstlineno}")


def test_work_that_goes_on_is_no_wait(gpu):
    values = here().pin_memory().to(NAME, non_blocking=True)
    values = values.index_select(1, torch.zeros(1, device=NAME, dtype=torch.int64)).where(values > 1, 0.0)
    torch.empty(2, 3, pin_memory=True).copy_(values, non_blocking=True)
    assert not gpu.waits
    assert sorted(where.partition(" at ")[0] for where in gpu.copies) == ["copy from pinned memory", "copy to the host"]


def test_autocast_is_that_of_cuda(gpu):
    with torch.autocast(NAME, dtype=torch.bfloat16):
        product = there() @ there().T
        assert product.dtype == torch.bfloat16
        assert product.softmax(1).dtype == torch.float32
        assert product.relu().dtype == torch.bfloat16
