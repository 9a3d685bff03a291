"""The suture task: what is to be driven, where, and what is refused."""

import json
from dataclasses import replace

import numpy as np
import pytest

from trocar.errors import InvalidInput, TrocarError
from trocar.eval.config import RunConfig
from trocar.geometry import SE3, SO3
from trocar.lab import load_station, station_text
from trocar.lab.flaws import Difficulty
from trocar.tasks.suture.planning import CLOCKWISE
from trocar.tasks.suture.planning.plan import PlannedSutures, setup_from
from trocar.tasks.suture.planning.primitive import grasp_pose
from trocar.tasks.suture.planning.segments import suture_segments
from trocar.tasks.suture.task import CircleSutures

TASK = CircleSutures()
SETUP = TASK.setup
STATION = load_station("suture")
MOVED = SE3.from_parts(SO3.axis("z", 0.1), [0.002, -0.003, 0.001])


def planned(positions=(1.0,), directions=(CLOCKWISE,), **changes):
    """Return a plan in a changed setup."""
    return PlannedSutures(replace(SETUP, **changes), np.array(positions), np.array(directions))


def kept(plan, folder):
    """Write the file of a plan, as ``trocar plan suture`` does."""
    values = plan.values()
    text = {"setup": values["setup"], "positions_deg": np.degrees(plan.positions_rad).tolist()}
    path = folder / "plan.json"
    path.write_text(json.dumps({**text, "directions": values["directions"]}))
    return path


def test_the_goals_are_the_plan_or_a_forced_direction():
    assert [s.direction for s in TASK.goals()] == TASK.plan.directions.tolist()
    forced = CircleSutures(direction="clockwise").goals()
    assert {s.direction for s in forced} == {CLOCKWISE}
    assert [s.theta_rad for s in forced] == [s.theta_rad for s in TASK.goals()]


@pytest.mark.parametrize("count", [1, 3, 7])
def test_as_many_sutures_as_are_asked_for_stand_evenly_round_the_circle(count):
    goals = CircleSutures(sutures=count).goals()
    angles = np.sort([s.theta_rad for s in goals])
    assert len(goals) == count
    assert np.diff(angles) == pytest.approx(2 * np.pi / count, abs=np.radians(1.1))


def test_a_plan_of_ones_own_is_driven_in_its_setup(tmp_path):
    circle = replace(SETUP.circle, radius_m=0.025)
    path = kept(planned([4.0, 1.0, 1.5], [1, -1, -1], circle=circle, T_world_base=MOVED @ SETUP.T_world_base), tmp_path)
    task = CircleSutures(plan_file=path)
    assert (task.preset, task.direction, task.sutures) == (None, None, 3)
    assert [s.direction for s in task.goals()] == [1, -1, -1]
    assert [s.theta_rad for s in task.goals()] == pytest.approx([4.0, 1.0, 1.5])
    assert all(s.setup is task.setup for s in task.goals())
    station = task.at(STATION)
    assert np.array_equal(station.arms["psm1"].T_world_base.matrix, (MOVED @ SETUP.T_world_base).matrix)
    scene, arm = task.scene(np.random.default_rng(0), station)
    assert scene.circle_radius_m == 0.025 and arm == ("psm1",)
    box = task.calibration(station, "psm1")
    for suture in task.goals():
        q = np.concatenate([piece.q for piece in suture_segments(suture)])
        q = q[((q >= SETUP.arm.lower) & (q <= SETUP.arm.upper)).all(1)]
        assert len(q) > 100 and (q >= box.lower).all() and (q <= box.upper).all()
    assert (box.lower > SETUP.arm.lower).all() and (box.upper < SETUP.arm.upper).all()


def test_a_plan_that_is_out_of_reach_leaves_no_room_to_calibrate_in(tmp_path):
    away = SE3.from_parts(translation_m=[0.0, 0.0, 0.5]) @ SETUP.T_world_base
    task = CircleSutures(plan_file=kept(planned(T_world_base=away), tmp_path))
    with pytest.raises(TrocarError, match="reach"):
        task.calibration(task.at(STATION), "psm1")


def test_the_needle_is_given_as_the_grasp_asks():
    scene, _ = TASK.scene(np.random.default_rng(0), TASK.at(STATION))
    twist = (grasp_pose(SETUP) @ scene.T_tip_needle).log()
    assert np.abs(twist).max() < 1e-9
    lengths = np.linalg.norm(scene.wire_points_m, axis=1)
    np.testing.assert_allclose(lengths, SETUP.needle.radius_m)
    last = SO3.axis("z", -SETUP.needle.arc_rad).apply(scene.wire_points_m[0])
    np.testing.assert_allclose(scene.wire_points_m[-1], last, atol=1e-12)


def test_a_person_places_the_needle_as_exactly_as_the_cell_says():
    rng, station = np.random.default_rng(0), TASK.at(STATION)
    harder = replace(station, difficulty=Difficulty.of("mild", ["needle=2"]))
    loaded = [T for _ in range(200) for T in TASK.scene(rng, harder)[0].T_needle_loaded]
    assert len(loaded) == 200 * len(TASK.goals()), "one for each suture"
    spread = np.std([T.log() for T in loaded], axis=0)
    np.testing.assert_allclose(spread, [*[0.6e-3] * 3, *np.radians([6.0] * 3)], rtol=0.1)
    exact = replace(station, difficulty=Difficulty.of("mild", ["needle=0"]))
    assert all(np.array_equal(T.matrix, np.eye(4)) for T in TASK.scene(rng, exact)[0].T_needle_loaded)


def test_the_station_of_the_task_is_that_of_its_default_plan():
    """The numbers in ``suture.toml`` are those of the preset: nothing has to be moved."""
    station = TASK.at(STATION)
    assert np.abs(station.arms["psm1"].T_world_base.matrix - STATION.arms["psm1"].T_world_base.matrix).max() < 1e-9
    assert np.array_equal(station.T_world_fixture["circle"].matrix, STATION.T_world_fixture["circle"].matrix)


def test_the_options_hold_all_of_a_plan_for_its_file_may_change(tmp_path):
    assert json.loads(json.dumps(TASK.options())) == {
        "variant": "single-arm",
        "preset": "default",
        "direction": "best",
        "sutures": 4,
        "plan_file": None,
        "budget_s": 600.0,
    }
    task = CircleSutures(plan_file=kept(planned(), tmp_path))
    options = json.loads(json.dumps(task.options(), allow_nan=False))
    assert (options["preset"], options["direction"], options["sutures"]) == (None, None, 1)
    assert setup_from(options["plan_file"]["setup"]).needle == SETUP.needle
    assert options["plan_file"]["directions"] == [CLOCKWISE]


ONE, UNHELD = planned(), replace(SETUP.grasp, skew_rad=1.0)


@pytest.mark.parametrize(
    ("plan", "options", "words"),
    [
        (None, {"preset": "nowhere"}, "preset 'nowhere' is unknown; choose one of default"),
        (None, {"direction": "up"}, "direction 'up'.*clockwise"),
        (None, {"sutures": 0}, "number of sutures is 0"),
        (ONE, {"direction": "best"}, "direction 'best' cannot be combined with a plan"),
        (ONE, {"sutures": 2}, "number of sutures is 2, but the plan has 1"),
        (planned(grasp=UNHELD), {}, "the plan cannot be driven.*flat jaws.*--set grasp_skew_deg=0"),
    ],
)
def test_nonsense_is_refused_in_a_sentence(plan, options, words, tmp_path):
    given = {"plan_file": kept(plan, tmp_path)} if plan else {}
    with pytest.raises(TrocarError, match=words):
        CircleSutures(**given, **options).goals()


def test_a_setup_file_is_a_preset_whose_content_is_kept(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text("[set]\ncircle_radius_mm = 28\n")
    task = CircleSutures(preset=str(path), sutures=3)
    assert task.setup.circle.radius_m == pytest.approx(0.028) and len(task.goals()) == 3
    options = json.loads(json.dumps(task.options()))
    path.unlink()
    assert options["preset"] is None
    assert setup_from(options["plan_file"]["setup"]).circle.radius_m == pytest.approx(0.028)
    assert options["plan_file"]["positions_rad"] == task.plan.positions_rad.tolist()
    (tmp_path / "bent.toml").write_text("[set]\ngrasp_skew_deg = 50\n")
    with pytest.raises(
        TrocarError, match=r"preset .*bent.toml' cannot be driven: .* choose one of default, paper-demo"
    ):
        CircleSutures(preset=str(tmp_path / "bent.toml")).goals()


def test_a_plan_for_another_arm_is_refused_where_the_station_has_none():
    with pytest.raises(TrocarError, match=r"preset 'default' is for 'psm-classic', but arm 'left'.*'raven2-left'"):
        TASK.at(load_station("raven-pair"))


def test_two_arms_work_where_a_second_arm_and_a_stand_are():
    task = CircleSutures(variant="two-arms")
    assert (TASK.usual_station, task.usual_station) == ("suture", "suture-pair")
    station = task.at(load_station(task.usual_station))
    assert task.working_arms(station) == ("psm1", "psm2") and TASK.working_arms(station) == ("psm1",)
    alone, pair = TASK.scene(np.random.default_rng(0), TASK.at(STATION)), task.scene(np.random.default_rng(0), station)
    assert alone[0].T_world_stand is None and pair[0].T_world_stand == station.T_world_fixture["stand"]
    with pytest.raises(InvalidInput, match="'suture' has one arm, and suture --variant two-arms needs two"):
        task.at(STATION)
    bare = replace(station, T_world_fixture={"circle": station.T_world_fixture["circle"]})
    with pytest.raises(InvalidInput, match="no fixture 'stand', which suture --variant two-arms needs"):
        task.at(bare)
    with pytest.raises(InvalidInput, match=r"variant of suture 'no-arm' is unknown; .*choose one of single-arm, two"):
        CircleSutures(variant="no-arm")


def test_two_arms_sew_by_the_plan_for_the_second_arm_of_the_runs_station(tmp_path):
    text = station_text("suture-pair")
    text = text.replace("[-86.0364654527, 122.8728066433, 100.0]", "[-80.0, 125.0, 110.0]")
    (tmp_path / "moved.toml").write_text(text)
    task = CircleSutures(variant="two-arms")
    there = RunConfig(task, station=str(tmp_path / "moved.toml"), method="blind", calibration="joints").task
    assert there.plan.setup.puller.port_m == pytest.approx([-0.080, 0.125, 0.110])
    assert task.plan.setup.puller.port_m == pytest.approx([-0.0860, 0.1229, 0.100], abs=1e-4)
    assert there.options() == task.options() and TASK.done_at(STATION) is TASK


def test_both_arms_are_calibrated_where_they_work():
    task = CircleSutures(variant="two-arms")
    station = task.at(load_station(task.usual_station))
    first, second = task.plan_with(station).joints()
    for arm, joints in (("psm1", first), ("psm2", second)):
        box = task.calibration(station, arm)
        assert (joints.min(0) >= box.lower).all() and (joints.max(0) <= box.upper).all()
    alone = TASK.calibration(TASK.at(STATION), "psm1")
    assert (task.calibration(station, "psm1").upper >= alone.upper).all()
