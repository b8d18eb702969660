import pytest
import torch

import augment
from augment.brushes import paint
from tests.augment.pictures import generator, panoramas


@pytest.fixture
def threads():
    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)


def test_the_number_of_threads_does_not_change_the_pictures(threads):
    policy, batch = augment.policy("strong"), panoramas(13)
    params = policy.draw(generator(), batch)
    threads(1)
    alone = policy.apply(batch, params)
    threads(3)
    assert torch.equal(policy.apply(batch, params), alone)


def test_an_error_in_a_thread_reaches_the_caller(threads):
    threads(2)

    def fail(frame):
        raise RuntimeError("broken brush")

    with pytest.raises(RuntimeError, match="broken brush"):
        paint(panoramas(2).numpy(), [[], [fail]])
