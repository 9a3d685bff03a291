"""Point clouds from files: the unit is never guessed, the shape never assumed."""

import numpy as np
import pytest

from trocar.errors import TrocarError
from trocar.perception.capture import load_capture

POINTS = np.arange(12.0).reshape(4, 3)


def saved(folder, **arrays):
    np.savez(folder / "cloud.npz", **arrays)
    return folder / "cloud.npz"


@pytest.mark.parametrize(
    ("name", "unit", "size_m"),
    [
        ("points_mm", None, 1e-3),
        ("points_mm", "mm", 1e-3),
        ("points_m", None, 1.0),
        ("points_m", "m", 1.0),
        ("points", "mm", 1e-3),
        ("points", "m", 1.0),
    ],
)
def test_the_unit_is_told_by_the_arrays_name_or_by_who_asks(tmp_path, name, unit, size_m):
    found = load_capture(saved(tmp_path, **{name: POINTS}), unit)
    np.testing.assert_allclose(found, size_m * POINTS)
    assert found.dtype == np.float64


def test_an_array_beside_the_points_does_no_harm(tmp_path):
    np.testing.assert_allclose(load_capture(saved(tmp_path, colors=POINTS + 1, points_m=POINTS)), POINTS)
    np.testing.assert_allclose(load_capture(saved(tmp_path, points_m=POINTS + 1, points_mm=POINTS)), 1e-3 * POINTS)


@pytest.mark.parametrize("kind", [np.float32, np.int16, np.uint8])
def test_numbers_of_any_kind_are_points(tmp_path, kind):
    np.save(tmp_path / "cloud.npy", POINTS.astype(kind))
    np.testing.assert_allclose(load_capture(str(tmp_path / "cloud.npy"), "m"), POINTS)


@pytest.mark.parametrize(
    ("arrays", "unit", "says"),
    [
        ({"points": POINTS}, None, "does not tell its unit; add --unit mm or --unit m"),
        ({"points": POINTS}, "inch", "unit 'inch' is unknown; choose one of mm, m"),
        ({"points_mm": POINTS}, "m", "holds points_mm, but --unit says 'm'; leave --unit out"),
        ({"a": POINTS, "b": POINTS}, "m", "holds a, b; it needs an array points_mm or points_m"),
        ({}, "m", "holds nothing; it needs"),
        ({"points_m": POINTS.T}, None, r"holds float64 of shape \(3, 4\); it needs numbers of shape \(n, 3\)"),
        ({"points_m": POINTS[0]}, None, r"of shape \(3,\)"),
        ({"points_m": np.zeros((3, 3, 3))}, None, r"of shape \(3, 3, 3\)"),
        ({"points_m": POINTS > 2}, None, "holds bool of shape"),
        ({"points_m": POINTS + 1j}, None, "holds complex128 of shape"),
    ],
)
def test_other_files_are_refused_in_a_sentence(tmp_path, arrays, unit, says):
    with pytest.raises(TrocarError, match=says):
        load_capture(saved(tmp_path, **arrays), unit)


def test_what_is_no_file_of_numbers_is_refused(tmp_path):
    with pytest.raises(TrocarError, match="is a folder; give"):
        load_capture(tmp_path)
    with pytest.raises(TrocarError, match="does not exist; give"):
        load_capture(tmp_path / "none.npz")
    (tmp_path / "broken.npz").write_bytes(b"PK no zip")
    with pytest.raises(TrocarError, match="cannot be read as"):
        load_capture(tmp_path / "broken.npz")
