"""Numbers from files: what a file claims is checked before it is used."""

import io
import zipfile

import numpy as np
import pytest

from trocar.files.reading import array_of, parsed_json, read_arrays


def npy(array=None, shape=None):
    """Return the bytes of an .npy; with a shape, one that claims it and holds 64 bytes."""
    buffer = io.BytesIO()
    if shape is None:
        np.save(buffer, array, allow_pickle=True)
        return buffer.getvalue()
    np.lib.format.write_array_header_1_0(buffer, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return buffer.getvalue() + bytes(64)


@pytest.mark.parametrize("order", "CF")
def test_an_array_comes_back_as_it_was(order, tmp_path):
    array = np.asarray(np.arange(6.0).reshape(2, 3), order=order)
    np.testing.assert_array_equal(array_of(npy(array)), array)
    np.savez_compressed(tmp_path / "a.npz", a=array)
    np.save(tmp_path / "a.npy", array)
    np.testing.assert_array_equal(read_arrays(tmp_path / "a.npz")["a"], array)
    np.testing.assert_array_equal(read_arrays(tmp_path / "a.npy")[""], array)


@pytest.mark.parametrize(
    "data",
    [
        *(npy(shape=(1 << 20, 1 << 22)), npy(shape=(-1, -8)), npy(np.array([{}], dtype=object)), npy(np.zeros(3))[:-1]),
        *(npy(np.zeros(3)).replace(b"(3,)", b"(3, "), b""),
    ],
    ids=["32 TiB", "negative", "objects", "cut", "open bracket", "empty"],
)
def test_an_array_that_is_not_what_it_claims_is_refused(data, tmp_path):
    with pytest.raises(ValueError):
        array_of(data)
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as file:
        file.writestr("a.npy", data)
    with pytest.raises(ValueError):
        read_arrays(tmp_path / "a.npz")


def test_json_nested_without_end_is_no_json():
    with pytest.raises(ValueError, match="nested too deep"):
        parsed_json("[" * 100_000)
