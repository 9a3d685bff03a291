"""One arm's actions, with a fake robot and mover that only answer and record."""

from types import SimpleNamespace

import numpy as np
import pytest
import trio

from debridement_stage import Eyes, play
from trocar.geometry import SE3
from trocar.lab import load_station
from trocar.tasks.debridement.agents.places import Places
from trocar.tasks.debridement.agents.raven_arm import LOW_M, RavenArm
from trocar.tasks.debridement.agents.settings import best

STATION = load_station("raven-pair")
TABLE, RECEPTACLE = (STATION.T_world_fixture[name] for name in ("table", "receptacle"))


class Mover:
    """Brings the tip where each step of a list says, and notes what was asked."""

    def __init__(self, robot, steps):
        self.robot, self.steps, self.asked = robot, list(steps), []

    async def step(self, arm, asked, way_m):
        del arm, way_m
        self.asked.append(asked)
        self.robot.p = np.array(self.steps.pop(0))


def raven_arm(p, steps):
    robot = SimpleNamespace(p=np.array(p), T_world_tip=lambda _: SE3.from_parts(translation_m=robot.p))
    bases = {"left": STATION.arms["left"].T_world_base}
    problems = SimpleNamespace(cell=SimpleNamespace(T_world_base_registered=bases), robot=robot)
    places = Places(TABLE, RECEPTACLE, best())
    mover = Mover(robot, steps)
    return RavenArm(problems, "left", None, mover, places, best()), mover


def test_an_arm_that_was_stopped_low_on_its_way_rises_before_it_goes_on():
    table = float(TABLE.translation_m[2])
    low, risen, goal = table + 0.5 * LOW_M, table + LOW_M, table + 0.03
    arm, mover = raven_arm([0, 0, goal], [[0.02, 0, low], [0.02, 0, risen], [0.04, 0, goal]])
    trio.run(arm.go, SE3.from_parts(translation_m=[0.04, 0.0, goal]))
    assert [asked.straight for asked in mover.asked] == [False, True, False]
    np.testing.assert_allclose(mover.asked[1].T_world_goal.translation_m, [0.02, 0.0, risen])


@pytest.mark.slow
def test_a_fragment_over_which_an_arm_is_not_seen_is_soon_for_the_other_one(monkeypatch, tmp_path):
    eyes = Eyes()
    eyes.hidden = (("right", 1.0, np.inf),)
    trial = play(monkeypatch, tmp_path, eyes, fragments=2, budget_s=120.0)
    blocked = [e for e in trial.events if e["name"] == "fragment" and e["outcome"] == "BLOCKED"]
    assert {e["arm"] for e in blocked} == {"right"}
    assert "hidden" in blocked[0]["reason"]
    assert blocked[0]["time_s"] < 12.0
    assert sum(score["succeeded"] for score in trial.scores) == 2
