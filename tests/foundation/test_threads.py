import threading
from types import SimpleNamespace

import pytest

from foundation.threads import each, in_order, restored


def test_results_come_in_order_and_only_a_little_ahead():
    taken = []

    def items():
        for number in range(100):
            taken.append(number)
            yield number

    results = in_order(lambda number: -number, items(), threads=2)
    assert next(results) == 0
    assert len(taken) == 9  # four for each thread, and the first
    assert list(results) == [-number for number in range(1, 100)]


def test_an_error_comes_in_its_turn_and_ends_the_work():
    results = in_order(lambda number: 1 / number, [1, 0, *[1] * 100], threads=2)
    assert next(results) == 1
    with pytest.raises(ZeroDivisionError):
        next(results)
    assert list(results) == []


@pytest.mark.parametrize("count", [1, 2, 9])
@pytest.mark.parametrize("threads", [1, 2])
def test_each_uses_as_many_threads_as_it_may_and_for_one_item_none(threads, count):
    used = min(threads, count)
    together = threading.Barrier(used, timeout=30)  # passed only if that many items are worked on at once

    def work(number):
        if number < used:
            together.wait()
        return number, threading.current_thread() is threading.main_thread()

    assert each(work, range(count), threads) == [(number, used == 1) for number in range(count)]


def test_of_blocks_that_overlap_the_last_restores_what_the_first_found():
    owners = [SimpleNamespace(value=1), SimpleNamespace(value=2)]

    def block(which):
        return restored(which, lambda owner: owner.value, lambda owner, value: setattr(owner, "value", value))

    first, second = block(owners), block(owners[1:])
    first.__enter__()
    owners[0].value = owners[1].value = 5
    second.__enter__()
    first.__exit__(None, None, None)
    assert [owner.value for owner in owners] == [1, 5]
    second.__exit__(None, None, None)
    assert [owner.value for owner in owners] == [1, 2]


def test_a_block_that_cannot_begin_changes_nothing_for_the_next():
    owner = SimpleNamespace(value=1)

    def block(owners):
        return restored(owners, lambda one: one.value, lambda one, value: setattr(one, "value", value))

    with pytest.raises(AttributeError), block([owner, object()]):
        pass
    with block([owner, owner]):
        owner.value = 5
    assert owner.value == 1
