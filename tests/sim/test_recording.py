"""Calibration recordings of a simulated arm, on a day on which nothing is off unless it is put there."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from simulated import ideal_session
from trocar.arms import fk
from trocar.calibration.excitation import PSM1_BOX, WIDE_ROWS
from trocar.geometry import SE3, SO3
from trocar.lab.transmission import Stiff
from trocar.sim.recording import record_motion

SD = np.array([1e-3, 2e-3, 3e-4, 4e-3, 5e-3, 6e-3])


class Scattered(Stiff):
    """Joints that follow their commands, and fiducials that scatter."""

    @property
    def measurement_sd(self):
        return SD


@pytest.mark.parametrize(("samples", "wide", "rows"), [(40, False, 40), (30, True, 30), (None, True, WIDE_ROWS)])
def test_two_swings_take_up_the_slack_before_so_many_samples_at_their_times(samples, wide, rows):
    found = record_motion(ideal_session(), "psm1", np.random.default_rng(0), PSM1_BOX, samples, wide=wide)
    assert found.valid.tolist() == [False] * 2 + [True] * rows
    assert_allclose(found.t_s, 0.8 * np.arange(1, rows + 3))
    assert_allclose(found.q_phy, found.q_cmd, atol=1e-9)
    assert (found.q_cmd[2:] >= PSM1_BOX.lower - 1e-9).all() and (found.q_cmd[2:] <= PSM1_BOX.upper + 1e-9).all()


def test_joints_are_seen_in_the_base_that_was_found_though_they_leave_the_commands_range():
    day = ideal_session()
    beside = SE3.from_parts(SO3.exp([0.01, -0.02, 0.03]), [2e-3, 1e-3, -3e-3])
    found = replace(day, T_world_base_registered=day.T_world_base | {"psm1": day.T_world_base["psm1"] @ beside})
    rows = record_motion(found, "psm1", np.random.default_rng(0), PSM1_BOX, 20)
    arm = day.station.arm("psm1").model
    told, seen = fk(arm, rows.q_cmd), beside @ fk(arm, rows.q_phy)
    assert_allclose(seen.matrix, told.matrix, atol=1e-9)


def test_fiducials_scatter_as_much_as_they_should():
    day = ideal_session()
    day = replace(day, transmissions={"psm1": Scattered()})
    rows = record_motion(day, "psm1", np.random.default_rng(0), PSM1_BOX, 1000)
    assert_allclose((rows.q_phy - rows.q_cmd)[2:].std(axis=0), SD, rtol=0.1)
