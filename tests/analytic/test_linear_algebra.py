from threading import Event, Thread

import pytest

from analytic import linear_algebra
from analytic.linear_algebra import _controller, one_thread


def counts():
    return {library.get_num_threads() for library in _controller().lib_controllers if library.user_api == "blas"}


@pytest.fixture(autouse=True)
def two_threads():
    with _controller().limit(limits=2, user_api="blas"):
        if counts() != {2}:
            pytest.skip("needs a linear algebra library whose number of threads can be set")
        yield


def test_one_thread_inside_and_as_many_as_before_afterwards():
    with one_thread():
        assert counts() == {1}
        with one_thread():
            assert counts() == {1}
        assert counts() == {1}
    assert counts() == {2}


def test_a_failure_inside_takes_the_setting_back():
    with pytest.raises(MemoryError), one_thread():
        raise MemoryError
    assert counts() == {2}


def test_mappers_in_threads_of_their_own_work_one_at_a_time():
    inside, leave = Event(), Event()

    def work():
        with one_thread():
            inside.set()
            leave.wait(10)

    other = Thread(target=work)
    other.start()
    assert inside.wait(10)
    assert not linear_algebra._LOCK.acquire(blocking=False)
    leave.set()
    with one_thread():
        assert counts() == {1}
    other.join(10)
    assert counts() == {2}
