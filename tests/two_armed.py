"""Two arms of an ideal cell play transfers, with devices that fail where a test wants them to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import trio

from simulated import STATION, coarse, ideal_laboratory, standing
from trocar.arms import capsules
from trocar.cell import MotionEnd, MotionResult
from trocar.errors import ArmStopped, NoPlan
from trocar.eval import AgentContext
from trocar.geometry.capsules import capsule_distances_m
from trocar.motion import PLANNERS
from trocar.sim.laboratory import SimLaboratory
from trocar.tasks.peg_transfer.agents import Settings, agent_of
from trocar.tasks.peg_transfer.goals import PegSet, Transfer
from trocar.tasks.peg_transfer.perception import DepthView
from trocar.tasks.peg_transfer.truth import TransferScore, score_transfers

SETTINGS = Settings()
BLOCKS = tuple(range(6))


class Wrapped:
    """A robot that does what another does, but for what a subclass changes."""

    def __init__(self, inner):
        self.inner = inner

    def __getattr__(self, name):
        return getattr(self.inner, name)


def silent(arm: str, motion: int, share: float = 0.0):
    """Return a robot one of whose arms stops after a share of its motion of this number, and moves no more."""

    class Silent(Wrapped):
        count = 0

        async def move(self, motions):
            if arm not in motions:
                return await self.inner.move(motions)
            self.count += 1
            if self.count < motion:
                return await self.inner.move(motions)
            if self.count == motion and share:
                async with trio.open_nursery() as nursery:
                    nursery.start_soon(self.stop, share * motions[arm].duration_s)
                    await self.inner.move(motions)
            return {arm: MotionResult.not_started(MotionEnd.FAULT, ArmStopped(arm, f"{arm} is silent"))}

        async def stop(self, after_s):
            await trio.sleep(after_s)
            self.inner.hold(arm)

    return Silent


def stuck(arm: str):
    """Return a robot one of whose arms cannot close its jaws."""

    class Stuck(Wrapped):
        async def jaw(self, name, angle_rad):
            return await self.inner.jaw(name, max(angle_rad, SETTINGS.release_rad) if name == arm else angle_rad)

    return Stuck


def clumsy(arm: str):
    """Return a robot one of whose arms opens its jaws on every way that it makes with a block in them."""

    class Clumsy(Wrapped):
        closed = False

        async def jaw(self, name, angle_rad):
            if name == arm:
                self.closed = angle_rad < 0
            return await self.inner.jaw(name, angle_rad)

        async def move(self, motions):
            if arm in motions and self.closed:
                await self.inner.jaw(arm, 0.6)
                done = await self.inner.move(motions)
                await self.inner.jaw(arm, SETTINGS.jaw_closed_rad)
                return done
            return await self.inner.move(motions)

    return Clumsy


def no_way(problem):
    """Plan nothing."""
    raise NoPlan("this planner finds nothing")


def played(
    variant: str,
    goals: Sequence[Transfer],
    *,
    blocks: Sequence[int] = BLOCKS,
    robot=Wrapped,
    planner=PLANNERS["spline"],
    budget_s: float = 60.0,
    settings: Settings = SETTINGS,
) -> tuple[SimLaboratory, bool, list[TransferScore]]:
    """Let two arms do transfers in an ideal cell; return the laboratory, whether they ended in time, the scores."""
    places = [standing(peg, (0.5e-3, 0.3e-3), 0.3 + peg) for peg in blocks]
    lab = ideal_laboratory(*places, station=coarse(STATION))
    lab.wrap_robot(lambda cell: robot(cell.robot))
    context = AgentContext(
        cell=lab.cell,
        goals=goals,
        nominal=PegSet(variant=variant),
        arms=("psm1", "psm2"),
        planner=planner,
        perception=DepthView(),
        rng=np.random.default_rng(0),
        settings=replace(settings),
    )
    agent = agent_of(context)
    in_time = lab.run(lambda cell: agent.run(), budget_s)
    return lab, in_time, score_transfers(goals, lab.truth(), lab.log.events, handover=variant == "handover")


def named(lab: SimLaboratory, name: str) -> list:
    """Return the events of this name."""
    return [event for event in lab.log.events if event["name"] == name]


def distance_of_arms_m(lab: SimLaboratory) -> float:
    """Return the least distance of the two instruments, from the true joints at 100 Hz."""
    both = []
    for name, rows in lab.recorder.joints("true").items():
        model = lab.session.station.arms[name].model
        both.append(capsules(model, rows[:, :6], rows[:, 6]).moved(lab.session.T_world_base[name]))
    return float(capsule_distances_m(*both).min())


def at_rest(lab: SimLaboratory) -> bool:
    """Return whether no arm is told to move."""
    return not any(lab.cell.robot.setpoint(name).moving for name in lab.cell.arms)
