"""The joints beside a scene: a table of all, curves of one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from made_up_replay import JOINTS, made_up_replay
from trocar.errors import TrocarError
from trocar.view.joints_panel import POINTS, Joints
from trocar.view.timeline import WINDOW_S

REPLAY = made_up_replay(12.0)
TICK = 650


def joints(*kinds):
    return Joints.of(replace(REPLAY, joints={"psm1": {k: REPLAY.joints["psm1"][k] for k in kinds}}), "psm1")


def test_the_table_has_every_joint_in_its_unit_with_its_error():
    table = Joints.of(REPLAY, "psm1").table(TICK).splitlines()
    assert table[0] == "| joint | desired | commanded | measured | true | true - desired |"
    assert len(table) == 2 + 7
    true, asked = (REPLAY.joints["psm1"][kind][TICK] for kind in ("true", "desired"))
    for k, (row, name) in enumerate(zip(table[2:], JOINTS, strict=True)):
        scale, unit = (1e3, "mm") if name == "insertion" else (180 / np.pi, "deg")
        cells = [cell.strip() for cell in row.strip("|").split("|")]
        assert cells[0] == f"{name.replace('_', ' ')}, {unit}"
        assert float(cells[1]) == pytest.approx(scale * asked[k], abs=0.051)
        assert float(cells[-1].strip("*")) == pytest.approx(scale * (true - asked)[k], abs=0.0051)


def test_what_there_is_is_compared_under_the_names_that_there_are():
    one, two = joints("true"), joints("commanded", "measured")
    assert one.table(0).splitlines()[0] == "| joint | true |"
    assert two.table(0).splitlines()[0] == "| joint | commanded | measured | measured - commanded |"
    assert Joints.of(replace(REPLAY, joints={}), "psm1") is None
    assert "joint 1, deg" in Joints.of(replace(REPLAY, joint_names={}), "psm1").table(0)


def test_curves_are_errors_in_degrees_about_now():
    seconds, commanded, measured, true = Joints.of(REPLAY, "psm1").errors_near(TICK, 4)
    assert_allclose(seconds[[0, -1]], [-WINDOW_S, WINDOW_S], atol=0.06)
    assert len(seconds) <= 2 * POINTS
    assert_allclose(np.degrees(0.002), commanded)
    assert_allclose(np.degrees(0.001), measured)
    assert_allclose(true, -np.degrees(0.01) * np.sin(0.8 * (6.5 + seconds)), atol=1e-9)
    first = Joints.of(REPLAY, "psm1").errors_near(0, 0)[0]
    assert_allclose(first[[0, -1]], [0, WINDOW_S], atol=0.06)  # none before the trial


def test_arrays_of_another_shape_are_told():
    with pytest.raises(TrocarError, match=r"the true joints of 'psm1' have shape \(3, 7\); give \(1201, 7\)"):
        Joints.of(replace(REPLAY, joints={"psm1": {"true": np.zeros((3, 7))}}), "psm1")
