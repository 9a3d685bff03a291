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


def test_the_demo_comes_within_four_points_and_five_degrees_of_the_paper(demo):
    summary = demo.summary()
    assert np.abs(demo.points - PAPER_TABLE_1).max() < 4
    assert len(summary["switches_deg"]) == 2
    assert max(summary["switches_off_paper_deg"]) < 5
    assert summary["infeasible_positions"] == 0
    assert np.all(np.degrees(demo.wrist_rad).max(0) < summary["wrist_limits_deg"])


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


def test_the_way_of_the_best_plan_with_lambda_is_the_shorter_one_mod_90_and_not_the_papers(demo):
    starts = np.degrees(demo.sweep.best_theta_rad)
    steps = [(after - before + 45) % 90 - 45 for before, after in pairwise(starts)]
    assert (starts < 90).all()
    assert np.degrees(demo.sweep.travel_rad) == pytest.approx(sum(steps))
    assert sum(steps) > 45, "the paper's turns the other way, by 17 deg"
    summary = demo.summary()["lambda_sweep"]
    assert not summary["reproduces_paper"]
    first, last, way = summary["off_paper_deg"]
    assert (first, last, way) == pytest.approx((abs(starts[0] - 28), abs(starts[-1] - 11), sum(steps) + 17))


def test_a_sweep_like_the_papers_is_told_as_reproduced():
    thetas = np.radians(np.arange(90))
    rewards = -np.abs(np.arange(90) - np.array([[29.0], [20.0], [10.0]]))
    sweep = LambdaSweep(np.array([0.0, 0.5, 1.0]), thetas, rewards)
    assert np.degrees(sweep.travel_rad) == pytest.approx(-19)
    assert sweep.off_paper_deg == pytest.approx((1, 1, 2))
    assert sweep.summary()["reproduces_paper"]


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
