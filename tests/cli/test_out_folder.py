import pytest

from trocar.cli.out_folder import check_out_folder
from trocar.errors import TrocarError
from trocar.output import PICTURE, write_json

FILES = {"plan.json": "plan"}


def test_a_folder_that_can_be_made_is_not_left_behind(tmp_path):
    check_out_folder(tmp_path / "new" / "inside", FILES)
    assert list(tmp_path.iterdir()) == []
    check_out_folder(None, FILES)


def test_what_is_there_stays(tmp_path):
    old = write_json(tmp_path / "plan.json", {"old": 1}, "plan").read_text()
    check_out_folder(tmp_path, FILES)
    assert (tmp_path / "plan.json").read_text() == old
    with pytest.raises(TrocarError, match="is read"):
        check_out_folder(tmp_path, FILES, [tmp_path / "plan.json"])
    (tmp_path / "plan.json").write_text("somebody else's")
    with pytest.raises(TrocarError, match="not a plan that Trocar wrote"):
        check_out_folder(tmp_path, FILES)


def test_a_file_a_path_below_one_and_folders_in_the_way_are_refused(tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "plan.png").mkdir()
    for out, words in (
        (tmp_path / "file", "is a file"),
        (tmp_path / "file" / "x", "cannot be made"),
        (tmp_path, "png"),
    ):
        with pytest.raises(TrocarError, match=words):
            check_out_folder(out, {**FILES, "plan.png": PICTURE})
