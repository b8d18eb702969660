import multiprocessing

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


def darkened(frame):
    frame -= 1


def work(queue, frames):
    paint(frames, [[darkened]] * len(frames))
    queue.put(int(frames.sum()))


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="no fork on this system")
@pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork:DeprecationWarning")
def test_a_forked_process_does_not_wait_for_the_threads_of_its_parent(threads):
    threads(2)
    frames = torch.full((6, 3, 4, 4), 100, dtype=torch.uint8).numpy()
    paint(frames, [[darkened]] * 6)
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    process = context.Process(target=work, args=(queue, frames), daemon=True)
    process.start()
    try:
        assert queue.get(timeout=20) == 98 * frames.size
    finally:
        process.kill()
        process.join()
