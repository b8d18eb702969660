from __future__ import annotations

from pathlib import Path

import pytest

from foundation.ordering import by_numbers


@pytest.mark.parametrize(
    "ordered",
    [
        ["lr-1e-05", "lr-2e-05", "lr-0.0001", "lr-0.001", "lr-10.0", "lr-1e+16"],
        ["bins-04", "bins-4", "bins-016", "bins-16"],
        ["3e1.png", "3e12.png", "12e3.png", "12e10.png", "12e99999999999999999999.png"],
        ["1e-99999999999999999999.png", "2.png"],
        ["run1/a.png", "run1/b.png", "run10/a.png"],
    ],
)
def test_paths_are_in_the_order_of_their_numbers(ordered: list[str]) -> None:
    paths = [Path(name) for name in ordered]
    assert sorted(set(paths), key=by_numbers) == paths
