"""Tables of numbers: a mistake is found where an editor shows it, and only what is a number counts."""

import numpy as np
import pytest

from trocar.errors import InvalidInput
from trocar.files.csv_file import read_csv


def test_numbers_come_back_and_empty_cells_are_missing(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t_s,q1\n0,1.5\n\n1, \n", encoding="utf-8-sig")
    names, numbers = read_csv(path, "t_s,q1")
    assert names == ["t_s", "q1"]
    np.testing.assert_array_equal(numbers, [[0.0, 1.5], [1.0, np.nan]])


@pytest.mark.parametrize("wrong", ["1_0", "abc", "inf"])
def test_a_cell_that_is_no_number_is_named_by_its_row_in_the_file_empty_ones_counted(wrong, tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(f"t_s,q1\n0,1\n\n\n1,{wrong}\n")
    with pytest.raises(InvalidInput, match=f"row 5 .* holds '{wrong}' under 'q1'"):
        read_csv(path, "t_s,q1")
    path.write_text("t_s,q1\n\n0,1,2\n")
    with pytest.raises(InvalidInput, match=r"row 3 .* has 3 cells, not 2"):
        read_csv(path, "t_s,q1")
