"""Driven sutures in numbers, on made-up trials."""

from dataclasses import replace

import numpy as np
import pytest

from kept_figures import kept_figures
from trocar.eval.scenery import Scenery
from trocar.eval.trial import Trial
from trocar.geometry import SE3
from trocar.report import style
from trocar.tasks.suture.planning import CLOCKWISE, COUNTERCLOCKWISE, Circle
from trocar.tasks.suture.planning.primitive import needle_poses
from trocar.tasks.suture.report.driven_sutures import (
    SutureReport,
    draw_joints,
    draw_needle,
    driven_summary,
    joint_errors,
    setup_of,
    steps_of,
)
from trocar.tasks.suture.score import ON_TARGET_M
from trocar.tasks.suture.task import CircleSutures

STEPS = ("approach", "penetrate", "rotate", "regrasp 1", "push 1", "withdraw")
OFF = np.radians([0.1, -0.2, 0.0, 1.0, 2.0, -3.0]) + [0.0, 0.0, 1e-3, 0.0, 0.0, 0.0]
TASK = CircleSutures(sutures=1)
(SUTURE,) = TASK.goals()
ROWS = 701


def made_up(off=OFF, failure="", scores=True):
    """Return a trial of one suture whose joints are ``off`` their plan while the primitive runs, and far off else."""
    setup, times = SUTURE.setup, 0.01 * np.arange(ROWS)
    asked = np.outer(np.sin(times), np.linspace(0.1, 0.6, 7))
    runs = (times > 1.0 - 1e-6) & (times < 5.0 + 1e-6)
    true = asked + np.append(np.where(runs[:, None], off, 1.0), np.zeros((ROWS, 1)), axis=1)
    needle = SUTURE.turned(needle_poses(setup, np.linspace(0.0, 0.01, ROWS), 0.0))
    needle = setup.circle.T_world_circle @ needle
    score = {
        **{"theta_deg": float(np.degrees(SUTURE.theta_rad)), "direction": SUTURE.direction, "attempted": True},
        **{"succeeded": not failure, "failure": failure, "reason": "why", "start_s": 0.0, "end_s": 6.0},
        **{"entry_error_m": 1e-4, "exit_error_m": None, "tip_rms_m": 2e-4, "tip_max_m": 3e-4, "slip_m": 5e-5},
        **{"slip_rad": 0.0, "driven_s": [1.0, 5.0]},
    }
    events = [{"name": "step", "suture": 0, "step": step, "time_s": float(k)} for k, step in enumerate(STEPS)]
    if failure:
        events.append({"name": "stopped", "time_s": 6.0, "outcome": failure, "reason": "why"})
    return Trial(
        about={
            "task": "suture",
            "options": TASK.options(),
            "goal_noun": "suture",
            "arms": ["psm1"],
            "method": "by hand",
        },
        scores=[score] if scores else [],
        spans=[],
        events=events,
        collisions=[],
        ended="done",
        reason="",
        duration_s=7.0,
        command_limit_use={"psm1": (0.5, 0.9)},
        arrays={
            "true_psm1": true.astype(np.float32),
            "desired_psm1": asked.astype(np.float32),
            "measured_psm1": asked.astype(np.float32),
            "body_needle": np.column_stack([needle.translation_m, needle.rotation.as_quaternion()]).astype(np.float32),
            "T_world_circle": setup.circle.T_world_circle.matrix,
        },
        scenery=Scenery(
            solids=(),
            T_world_body={"world": SE3.identity()},
            arms={"psm1": setup.arm},
            T_world_base={"psm1": setup.T_world_base},
            T_world_base_registered={"psm1": setup.T_world_base},
            cameras={},
            tick_s=0.01,
        ),
    )


def test_joint_errors_count_while_the_primitive_runs_and_only_then():
    trial = made_up()
    errors = joint_errors(trial)
    np.testing.assert_allclose(errors, np.broadcast_to(OFF, errors.shape), atol=1e-4)
    summary = driven_summary([trial, trial])
    assert summary["joint_error_deg"]["wrist_pitch"]["rms"] == pytest.approx(2.0, abs=0.01)
    assert summary["joint_error_deg"]["wrist_yaw"]["max"] == pytest.approx(3.0, abs=0.01)
    assert summary["insertion_error_mm"]["rms"] == pytest.approx(1.0, abs=0.01)
    assert "insertion" not in summary["joint_error_deg"]


def test_steps_end_where_the_next_begins_and_the_last_with_its_suture():
    assert steps_of(made_up(), 0)[:2] == [("approach", 0.0, 1.0), ("penetrate", 1.0, 2.0)]
    assert steps_of(made_up(), 0)[-1] == ("withdraw", 5.0, 6.0)


def test_what_was_not_measured_is_none():
    summary = driven_summary([made_up(failure="JOINT_LIMIT")])
    assert summary["exit_error_mm"] == {"mean": None, "max": None}
    assert summary["entry_error_mm"]["max"] == pytest.approx(0.1)
    assert summary["tip_error_mm"] == {"rms": pytest.approx(0.2), "max": pytest.approx(0.3)}
    nothing = driven_summary([made_up(scores=False)])
    assert nothing["joint_error_deg"]["roll"] == {"rms": None, "max": None}


def test_a_suture_is_told_in_degrees_its_direction_and_millimetres():
    report, (score,) = SutureReport(), made_up().scores
    assert report.goal(score | {"theta_deg": 12.3, "direction": CLOCKWISE}) == "at 12 deg, clockwise"
    assert report.goal(score | {"theta_deg": 12.3, "direction": COUNTERCLOCKWISE}) == "at 12 deg, counterclockwise"
    expected = {"entry off, mm": 0.1, "exit off, mm": None, "tip off its path, RMS mm": 0.2, "slip, mm": 0.05}
    assert report.measured(score) == {what: value and pytest.approx(value) for what, value in expected.items()}


def test_a_picture_holds_the_circle_and_a_needle_over_it():
    points = SUTURE.setup.circle.T_world_circle.inverse().apply(SutureReport().frame(made_up()))
    ring, higher = np.split(points, 2)
    assert np.linalg.norm(ring, axis=1).min() > SUTURE.setup.circle.radius_m and np.abs(ring[:, 2]).max() < 1e-6
    np.testing.assert_allclose((higher - ring)[:, :2], 0.0, atol=1e-9)
    assert (higher[:, 2] > SUTURE.setup.needle.radius_m).all()


def test_a_trial_of_a_plan_is_drawn_in_the_setup_of_that_plan():
    trial, options = made_up(), TASK.options()
    assert setup_of(trial).circle.radius_m == SUTURE.setup.circle.radius_m
    plan = replace(TASK.plan, setup=replace(SUTURE.setup, circle=Circle(0.025))).values()
    of_plan = replace(trial, about=trial.about | {"options": options | {"preset": None, "plan_file": plan}})
    assert setup_of(of_plan).circle.radius_m == 0.025


def test_what_stopped_a_trial_and_what_is_modelled_is_said():
    assert SutureReport().notes([made_up(failure="JOINT_LIMIT")])[0] == "why"
    plain = SutureReport().notes([made_up()])
    assert "why" not in plain and any("no tissue mechanics" in sentence for sentence in plain)


def test_the_first_suture_is_shown_step_by_step_and_every_picture_bears_its_angle():
    moments = SutureReport().moments(made_up(failure="OFF_TARGET"))
    angle = f"{np.degrees(SUTURE.theta_rad):.0f} deg"
    assert [caption for caption, _ in moments][:-1] == [f"{angle}: {step}" for step in STEPS[:4]]
    assert moments[-1] == (f"suture 1, {angle}: off target", 5.0), "when the needle was driven last"
    assert [time_s for _, time_s in moments] == sorted(time_s for _, time_s in moments)


@pytest.fixture
def drawn(monkeypatch, tmp_path):
    """Return how a trial is drawn, as a figure that was not written."""
    figures = kept_figures(monkeypatch)

    def draw(by, trial):
        by(trial, tmp_path / "picture.png", "by hand")
        return figures.pop()

    return draw


def lines(axes, **looks):
    """Return the data (n, 2) of the lines that look so."""
    found = [line for line in axes.get_lines() if all(getattr(line, f"get_{k}")() == v for k, v in looks.items())]
    return [np.column_stack(line.get_data()).astype(float) for line in found]


def test_the_picture_of_the_joints_bears_the_figures_of_the_table(drawn):
    trial = made_up()
    axes = drawn(draw_joints, trial).axes
    summary = driven_summary([trial])
    table = SutureReport().tables(summary | {"method": "by hand"})[0]
    rms, largest = (list(table.columns[k].cells) for k in (1, 2))
    assert axes[1].get_title("right") == f"shaded: RMS {rms[0]}, largest {largest[0]} deg"
    assert axes[5].get_title("right") == f"shaded: RMS {rms[5]}, largest {largest[5]} mm", "the insertion"
    assert rms[7:] == ["", "", ""] and largest[7:] == ["0.10", "-", "0.05"], "entry, exit and slip have a largest only"
    for index, off in enumerate((0.1, -0.2, 1.0, 1.0, 2.0, -3.0)):
        (error,) = lines(axes[2 * index + 1], color=style.PURPLE)
        while_driven = (error[:, 0] > 1.01) & (error[:, 0] < 4.99)
        np.testing.assert_allclose(error[while_driven, 1], off, atol=1e-3)


def test_a_limit_is_drawn_in_the_picture_of_the_joints_if_a_joint_comes_near_it(drawn):
    trial, arm = made_up(), SUTURE.setup.arm
    shares = np.array([0.5, 0.1, 0.9, 0.5, 0.8, 0.2])
    trial.arrays["true_psm1"][:, :6] = arm.lower + shares * (arm.upper - arm.lower)
    limits = [
        np.unique(line[:, 1]).tolist()
        for axes in drawn(draw_joints, trial).axes[::2]
        for line in lines(axes, linestyle="--")
    ]
    assert limits == [[pytest.approx(np.degrees(arm.lower[1]))], [pytest.approx(1e3 * arm.upper[2])]]


def test_the_needles_tip_is_drawn_beside_its_plan_while_it_is_driven(drawn):
    above, side = drawn(draw_needle, made_up()).axes
    assert side.get_title("left").endswith(f" deg: in and out within {1e3 * ON_TARGET_M:g} mm")
    (planned,), (tip,) = lines(side, color=style.ORANGE), lines(side, color=style.BLUE)
    deep_m = 0.01 * np.arange(ROWS) / (ROWS - 1)  # straight in, as it was made up
    down = SUTURE.setup.insertion.entry_angle_rad
    went_mm = 1e3 * deep_m[:, None] * [np.cos(down), -np.sin(down)]
    seen = np.isfinite(tip).all(1)
    np.testing.assert_allclose(tip[seen], went_mm[seen], atol=0.01)
    times = 0.01 * np.flatnonzero(seen)
    assert times.min() == pytest.approx(1.0) and times.max() == pytest.approx(5.0)
    assert not ((times > 3.001) & (times < 3.999)).any(), "open jaws that go back along it do not drive it"
    assert planned[0].tolist() == [0.0, 0.0] and planned[:, 1].min() < -1.0
    (seen_above,) = lines(above, color=style.BLUE, linewidth=1.0)[:1]
    entry_mm = 1e3 * SUTURE.entry_m[:2]
    assert np.nanmin(np.linalg.norm(seen_above - entry_mm, axis=1)) == pytest.approx(went_mm[100, 0], abs=0.01)


@pytest.mark.parametrize("draw", [draw_joints, draw_needle])
def test_pictures_are_drawn(draw, tmp_path):
    assert draw(made_up(), tmp_path / "picture.png", "by hand").stat().st_size > 20_000
