import pytest

from foundation.threads import in_order


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
