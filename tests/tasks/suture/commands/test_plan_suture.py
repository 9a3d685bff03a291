import csv
import inspect
import json
import subprocess
import sys
import time

import matplotlib.image
import numpy as np
import pytest

from trocar.log import machine_speed
from trocar.tasks.suture.commands.plan_suture import suture
from trocar.tasks.suture.planning.plan import load_plan

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
    assert found["mid_bites_deg"] == pytest.approx(found["positions_deg"]) and found["fitted"] == []
    assert found["gap_bounds_deg"] == [90, 90] and found["mesh_left_mm"] > found["mesh_margin_mm"] == 1
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
    even, gaps = answer(), answer("--gap 75:105")
    anywhere = answer("--gap 75:105 --continuous")
    assert all(75 <= gap <= 105 for gap in gaps["gaps_deg"])
    assert even["reward"] < gaps["reward"] <= anywhere["reward"] < gaps["reward"] + 2e-3
    assert anywhere["bound"] is None and "nothing is proven" in anywhere["certified"]


def test_fixed_and_forbidden_places_are_kept(answer):
    found = answer("--fix 90 --forbid 170:190 --forbid 350:10 --gap 60:120 --count 5")
    assert 90 in found["positions_deg"]
    assert not [theta for theta in found["positions_deg"] if 170 < theta < 190 or theta > 350 or theta < 10]
    assert len(found["positions_deg"]) == 5
    assert found["fixed_deg"] == [90] and found["forbidden_deg"] == [[170, 190], [350, 370]]


def test_demonstrations_change_the_manipulability_and_are_named(answer):
    found = answer("--demonstrations synthetic")
    assert "surrogate" not in found["manipulability_source"]
    assert "synthetic" in found["manipulability_source"]
    assert found["rewards"] != answer()["rewards"]


def test_options_change_what_they_name(answer):
    assert answer("--margin clipped --weight 0.5")["weight"] == 0.5
    nearer, farther = answer("--set circle_radius_mm=21"), answer("--set circle_radius_mm=45")
    assert nearer["reward"] != farther["reward"]
    turned = answer("--preset paper-demo --set base_azimuth_deg=226")
    plain = answer("--preset paper-demo")
    shift = np.subtract(turned["switches_deg"], plain["switches_deg"])
    assert shift == pytest.approx([1, 1]), "base and circle's centre turned by 1 deg: all plans turn with it"


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("--set circle_radius_mm=90 --count 12", ["160 to 213 deg", "joint 'pitch'", "-61.3 deg", "8.3 deg beyond"]),
        ("--set base_up_mm=20 --set base_sideways_mm=20", ["mm less than the safe depth of 45 mm"]),
        ("--set base_up_mm=400", ["all positions", "joint 'insertion'", "mm beyond its limit of 240 mm"]),
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
    assert code == 1 and "the jaws would be 4.3 mm under the tissue" in err
    assert "bound of worst infeasible sutures" in out and "worst infeasible" not in plan()[1]
    assert json.loads((tmp_path / "out" / "plan.json").read_text())["feasible"] is False


def test_the_json_holds_the_setup_that_was_asked_for(answer):
    setup = answer(
        "--set circle_radius_mm=28 --set base_up_mm=95 --set needle_arc_deg=230 --set pushes=1 --set regrasp_deg=36 "
        "--set center_x_mm=5 --set center_z_mm=2"
    )["setup"]
    assert setup["arm"] == "psm-classic"
    assert setup["circle"]["radius_m"] == pytest.approx(0.028)
    assert setup["T_world_base"][2][3] == pytest.approx(0.095)
    assert setup["needle"]["arc_rad"] == pytest.approx(np.radians(230))
    assert setup["insertion"]["pushes"] == 1
    assert setup["insertion"]["regrasp_rad"] == pytest.approx(np.radians(36))
    assert np.array(setup["circle"]["T_world_circle"])[:3, 3] == pytest.approx([0.005, 0.0, 0.002])


def test_the_table_tells_the_room_of_each_joint_of_the_wrist_in_its_unit(answer, plan):
    found, out = answer("--count 1"), plan("--count 1")[1]
    assert "1 suture by psm-classic" in out
    titles = [[cell.strip() for cell in line.split("┃")[3:6]] for line in out.splitlines() if "┃" in line]
    assert [" ".join(parts) for parts in zip(*titles, strict=True)] == WRIST_TITLES
    (room,) = found["joint_room"]
    row = next(line for line in out.splitlines() if f"{found['reward']:.4f}" in line)
    assert [cell.strip() for cell in row.split("│")[3:6]] == [f"{room[name]:.1f}" for name in WRIST]


def test_sutures_that_cross_are_reported(answer, plan):
    assert answer()["crossing_deg"] == answer("--count 9")["crossing_deg"] == []
    twelve = answer("--count 12")
    assert len(twelve["crossing_deg"]) == 12, "each its two neighbours: bites of 39 deg in gaps of 30"
    text = " ".join(plan("--count 12")[1].split())
    assert "sutures cross in the tissue, seen from above: " in text and "and 9 more pairs; ask for wider gaps" in text
    assert "warning" not in plan()[1]
    entering = answer("--count 6 --set theta_is=entry")
    assert entering["crossing_deg"] and not answer("--count 6")["crossing_deg"]


def test_a_needle_that_never_comes_out_is_reported_with_its_turns(answer, plan):
    assert answer()["needle_comes_out"] is True
    assert answer("--set pushes=0")["needle_comes_out"] is False
    assert "turned by 70.0 deg, but its tip comes out at 104.7 deg" in " ".join(plan("--set pushes=0")[1].split())


def test_another_arm_out_of_reach_is_told_how_a_base_is_found(plan):
    code, _, err = plan("--arm raven2-left")
    assert code == 1
    assert "`trocar plan setup --arm raven2-left --free port --free grasp`" in err
    _, _, err = plan(
        "--arm raven2-left --set grasp_behind_tip_deg=150 --set grasp_approach_deg=60 --set grasp_lean_deg=0"
    )
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
    [("--demonstrations synthetic --out out", 0, "synthetic"), ("--view", 2, "pip install -e '.[view]'")],
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
    for words in (
        "surrogate",
        "identifies neither the formula nor the setup",
        "65.6",
        "fitted: 5 numbers of the setup",
    ):
        assert words in text
    assert "reach 1.5 mm over the mesh's edge" in text, "the paper's angles are those of the entries"
    unheld = plan("--set grasp_skew_deg=20")[1]
    assert "leaves the plane of the jaws by 17 deg: flat jaws could not hold" in " ".join(unheld.split())
    for name in ("plan.png", "reasons.png"):
        assert matplotlib.image.imread(tmp_path / "new" / name)[..., :3].std() > 0.05
    saved = json.loads((tmp_path / "new" / "plan.json").read_text())
    names = ("plan.json", "plan.png", "reasons.png", "waypoints.csv", "waypoints.json")
    assert saved["files"] == [str(tmp_path / "new" / name) for name in names]
    assert saved["fitted"][0] == "base_tilt_deg" and len(saved["fitted"]) == 5


def test_waypoints_are_those_of_the_plan_and_go_with_it(plan, tmp_path):
    assert plan(f"--count 2 --out {tmp_path}/p")[0] == 0
    values = json.loads((tmp_path / "p" / "waypoints.json").read_text())
    saved = json.loads((tmp_path / "p" / "plan.json").read_text())
    assert values["positions_deg"] == saved["positions_deg"] and len(values["stitches"]) == 2
    with (tmp_path / "p" / "waypoints.csv").open() as file:
        table = list(csv.DictReader(file))
    assert len(table) == sum(len(stitch["times_s"]) for stitch in values["stitches"])
    assert float(table[7]["wrist_pitch_rad"]) == pytest.approx(values["stitches"][0]["joints"][7][4], abs=1e-8)
    assert load_plan(tmp_path / "p").values() == load_plan(tmp_path / "p" / "waypoints.json").values()
    assert plan(f"--set base_up_mm=400 --out {tmp_path}/p")[0] == 1
    assert not (tmp_path / "p" / "waypoints.csv").exists() and not (tmp_path / "p" / "waypoints.json").exists()


def test_waypoints_of_two_arms_go_with_a_plan_for_two_and_not_with_another(plan, tmp_path):
    code, out, _ = plan(f"--variant two-arms --count 2 --out {tmp_path}/p --json")
    found, values = json.loads(out), json.loads((tmp_path / "p" / "waypoints.json").read_text())
    assert code == 0 and found["two_arms"]["arms"] == ["psm1", "psm2"]
    assert found["two_arms"]["room_deg"] > 8 and found["two_arms"]["apart_mm"] >= 4
    assert [set(stitch) for stitch in values["two_arms"]] == [{"psm1", "psm2"}] * 2
    with (tmp_path / "p" / "waypoints_two_arms.csv").open() as file:
        table = list(csv.DictReader(file))
    assert [row["arm"] for row in table[:: len(table) - 1]] == ["psm1", "psm2"]
    assert float(table[7]["roll_rad"]) == pytest.approx(values["two_arms"][0]["psm1"]["joints"][7][3], abs=1e-8)
    assert len(load_plan(tmp_path / "p" / "waypoints.json").sutures) == 2
    assert plan(f"--count 2 --out {tmp_path}/p")[0] == 0
    assert not (tmp_path / "p" / "waypoints_two_arms.csv").exists()
    assert "two_arms" not in json.loads((tmp_path / "p" / "waypoints.json").read_text())


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("--variant three-arms", "variant of suture 'three-arms' is unknown"),
        ("--variant two-arms --arm psm-si", "is for 'psm-classic', the first arm of station 'suture-pair'"),
        ("--variant two-arms --count 2 --set base_azimuth_deg=125", "the second arm meets the first on its way"),
    ],
)
def test_two_arms_that_cannot_sew_are_refused_by_what_they_lack(plan, line, words):
    code, _, err = plan(line)
    assert code == 2 and words in err


def test_any_number_of_sutures_is_planned_evenly(answer):
    found = answer("--count 7")
    assert found["gaps_deg"] == pytest.approx([360 / 7] * 7) and found["grid_positions"] >= 360


def test_a_setup_file_is_a_preset(answer, tmp_path):
    (tmp_path / "mine.toml").write_text('preset = "paper-demo"\n[set]\nbase_up_mm = 95\n[reward]\nweight = 0.5\n')
    of_file = answer(f"--preset {tmp_path}/mine.toml")
    of_words = answer("--preset paper-demo --set base_up_mm=95 --weight 0.5")
    assert of_file["setup"] == of_words["setup"] and of_file["rewards"] == of_words["rewards"]


def test_joint_weights_and_caution_change_the_reward_that_they_name(answer):
    plain, weighted = answer(), answer("--joint-weights 1,1,3")
    assert weighted["joint_weights"] == [1, 1, 3] and weighted["rewards"] != plain["rewards"]
    recorded, cautious = (answer(f"--demonstrations synthetic --caution {k}") for k in (0, 2))
    assert cautious["caution"] == 2 and cautious["rewards"] != recorded["rewards"]


def test_the_command_has_at_most_twenty_options():
    options = inspect.signature(suture).parameters
    assert len(options) <= 20


@pytest.mark.slow
def test_the_planner_takes_as_long_as_a_warm_one_and_the_command_about_a_second():
    """The time that is printed is not that of imports: of the first call it would be five times as long."""
    line = [sys.executable, "-m", "trocar", "plan", "suture", "--json"]
    compute_ms, took_s, speed = [], [], machine_speed()
    while len(took_s) < 3 or (min(compute_ms) >= 15.0 and len(took_s) < 10):  # a busy machine holds single ones up
        started = time.perf_counter()
        found = json.loads(subprocess.run(line, capture_output=True, check=True).stdout)
        took_s.append((time.perf_counter() - started) * speed)
        compute_ms.append(found["compute_ms"] * speed)  # as on the machine for which budgets were declared
    assert sum(took_s) / len(took_s) < 3.0
    assert min(compute_ms) < 15.0
