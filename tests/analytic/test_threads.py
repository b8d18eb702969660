import threading

import pytest
import torch

from analytic.threads import each


@pytest.fixture
def two_threads():
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


@pytest.mark.parametrize("count", [1, 2, 9])
def test_results_come_in_order_each_by_one_thread(two_threads, count):
    seen = each(lambda part: (part, torch.get_num_threads()), list(range(count)))
    assert seen == [(part, 1) for part in range(count)]


def test_the_setting_of_the_program_stays(two_threads):
    each(lambda part: part, [1, 2, 3])
    each(lambda part: part, [1])
    found = []
    later = threading.Thread(target=lambda: found.append(torch.get_num_threads()))
    later.start()
    later.join()
    assert (torch.get_num_threads(), found) == (2, [2])


@pytest.mark.parametrize("count", [1, 3])
def test_errors_come_through(two_threads, count):
    def fail(part):
        raise ValueError(f"part {part}")

    with pytest.raises(ValueError, match="part 0"):
        each(fail, list(range(count)))
    assert torch.get_num_threads() == 2
