from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from trocar.errors import TrocarError
from trocar.tasks.suture.planning import PRESETS, Reward, SutureSetup, dexterity, plan_even
from trocar.tasks.suture.planning.setup import mirrored
from trocar.tasks.suture.planning.study import (
    PAPER_TABLE_1,
    LambdaSweep,
    fitted_note,
    gains,
    lambda_sweep,
    plan_values,
    study,
    table_1,
)

DEMO = PRESETS["paper-demo"]


@pytest.fixture(scope="module")
def demo():
    return study(dexterity(DEMO.setup, DEMO.reward))


def test_the_demo_comes_within_four_points_and_five_degrees_of_the_paper_in_a_grip_that_jaws_hold(demo):
    summary = demo.summary()
    assert np.abs(demo.points - PAPER_TABLE_1).max() < 4
    assert len(summary["switches_deg"]) == 2
    assert max(summary["switches_off_paper_deg"]) < 5
    assert summary["infeasible_positions"] == 0
    assert np.all(np.degrees(demo.wrist_rad).max(0) < summary["wrist_limits_deg"])
    assert DEMO.setup.grasp.holdable and demo.map.joints.above_tissue_m.min() > 0


def test_table_1_is_the_mean_and_the_maximum_over_every_plan_one_by_one():
    found = dexterity(DEMO.setup, DEMO.reward)
    rows = {"clockwise": found.values[0], "counterclockwise": found.values[1], "best": found.best}
    plans = {name: [min(row[start::90]) for start in range(90)] for name, row in rows.items()}
    best = max(plans["best"])
    expected = [
        [100 * sum(plan) / 90 / best for plan in plans.values()],
        [100 * max(plan) / best for plan in plans.values()],
    ]
    np.testing.assert_allclose(table_1(found), expected, rtol=1e-12)


def test_the_papers_own_gains_are_its_11_to_57_percent_as_differences_in_points():
    found = gains(PAPER_TABLE_1)
    assert [row["points"] for row in found.values()] == pytest.approx([11.4, 34.4, 57.2])
    assert [row["ratio_percent"] for row in found.values()] == pytest.approx([12.87, 52.44, 133.64], abs=0.01)


def test_the_summary_says_where_the_best_plan_starts_and_where_each_arm_moves_best(demo):
    summary, angles = demo.summary(), np.arange(360)
    assert summary["best_theta_deg"] == pytest.approx(np.degrees(plan_even(demo.map).positions_rad[0]))
    for highest, curve in zip(summary["manipulability_highest_at_deg"], demo.map.by_arm, strict=True):
        assert curve[angles == round(highest)] == curve.max()
    row = demo.map.choice
    q = demo.map.joints.q[row, angles][..., 3:]
    assert summary["largest_wrist_deg"][1:] == pytest.approx(np.degrees(np.abs(q).max((0, 1)))[1:], abs=1e-6)


def test_the_sweep_scales_each_function_to_ten_and_agrees_with_plans_made_one_by_one(demo):
    sweep = demo.sweep
    assert sweep.rewards.shape == (11, 90)
    np.testing.assert_allclose(sweep.rewards[[0, -1]].max(1), 10)
    found = demo.map
    margin, ease = found.margin[found.choice, np.arange(360)], found.manipulability
    margin, ease = 10 * margin / plan_values(margin).max(), 10 * ease / plan_values(ease).max()
    at = 37 + 90 * np.arange(4)
    assert sweep.rewards[3, 37] == pytest.approx(min(0.3 * margin[at] + 0.7 * ease[at]))


def test_the_way_of_the_best_plan_with_lambda_is_the_shorter_one_mod_90_and_the_papers(demo):
    starts = np.degrees(demo.sweep.best_theta_rad)
    steps = [(after - before + 45) % 90 - 45 for before, after in pairwise(starts)]
    assert (starts < 90).all()
    assert np.degrees(demo.sweep.travel_rad) == pytest.approx(sum(steps))
    summary = demo.summary()["lambda_sweep"]
    assert summary["reproduces_paper"]
    low, high = (round(10 * weight) for weight in summary["like_paper_weights"])
    assert low < high and abs(starts[low] - 28) <= 5 and abs(starts[high] - 11) <= 5
    assert max(steps[low:high]) <= 1 and sum(steps[low:high]) < 0


def swept(*starts):
    """Return a sweep whose best plans start at these whole degrees."""
    rewards = -np.abs((np.arange(90) - np.array(starts)[:, None] + 45) % 90 - 45.0)
    return LambdaSweep(np.linspace(0, 1, len(starts)), np.radians(np.arange(90)), rewards)


@pytest.mark.parametrize(
    ("starts", "pair"),
    [
        ((29, 20, 10), (0.0, 1.0)),
        ((60, 40, 27, 20, 21, 14, 11, 80), (2 / 7, 6 / 7)),  # before and after it, the plan goes where it likes
        ((23, 15, 11), (0.0, 1.0)),
        ((22, 15, 11), None),  # 6 deg from the paper's first
        ((28, 23, 17), None),  # and from its last
        ((11, 20, 28), None),  # the other way
        ((28, 20, 22, 11), None),  # two steps back
        ((28, 60, 85, 11), None),  # the long way round
    ],
)
def test_a_sweep_is_the_papers_if_part_of_it_turns_from_28_to_11_deg(starts, pair):
    found = swept(*starts).summary()
    assert found["reproduces_paper"] is (pair is not None)
    assert found["like_paper_weights"] == (None if pair is None else pytest.approx(list(pair)))


def test_what_was_fitted_is_part_of_the_summary(demo):
    assert demo.summary()["fitted"] == []
    assert study(demo.map, DEMO.fitted).summary()["fitted"] == list(DEMO.fitted)
    note = fitted_note(DEMO.fitted)
    assert note.startswith("5 numbers of the setup (base tilt, base spin, grasp behind tip")
    assert fitted_note(()) == ""


def test_the_second_arm_sees_the_circle_in_a_mirror(demo):
    there = (180 - np.arange(360)) % 360
    first, second = demo.map.by_arm
    np.testing.assert_allclose(second, first[there], rtol=1e-9)
    np.testing.assert_allclose(demo.map.manipulability, (first + second) / 2, rtol=1e-12)
    image = study(dexterity(mirrored(DEMO.setup), DEMO.reward))
    np.testing.assert_allclose(image.map.margin[::-1, there], demo.map.margin, rtol=1e-7)
    np.testing.assert_allclose(image.points[:, [1, 0, 2]], demo.points, atol=1e-6)


def test_a_mirror_of_a_mirror_is_the_setup_wherever_the_circle_lies():
    moved = replace(DEMO.setup, circle=replace(DEMO.setup.circle, T_world_circle=DEMO.setup.T_world_base))
    again = mirrored(mirrored(moved))
    np.testing.assert_allclose(again.T_world_base.matrix, moved.T_world_base.matrix, atol=1e-15)
    assert again.grasp == moved.grasp


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: study(dexterity(SutureSetup(), positions=90)), "90 positions do not hold 4"),
        (lambda: lambda_sweep(dexterity(SutureSetup()), ()), "give one or more, each 0 to 1"),
        (lambda: lambda_sweep(dexterity(SutureSetup()), (0.5, 1.2)), "1.2"),
    ],
)
def test_bad_input_is_told_in_a_sentence(call, sentence):
    with pytest.raises(TrocarError, match=sentence):
        call()


def test_a_table_without_a_plan_of_positive_reward_is_refused():
    found = dexterity(DEMO.setup, Reward())
    with pytest.raises(TrocarError, match="no points"):
        table_1(replace(found, values=np.minimum(found.values, -1.0)))
