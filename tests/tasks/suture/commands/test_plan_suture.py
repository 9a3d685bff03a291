import json
import subprocess
import sys

import matplotlib.image
import numpy as np
import pytest

WRIST = ("roll_deg", "wrist_pitch_deg", "wrist_yaw_deg")
WRIST_TITLES = ["roll left, deg", "wrist pitch left, deg", "wrist yaw left, deg"]


@pytest.fixture
def plan(trocar):
    return lambda line="": trocar("plan", "suture", *line.split())


@pytest.fixture
def answer(plan):
    def ask(line=""):
        code, out, err = plan(f"{line} --json")
        assert err == ""
        assert code == 0
        assert out.count("\n") == 1
        return json.loads(out)

    return ask


def test_json_has_the_promised_keys_and_they_agree(answer):
    found = answer()
    assert np.diff(found["positions_deg"]) == pytest.approx([90, 90, 90])
    assert set(found["directions"]) <= {1, -1}
    assert found["reward"] == min(found["rewards"]) == found["bound"]
    assert found["feasible"] is True
    assert 0 < found["compute_ms"] < 5000
    assert "surrogate" in found["manipulability_source"]
    assert "table" not in found
    for name, direction in zip(found["direction_names"], found["directions"], strict=True):
        assert name == {1: "clockwise", -1: "counterclockwise"}[direction]
    assert all(left > 0 for row in found["joint_room"] for left in row.values())


def test_the_paper_demo_has_its_table_near_the_papers(answer):
    found = answer("--preset paper-demo")
    for location, row in found["paper_table"].items():
        for allowed, printed in row.items():
            assert found["table"][location][allowed] == pytest.approx(printed, abs=4)
    assert found["switches_deg"] == pytest.approx([67, 228], abs=5)
    thirds = answer("--preset paper-demo --count 3 --positions 90")
    assert "table" not in thirds, "whose plans of 4 sutures need a multiple of 4 positions"


def test_wider_gaps_are_never_worse_and_any_angles_neither(answer):
    even, gaps = answer(), answer("--min-gap-deg 75 --max-gap-deg 105")
    anywhere = answer("--min-gap-deg 75 --max-gap-deg 105 --continuous")
    assert all(75 <= gap <= 105 for gap in gaps["gaps_deg"])
    assert even["reward"] < gaps["reward"] <= anywhere["reward"] < gaps["reward"] + 2e-3
    assert anywhere["bound"] is None and "nothing is proven" in anywhere["certified"]


def test_fixed_and_forbidden_places_are_kept(answer):
    found = answer("--fix-deg 90 --forbid-deg 170:190 --forbid-deg 350:10 --min-gap-deg 60 --max-gap-deg 120 --count 5")
    assert 90 in found["positions_deg"]
    assert not [theta for theta in found["positions_deg"] if 170 < theta < 190 or theta > 350 or theta < 10]
    assert len(found["positions_deg"]) == 5


def test_demonstrations_change_the_manipulability_and_are_named(answer):
    found = answer("--demonstrations synthetic")
    assert "surrogate" not in found["manipulability_source"]
    assert "synthetic" in found["manipulability_source"]
    assert found["rewards"] != answer()["rewards"]


def test_options_change_what_they_name(answer):
    assert answer("--margin clipped --weight 0.5")["weight"] == 0.5
    nearer, farther = answer("--circle-radius-mm 20"), answer("--circle-radius-mm 45")
    assert nearer["reward"] != farther["reward"]
    turned = answer("--preset paper-demo --base-azimuth-deg 226")
    plain = answer("--preset paper-demo")
    shift = np.subtract(turned["switches_deg"], plain["switches_deg"])
    assert shift == pytest.approx([1, 1]), "base and circle's centre turned by 1 deg: all plans turn with it"


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("--circle-radius-mm 90 --count 12", ["168 to 211 deg", "joint 'pitch'", "-61.5 deg", "8.5 deg beyond"]),
        ("--base-up-mm 20 --base-sideways-mm 20", ["mm less than the safe depth of 45 mm"]),
        ("--base-up-mm 400", ["all positions", "joint 'insertion'", "mm beyond its limit of 240 mm"]),
    ],
)
def test_a_circle_out_of_reach_is_code_1_and_says_where_which_joint_and_by_how_much(plan, line, words):
    code, out, err = plan(f"{line} --json")
    assert code == 1
    found = json.loads(out, parse_constant=lambda text: pytest.fail(f"{text} is not JSON"))
    assert found["feasible"] is False
    assert err == f"trocar: {found['problem']}\n"
    for part in words:
        assert part in err


def test_what_no_arm_reaches_is_drawn_and_saved_nevertheless(plan, tmp_path):
    code, out, err = plan(f"--arm raven2-left --out {tmp_path}/out")
    assert code == 1 and "out of reach" in err
    assert "bound of worst infeasible sutures" in out and "worst infeasible" not in plan()[1]
    assert json.loads((tmp_path / "out" / "plan.json").read_text())["feasible"] is False


def test_the_json_holds_the_setup_that_was_asked_for(answer):
    setup = answer(
        "--circle-radius-mm 28 --base-up-mm 95 --needle-arc-deg 230 --pushes 1 --regrasp-deg 30 --center-mm 5 0 2"
    )["setup"]
    assert setup["arm"] == "psm-classic"
    assert setup["circle"]["radius_m"] == pytest.approx(0.028)
    assert setup["T_world_base"][2][3] == pytest.approx(0.095)
    assert setup["needle"]["arc_rad"] == pytest.approx(np.radians(230))
    assert setup["insertion"]["pushes"] == 1
    assert setup["insertion"]["regrasp_rad"] == pytest.approx(np.radians(30))
    assert np.array(setup["circle"]["T_world_circle"])[:3, 3] == pytest.approx([0.005, 0.0, 0.002])


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("--preset magic", "default, paper-demo"),
        ("--forbid-deg 10", "FROM:TO"),
        ("--center-mm nan 0 0", "centre"),
        ("--center-mm 600 0 0", "from -500 to 500 mm"),
        ("--fix-deg nan", "fixed positions"),
        ("--out /dev/null/x", "cannot be made"),
    ],
)
def test_bad_input_is_one_sentence_and_code_2(plan, line, words):
    code, out, err = plan(f"{line} --json")
    assert (code, out) == (2, "")
    assert err.startswith("trocar: ")
    assert err.count("\n") == 1
    assert words in err


def test_the_table_tells_the_room_of_each_joint_of_the_wrist_in_its_unit(answer, plan):
    found, out = answer("--count 1"), plan("--count 1")[1]
    assert "1 suture by psm-classic" in out
    titles = [[cell.strip() for cell in line.split("┃")[3:6]] for line in out.splitlines() if "┃" in line]
    assert [" ".join(parts) for parts in zip(*titles, strict=True)] == WRIST_TITLES
    (room,) = found["joint_room"]
    row = next(line for line in out.splitlines() if f"{found['reward']:.4f}" in line)
    assert [cell.strip() for cell in row.split("│")[3:6]] == [f"{room[name]:.1f}" for name in WRIST]


def test_sutures_that_cross_are_reported(answer, plan):
    assert answer()["crossing_deg"] == []
    assert answer("--count 6")["crossing_deg"] == [[3, 63]]
    text = " ".join(plan("--count 6")[1].split())
    assert "sutures cross in the tissue, seen from above: 3 and 63 deg; ask for wider gaps" in text
    assert "warning" not in plan()[1]


def test_a_needle_that_never_comes_out_is_reported_with_its_turns(answer, plan):
    assert answer()["needle_comes_out"] is True
    assert answer("--pushes 0")["needle_comes_out"] is False
    assert "turned by 70.0 deg, but its tip comes out at 104.7 deg" in " ".join(plan("--pushes 0")[1].split())


def test_another_arm_out_of_reach_is_told_how_a_base_is_found(plan):
    code, _, err = plan("--arm raven2-left")
    assert code == 1
    assert "`trocar plan setup --arm raven2-left --free port`" in err


WITHOUT_EXTRAS = """
import sys
for name in ("mujoco", "cv2", "trio", "viser", "pyarrow", "jax"):
    sys.modules[name] = None
from trocar.cli import main
main()
"""


@pytest.mark.parametrize(
    "options, code, words",
    [("--demonstrations synthetic --out out", 0, "synthetic"), ("--view", 2, "pip install '.[view]'")],
)
def test_no_extra_is_needed_but_for_the_browser(tmp_path, options, code, words):
    line = [sys.executable, "-c", WITHOUT_EXTRAS, "plan", "suture", *options.split()]
    result = subprocess.run(line, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert result.returncode == code, result.stderr
    assert words in (result.stdout if code == 0 else result.stderr)


def test_the_table_names_the_surrogate_and_the_pictures_are_written(plan, tmp_path):
    code, out, _ = plan(f"--preset paper-demo --out {tmp_path}/new")
    assert code == 0
    text = " ".join(out.split())
    for words in ("surrogate", "flat jaws could not hold", "identifies neither the formula nor the setup", "65.6"):
        assert words in text
    for name in ("plan.png", "reasons.png"):
        assert matplotlib.image.imread(tmp_path / "new" / name)[..., :3].std() > 0.05
    saved = json.loads((tmp_path / "new" / "plan.json").read_text())
    assert saved["files"] == [str(tmp_path / "new" / name) for name in ("plan.json", "plan.png", "reasons.png")]
