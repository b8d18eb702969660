"""Arrays in a file that may have been altered: what they claim must exist, and nothing in them is executed."""

from __future__ import annotations

import io
import zipfile

import numpy as np
import pytest

from foundation.arrays import DAMAGE, read_arrays


def file_of(path, **members: bytes):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return path


def content_of(array, **options) -> bytes:
    held = io.BytesIO()
    np.lib.format.write_array(held, np.asarray(array), **options)
    return held.getvalue()


def test_it_reads_what_numpy_wrote(tmp_path):
    arrays = {
        "numbers": np.arange(12.0).reshape(3, 4),
        "columns": np.asfortranarray(np.arange(6).reshape(2, 3)),
        "texts": np.array(["office", "hall"]),
        "one": np.array("header"),
        "none": np.empty((0, 5)),
    }
    for save in (np.savez, np.savez_compressed):
        save(tmp_path / "a.npz", **arrays)
        found = read_arrays(tmp_path / "a.npz")
        assert set(found) == set(arrays)
        for name, array in arrays.items():
            np.testing.assert_array_equal(found[name], array)
            assert found[name].dtype == array.dtype
            assert found[name].flags.writeable


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (content_of(np.zeros(3)).replace(b"(3,)", b"(9,)"), "claims 72 bytes, but there are 24"),
        (content_of(np.zeros(3)).replace(b"(3,), }         ", b"(1000000000000,)"), "SyntaxError|claims|header|EOF"),
        (content_of(np.zeros(3)).replace(b"(3,)", b"(-3)"), "shape"),
        (content_of(np.array([{}], dtype=object), allow_pickle=True), "objects, which may be programs"),
        (content_of(np.zeros(3))[:-8], "claims 24 bytes, but there are 16"),
        (b"", "EOF|magic"),
    ],
)
def test_what_does_not_hold_what_it_claims_is_refused(tmp_path, content, says):
    with pytest.raises(DAMAGE, match=says):
        read_arrays(file_of(tmp_path / "a.npz", a=content))


def test_zeros_that_were_compressed_too_well_are_refused(tmp_path):
    path = file_of(tmp_path / "a.npz", **{f"a{n}": content_of(np.zeros(2_000_000)) for n in range(9)})
    assert path.stat().st_size < 200_000
    with pytest.raises(ValueError, match="far too long for a file of its length"):
        read_arrays(path)


def test_a_name_twice_is_refused(tmp_path):
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.npy", content_of(np.zeros(1)))
        with pytest.warns(UserWarning, match="Duplicate name"):
            archive.writestr("a.npy", content_of(np.ones(1)))
    with pytest.raises(ValueError, match="or appears twice"):
        read_arrays(path)
