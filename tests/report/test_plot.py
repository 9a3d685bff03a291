"""``plot`` draws whatever has a picture, writes no file, and reports what has no picture."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from trocar.arms import MOTION_LIMITS, PSM_CLASSIC
from trocar.calibration.evaluation import Evaluation
from trocar.calibration.recording import Recording
from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.motion import ArmMotion, MotionProblem, plan_motion
from trocar.report.plot import plot
from trocar.tasks.suture.planning import PRESETS, dexterity, plan_even
from trocar.trajectory import Trajectory

LIMITS = MOTION_LIMITS["paper"]
MIDDLE = PSM_CLASSIC.middle
FAR = SE3.from_parts(translation_m=(0.5, 0.0, 0.0))


def lines(axes):
    return {line.get_label(): line.get_xydata() for line in axes.get_lines() if not line.get_label().startswith("_")}


@pytest.fixture(scope="module")
def plan():
    ways = {"left": ([0.1, 0, -0.02, 0, 0.2, 0], SE3.identity()), "right": ([0, 0.1, 0, 0.3, 0, 0], FAR)}
    arms = {
        name: ArmMotion(PSM_CLASSIC, [MIDDLE, MIDDLE + step], LIMITS, T_world_base=base)
        for name, (step, base) in ways.items()
    }
    return plan_motion(MotionProblem(arms))


def test_a_plan_has_a_column_for_each_arm_in_degrees_and_millimetres(plan):
    picture = plot(plan)
    assert len(picture.axes) == 6
    assert [axes.get_title(loc="left").split(",")[0] for axes in picture.axes[:2]] == ["left", "right"]
    drawn = lines(picture.axes[0])
    assert drawn["yaw"][-1, 1] == pytest.approx(np.degrees(MIDDLE[0] + 0.1))
    assert drawn["insertion (mm)"][[0, -1], 1] == pytest.approx(1e3 * (MIDDLE[2] + np.array([0.0, -0.02])))
    fastest = np.abs(lines(picture.axes[2])["yaw"][:, 1]).max()
    assert 0 < fastest <= np.degrees(LIMITS.velocity[0]) * (1 + 1e-9)
    marks = [line.get_xdata()[0] for line in picture.axes[0].get_lines() if line.get_linestyle() == ":"]
    np.testing.assert_allclose(marks, plan.waypoint_times_s["left"])


def test_a_trajectory_of_other_joints_is_drawn_as_it_is():
    picture = plot(Trajectory([0.0, 2.0], [[[1.0, 2.0]], [[0.0, 5.0]]]))
    assert lines(picture.axes[0])["joint 1"][-1].tolist() == [2.0, 2.0]
    assert "rad or m" in picture.axes[0].get_ylabel()
    assert list(lines(plot(Trajectory([0.0, 2.0], [[[1.0]]]), joints=("crank",)).axes[0])) == ["crank"]


def test_a_recording_is_drawn_with_and_without_a_model():
    q = 0.3 * np.sin(np.outer(np.arange(50.0), np.linspace(0.1, 0.6, 6)))
    recording = Recording(q, q + 0.1, np.arange(50) > 4, np.arange(50.0), "made up")
    alone = plot(recording)
    assert set(lines(alone.axes[0])) == {"commanded", "measured"}
    assert len(lines(alone.axes[0])["measured"]) == 45
    assert "RMSE 0.1000 rad" in alone.axes[0].get_title(loc="left") + alone.axes[0].get_title()
    both = plot(Evaluation("offset", recording, q + 0.1, 0.1))
    assert set(lines(both.axes[0])) == {"commanded", "measured", "predicted"}
    nothing = Recording(q, q, np.zeros(50, bool), np.arange(50.0), "blind")
    with pytest.raises(TrocarError, match="blind has no valid row to be drawn \\(50 are marked as not valid\\)"):
        plot(nothing)


def test_dexterity_is_drawn_with_a_plan_or_without_one():
    map = dexterity(PRESETS["default"].setup)
    sutures = plan_even(map, 4)
    texts = [
        {text.get_text().strip() for text in plot(thing, **more).findobj(lambda a: hasattr(a, "get_text"))}
        for thing, more in ((map, {}), (map, {"plan": sutures}), (sutures, {"map": map, "title": "Mine"}))
    ]
    worst = f"{np.degrees(sutures.positions_rad[0]):.4g}°"
    assert not any(worst in text for text in texts[0])
    assert any(worst in text for text in texts[1]) and "Mine" in texts[2]
    with pytest.raises(TrocarError, match=r"plot\(plan, map=map\)"):
        plot(sutures)


def test_a_picture_shows_itself_and_is_a_figure_like_any_other(plan, tmp_path):
    picture = plot(plan.paths["left"])
    assert isinstance(picture, Figure)
    assert picture._repr_png_().startswith(b"\x89PNG")
    picture.savefig(tmp_path / "mine.svg")
    assert (tmp_path / "mine.svg").stat().st_size > 1000


def test_what_has_no_picture_is_named_with_what_has_one():
    with pytest.raises(TrocarError, match=r"dict has no picture; plot one of DexterityMap, .*, Trial"):
        plot({})
    none = plan_motion(
        MotionProblem({"psm1": ArmMotion(PSM_CLASSIC, [MIDDLE], LIMITS, T_base_goals=SE3.identity((1,)))})
    )
    with pytest.raises(TrocarError, match="no motion to plot: arm 'psm1', goal 0"):
        plot(none)
