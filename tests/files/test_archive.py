"""Files with a header, arrays and blobs: what is written is read again, what is not ours is refused."""

import json
import struct
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from trocar.errors import TrocarError
from trocar.files.archive import Archive, read_archive, read_header

KIND, VERSION = "a test's file", 3


def archive(**arrays):
    return Archive({"format": KIND, "version": VERSION, "note": "x"}, arrays, {"a.bin": b"\x00\x01"})


@settings(max_examples=40, deadline=None)
@given(
    array=hnp.arrays(
        st.sampled_from([np.float32, np.float64, np.int64, np.uint8, np.bool_]),
        hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=5),
    )
)
def test_arrays_come_back_as_they_were(tmp_path_factory, array):
    path = archive(values=array).save(tmp_path_factory.mktemp("archive") / "x.npz")
    found = read_archive(path, KIND, VERSION)
    assert found.arrays["values"].dtype == array.dtype and found.arrays["values"].shape == array.shape
    assert np.array_equal(found.arrays["values"], array, equal_nan=array.dtype.kind == "f")
    assert found.blobs == {"a.bin": b"\x00\x01"}
    assert found.header["note"] == "x"


def test_the_same_content_is_the_same_bytes(tmp_path):
    first = archive(values=np.arange(9.0)).save(tmp_path / "1.npz").read_bytes()
    assert archive(values=np.arange(9.0)).save(tmp_path / "2.npz").read_bytes() == first


def test_the_header_is_read_by_itself(tmp_path):
    path = archive(values=np.zeros((1000, 1000))).save(tmp_path / "x.npz")
    data = bytearray(path.read_bytes())
    assert read_header(path, KIND, VERSION)["note"] == "x"
    with zipfile.ZipFile(path) as file:
        assert file.namelist()[0] == "header.json"
    assert len(data) < 20_000


def test_a_write_that_fails_leaves_the_old_file_and_no_draft(tmp_path):
    path = archive(values=np.zeros(3)).save(tmp_path / "x.npz")
    before = path.read_bytes()
    with pytest.raises(ValueError, match="pickle"):
        Archive({"format": KIND, "version": VERSION}, {"bad": np.array([object()])}).save(path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["x.npz"]


def test_a_folder_that_is_not_there_is_a_sentence(tmp_path):
    with pytest.raises(TrocarError, match=r"cannot write .*No such file"):
        archive().save(tmp_path / "nowhere" / "x.npz")


def strangers(folder):
    """Files that are not ours, or not any more."""
    good = archive(values=np.arange(2000.0)).save(folder / "good.npz").read_bytes()

    def written(name, data):
        (folder / name).write_bytes(data)
        return folder / name

    yield written("empty.npz", b"")
    yield written("text.npz", b"not a zip at all")
    for share in (0.2, 0.6, 0.95):
        yield written(f"cut{share}.npz", good[: int(share * len(good))])
    spoiled = bytearray(good)
    spoiled[len(good) // 2] ^= 0xFF
    yield written("spoiled.npz", bytes(spoiled))
    np.savez(folder / "other.npz", values=np.zeros(3))
    yield folder / "other.npz"
    for name, header in {
        "kind": {"format": "another", "version": VERSION},
        "version": {"format": KIND, "version": 99},
        "list": [1, 2],
        "deep": None,
    }.items():
        text = "[" * 100_000 if header is None else json.dumps(header)
        with zipfile.ZipFile(folder / f"{name}.npz", "w") as file:
            file.writestr("header.json", text)
        yield folder / f"{name}.npz"


def test_strangers_and_damaged_files_are_a_sentence_each(tmp_path):
    for path in strangers(tmp_path):
        with pytest.raises(TrocarError, match=path.name):
            read_archive(path, KIND, VERSION)


def test_an_array_that_claims_terabytes_is_not_believed(tmp_path):
    """A header of .npy that claims 22 TiB, in a file of some hundred bytes."""
    head = "{'descr': '<f8', 'fortran_order': False, 'shape': (3000000000000,), }"
    head = head.ljust(117) + "\n"
    claim = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head.encode() + b"\0" * 8
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("header.json", json.dumps({"format": KIND, "version": VERSION}))
        file.writestr("values.npy", claim)
    with pytest.raises(TrocarError, match=r"damaged at 'values\.npy'"):
        read_archive(path, KIND, VERSION)


def test_a_zip_bomb_is_refused_before_it_is_unpacked(tmp_path, monkeypatch):
    monkeypatch.setattr("trocar.files.archive.MAX_BYTES", 64 << 20)
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as file:
        file.writestr("header.json", json.dumps({"format": KIND, "version": VERSION}))
        with file.open("values.npy", "w", force_zip64=True) as member:
            for _ in range(5):
                member.write(b"\0" * (16 << 20))
    assert path.stat().st_size < 1 << 20
    with pytest.raises(TrocarError, match="claims to unpack to more than"):
        read_archive(path, KIND, VERSION)


def test_pickles_are_not_loaded(tmp_path):
    path = tmp_path / "pickle.npz"
    np.save(tmp_path / "evil.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("header.json", json.dumps({"format": KIND, "version": VERSION}))
        file.write(tmp_path / "evil.npy", "values.npy")
    with pytest.raises(TrocarError, match="damaged"):
        read_archive(path, KIND, VERSION)
