import resource

import numpy as np
import pytest

from siamloc.memory import _glibc, kept_memory


def faults_of_a_large_array() -> int:
    """Count the pages that the system allocates for an array of 64 MB."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    np.full(2**26, 1, dtype=np.uint8)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


@pytest.mark.skipif(_glibc() is None, reason="another C library than glibc")
def test_pages_are_asked_for_once_while_memory_is_kept():
    usual = min(faults_of_a_large_array() for _ in range(2))
    with kept_memory():
        faults_of_a_large_array()
        kept = faults_of_a_large_array()
    afterwards = min(faults_of_a_large_array() for _ in range(2))
    assert kept <= usual / 4  # none of the 16,384 pages again, or few where the system uses huge ones
    assert afterwards >= usual / 2
