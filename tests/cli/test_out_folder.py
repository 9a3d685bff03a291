import re
from itertools import combinations
from pathlib import Path

import pytest
from typer.testing import CliRunner

from trocar.cli import app
from trocar.cli.collect import collect
from trocar.cli.out_folder import LONGEST_NAME, check_out_folder, default_folder, differing
from trocar.errors import TrocarError
from trocar.eval.config import RunConfig
from trocar.files.output import PICTURE, write_json
from trocar.lab import station_text
from trocar.tasks.peg_transfer.task import PegTransfer

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


OWN_PLANNER = str(Path(__file__).parents[2] / "examples" / "own_planner.py")
CHANGES = [
    {"method": "best"},
    {"method": "uncalibrated"},
    {"model": "lstm"},
    {"calibration": "joints"},
    {"prior": "fleet"},
    {"planner": "optimal"},
    {"seed": 7},
    {"new_session": True},
    {"new_session": True, "refit_offsets": True},
    {"flawless_camera": True},
    {"difficulty": "mild"},
    {"flaws": ("jaw=1deg",)},
    {"flaws": ("jaw=1deg", "tool=.1mm")},
    {"plugins": (OWN_PLANNER,)},
    {"task": PegTransfer(variant="handover")},
    {"task": PegTransfer(transfers=3)},
    {"task": PegTransfer(budget_s=90.0)},
]


def folder_of(**changes):
    config = RunConfig(**{"task": PegTransfer(), **changes})
    return default_folder(f"{config.task.name}-{config.method}-{config.seed}", config.unusual), config.fingerprint


def test_runs_that_differ_have_different_default_folders_and_the_usual_one_has_a_short_name(tmp_path):
    stations = []
    for lab in ("one", "another"):
        stations.append(tmp_path / lab / "mine.toml")
        stations[-1].parent.mkdir()
        stations[-1].write_text(station_text("peg-transfer") + f"# {lab}\n")
    usual = folder_of()
    assert usual[0] == Path("out/peg-transfer-calibrated-0")
    made = [usual, *(folder_of(**change) for change in [*CHANGES, *({"station": str(path)} for path in stations)])]
    assert len({fingerprint for _, fingerprint in made}) == len(made), "the changes are changes"
    for (one, _), (other, _) in combinations(made, 2):
        assert one != other


def test_what_is_said_and_usual_anyway_changes_no_default_folder():
    same = {"planner": "spline", "perception": "depth", "calibration": "images", "station": "peg-transfer"}
    assert folder_of(**same) == folder_of()
    usual = {"planner": "spline", "perception": "depth"}
    assert folder_of(method="uncalibrated", **usual) == folder_of(method="uncalibrated")


def test_a_default_folder_is_named_as_the_command_line_says_it():
    folder, _ = folder_of(task=PegTransfer(variant="bilateral"), method="best", calibration="joints", seed=91)
    assert folder == Path("out/peg-transfer-best-91-calibration-joints-variant-bilateral")


def test_a_default_folder_has_a_name_that_every_disk_takes(tmp_path):
    strange = {"flaw": [f"jaw={n}/{n} deg" for n in range(90)], "plan": {"places": list(range(900))}, "x": tmp_path}
    name = default_folder("run-1", strange).name
    assert len(name) <= LONGEST_NAME + 9
    assert not set(name) & set("/ :*")
    assert name != default_folder("run-1", strange | {"x": tmp_path / "other"}).name


def test_what_differs_from_a_commands_defaults_counts():
    given = {"difficulty": "mild", "rows": 1355, "fit": True, "flaw": None}
    assert differing(collect, given) == {"difficulty": "mild"}


@pytest.mark.parametrize(
    ("line", "opens", "folder"),
    [
        (
            "run suture --difficulty mild --calibration joints --sessions 12 --seed 3",
            "trocar.eval.folder.open_folder",
            "out/suture-calibrated-3-calibration-joints-difficulty-mild",
        ),
        (
            "study peg-transfer --difficulty mild --seed 20 --sessions 4 --methods best",
            "trocar.eval.study.conditions_of",
            "out/study-peg-transfer-20-difficulty-mild",
        ),
        (
            "study debridement --fragments 3 --flaw registration=1mm",
            "trocar.eval.study.conditions_of",
            "out/study-debridement-0-flaw-registration=1mm-fragments-3",
        ),
        (
            "calibrate collect peg-transfer --rows 200 --seed 1",
            "trocar.cli.collect.make_folder",
            "out/calibration-peg-transfer-1-rows-200",
        ),
    ],
)
def test_commands_go_to_their_default_folders(monkeypatch, line, opens, folder):
    class Opened(Exception):
        pass

    def stop(*given, **_):
        raise Opened(next(str(one) for one in given if isinstance(one, Path)))

    monkeypatch.setattr(opens, stop)
    with pytest.raises(Opened, match=f"^{re.escape(folder)}$"):
        CliRunner().invoke(app, line.split(), catch_exceptions=False)
