"""How sutures are scored, on truths made up for it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trocar.arms import ARMS
from trocar.cell import Outcome
from trocar.errors import TrocarError
from trocar.geometry import SE3, SO3
from trocar.scene.truth import NeedleTruth
from trocar.sutures import CLOCKWISE, DIRECTIONS, PRESETS, suture_joints
from trocar.sutures.plan_file import PlannedSutures
from trocar.sutures.primitive import grasp_pose, needle_poses, steps, tip_poses
from trocar.tasks import CircleSutures
from trocar.tasks.suture import ON_TARGET_M, SLIP_M, crossings, held, path_distance_m

TASK = CircleSutures(sutures=1)
(SUTURE,) = TASK.work
SETUP = TASK.setup
PER_STEP = 100
MOVED = SE3.from_parts(SO3.axis("z", 0.1), [0.002, -0.003, 0.001])


def planned(**changes):
    """Return a plan of one suture in a changed setup."""
    return PlannedSutures(replace(SETUP, **changes), [1.0], [CLOCKWISE])


ONE = planned()
NAMES = ["approach", *(step.name for step in steps(SETUP)), "withdraw"]


def made_up(shift_m=(0.0, 0.0, 0.0), slide=None):
    """Return truth and events of a suture driven as planned but for a shift, 1 s a step at 100 Hz.

    ``slide`` is (name of a step, metres): in it the needle moves that much in the jaws.
    """
    needles, tips = [], []
    for step in [None, *steps(SETUP), None]:
        if step is None:
            pair = (-0.005, -1e-4, 0.0, 0.0) if not needles else (SETUP.insertion.straight_m,) * 2 + (END_RAD,) * 2
            advance, turn = np.linspace(*pair[:2], PER_STEP), np.linspace(*pair[2:], PER_STEP)
            jaws = turn if not needles[:1] else np.full(PER_STEP, SETUP.insertion.rotation_rad)
        else:
            advance, turn = np.linspace(*step.advance_m, PER_STEP), np.linspace(*step.needle_rad, PER_STEP)
            jaws = np.linspace(*step.jaws_rad, PER_STEP)
        needle = SUTURE.turned(needle_poses(SETUP, advance, turn)).matrix.copy()
        tip = SUTURE.turned(tip_poses(SETUP, advance, jaws)).matrix.copy()
        if slide and step is not None and step.name == slide[0]:
            needle[:, :3, 3] += np.linspace(0.0, slide[1], PER_STEP)[:, None] * needle[:, :3, 2]
        needle[:, :3, 3] += shift_m
        tip[:, :3, 3] += shift_m
        needles.append(needle)
        tips.append(tip)
    count = len(needles) * PER_STEP
    truth = NeedleTruth(
        0.01 * np.arange(count),
        SE3(np.concatenate(needles)),
        SE3(np.concatenate(tips)),
        np.zeros((count, 6)),
        np.array([0.0, -SETUP.needle.radius_m, 0.0]),
    )
    events = [{"name": "step", "suture": 0, "step": name, "time_s": float(k)} for k, name in enumerate(NAMES)]
    return truth, [*events, ended(len(NAMES))]


END_RAD = SETUP.insertion.rotation_rad + SETUP.insertion.pushes * SETUP.insertion.regrasp_rad


def ended(time_s, outcome="DONE", reason=""):
    return {
        "name": "suture",
        "suture": 0,
        "start_s": 0.0,
        "time_s": float(time_s),
        "outcome": outcome,
        "reason": reason,
    }


def score(truth, events):
    (found,) = TASK.score(events, truth)
    return found


def test_a_suture_as_planned_succeeds_without_errors():
    found = score(*made_up())
    assert found.succeeded and found.failure == ""
    assert found.entry_error_m < 2e-5 and found.exit_error_m < 2e-5
    assert found.tip_max_m < 2e-6
    assert found.slip_m < 1e-9 and found.slip_rad < 1e-6
    assert found.steps == len(steps(SETUP))


@given(st.floats(0.0, 3e-3), st.floats(0.0, 2 * math.pi))
def test_a_shift_on_the_surface_is_measured_and_judged(size, angle):
    found = score(*made_up([size * math.cos(angle), size * math.sin(angle), 0.0]))
    assert found.entry_error_m == pytest.approx(size, abs=3e-5)
    assert found.exit_error_m == pytest.approx(size, abs=3e-5)
    assert found.tip_max_m <= size + 2e-6
    if abs(size - ON_TARGET_M) > 5e-5:
        assert found.succeeded == (size < ON_TARGET_M)
        assert found.failure == ("" if found.succeeded else Outcome.OFF_TARGET.name)


def test_a_needle_that_never_goes_in_is_off_target():
    found = score(*made_up([0.0, 0.0, 0.02]))
    assert found.entry_error_m is None and found.exit_error_m is None
    assert found.failure == Outcome.OFF_TARGET.name


@pytest.mark.parametrize("step", ["penetrate", "rotate", "push 2"])
@pytest.mark.parametrize(("share", "slips"), [(0.8, False), (1.2, True)])
def test_a_needle_that_moves_in_closed_jaws_has_slipped(step, share, slips):
    found = score(*made_up(slide=(step, share * SLIP_M)))
    assert found.slip_m == pytest.approx(share * SLIP_M, rel=0.02)
    assert (found.failure == Outcome.NEEDLE_SLIPPED.name) == slips


def test_a_needle_that_moves_between_open_jaws_has_not_slipped():
    assert score(*made_up(slide=("regrasp 1", 2e-3))).slip_m < 1e-9


def test_what_the_script_reports_stands():
    truth, events = made_up()
    found = score(truth, [*events[:4], ended(4.0, "JOINT_LIMIT", "suture 1, regrasp 1: joint 'roll' ...")])
    assert (found.failure, found.succeeded) == ("JOINT_LIMIT", False)
    assert "roll" in found.reason
    assert found.exit_error_m is None
    assert score(truth, [ended(1.0, "NEEDLE_MISSED")]).tip_rms_m is None


@given(st.floats(-2e-3, 2e-3), st.floats(0.0, 1.0))
def test_the_distance_from_a_path_is_that_from_its_nearest_piece(off, share):
    path = np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.01, 0.01, 0.0]])
    assert path_distance_m(np.array([[0.01 * share, 0.0, off]]), path)[0] == pytest.approx(abs(off))
    assert path_distance_m(np.array([[-3e-3, 4e-3, 0.0]]), path)[0] == pytest.approx(5e-3)


def test_crossings_are_the_first_way_in_and_the_next_way_out():
    x = np.linspace(0.0, 10.0, 1001)
    tips = np.column_stack([x, 0 * x, np.cos(x)])
    entry, exit_ = crossings(tips)
    np.testing.assert_allclose(entry, [np.pi / 2, 0.0, 0.0], atol=1e-4)
    np.testing.assert_allclose(exit_, [3 * np.pi / 2, 0.0, 0.0], atol=1e-4)
    assert crossings(tips[:100]) == (None, None)
    assert crossings(tips[:300])[1] is None


def test_a_tip_that_trembles_on_the_surface_has_not_gone_in_and_out():
    height = np.concatenate([np.linspace(5e-3, 0.0, 50), 5e-5 * np.sin(np.arange(40)), np.linspace(0, -4e-3, 50)])
    tips = np.column_stack([1e-4 * np.arange(len(height)), 0 * height, height])
    entry, exit_ = crossings(tips)
    assert entry[0] == pytest.approx(1e-4 * 90, abs=6e-4) and exit_ is None
    assert crossings(tips[:90]) == (None, None)


def test_jaws_are_closed_from_the_approach_and_from_each_push():
    spans = [(name, float(k), k + 1.0) for k, name in enumerate(NAMES)]
    assert held(spans) == [(0.0, 3.0), (4.0, 5.0), (6.0, 7.0)]


def test_the_work_is_the_plan_or_a_forced_direction():
    task = CircleSutures()
    assert [s.direction for s in task.work] == task.plan.directions.tolist()
    forced = CircleSutures(direction="clockwise").work
    assert {s.direction for s in forced} == {CLOCKWISE}
    assert [s.theta_rad for s in forced] == [s.theta_rad for s in task.work]


def test_a_plan_of_ones_own_is_driven_in_its_setup():
    setup = replace(SETUP, circle=replace(SETUP.circle, radius_m=0.025), T_world_base=MOVED @ SETUP.T_world_base)
    task = CircleSutures(planned=PlannedSutures(setup, [4.0, 1.0, 1.5], [1, -1, -1]))
    assert (task.preset, task.direction, task.sutures) == (None, None, 3)
    assert [(s.theta_rad, s.direction) for s in task.work] == [(4.0, 1), (1.0, -1), (1.5, -1)]
    assert all(s.setup is setup for s in task.work)
    assert task.T_world_base["psm1"] is setup.T_world_base
    assert task.scene(np.random.default_rng(0)).circle_radius_m == 0.025
    joints = suture_joints(setup, task.plan.positions_rad)
    for i, direction in enumerate(task.plan.directions):
        q = joints.q[DIRECTIONS.index(direction), i]
        assert (q >= task.excitation.lower).all() and (q <= task.excitation.upper).all()


def test_the_presets_plan_given_is_the_preset():
    task = CircleSutures()
    given = CircleSutures(planned=PlannedSutures(task.setup, task.plan.positions_rad, task.plan.directions))
    assert given.work == task.work


def test_the_calibrations_motion_covers_the_plan():
    box = CircleSutures().excitation
    from trocar.sutures.drive import drive  # noqa: PLC0415

    for suture in CircleSutures().work:
        q = np.concatenate([piece.q for piece in drive(suture)])
        assert (q >= box.lower).all() and (q <= box.upper).all()


def test_the_needle_is_given_as_the_grasp_asks():
    scene = CircleSutures().scene(np.random.default_rng(0))
    twist = (grasp_pose(SETUP) @ scene.T_tip_needle).log()
    assert np.abs(twist).max() < 1e-9
    lengths = np.linalg.norm(scene.wire_points_m, axis=1)
    np.testing.assert_allclose(lengths, SETUP.needle.radius_m)
    last = SO3.axis("z", -SETUP.needle.arc_rad).apply(scene.wire_points_m[0])
    np.testing.assert_allclose(scene.wire_points_m[-1], last, atol=1e-12)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"preset": "paper-demo"}, "cannot be driven.*flat jaws.*default"),
        ({"preset": "nowhere"}, "preset 'nowhere' of suture is unknown; choose one of default"),
        ({"direction": "up"}, "direction 'up'.*clockwise"),
        ({"variant": "two-arms"}, "variant 'two-arms'.*single-arm"),
        ({"sutures": 0}, "number of sutures is 0"),
        ({"planned": ONE, "preset": "default"}, "preset 'default' cannot be combined with a plan"),
        ({"planned": ONE, "direction": "best"}, "direction 'best' cannot be combined with a plan"),
        ({"planned": ONE, "sutures": 2}, "number of sutures is 2, but the plan has 1"),
        (
            {"planned": planned(arm=ARMS["psm-si"])},
            "plan is for 'psm-si'.*plan with --arm psm-classic",
        ),
        ({"planned": planned(grasp=PRESETS["paper-demo"].setup.grasp)}, "cannot be driven.*--grasp-skew-deg 0"),
    ],
)
def test_nonsense_is_refused_in_a_sentence(options, words):
    with pytest.raises(TrocarError, match=words):
        CircleSutures(**options).work  # noqa: B018
