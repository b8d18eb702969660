import threading

import cv2
import pytest

from analytic.threads import each


@pytest.fixture(params=[1, 2])
def threads(request):
    before = cv2.getNumThreads()
    cv2.setNumThreads(request.param)
    yield request.param
    cv2.setNumThreads(before)


@pytest.mark.parametrize("count", [1, 2, 9])
def test_results_come_in_order_from_as_many_threads_as_are_allowed(threads, count):
    used = min(threads, count)
    together = threading.Barrier(used, timeout=30)  # passed only if that many parts are computed at once

    def part(number):
        if number < used:
            together.wait()
        return number, threading.current_thread() is threading.main_thread()

    assert each(part, list(range(count))) == [(number, used == 1) for number in range(count)]
