"""Transfers in an ideal cell, with devices that fail where a test wants them to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import trio

from simulated import STATION, coarse, ideal_laboratory, standing
from trocar.arms import capsules
from trocar.cell import SEAT, MotionEnd, MotionResult
from trocar.errors import ArmStopped
from trocar.eval import AgentContext
from trocar.geometry import SE3
from trocar.geometry.capsules import capsule_distances_m
from trocar.motion import PLANNERS
from trocar.sim.laboratory import SimLaboratory
from trocar.tasks.peg_transfer.agents import Settings, agent_of
from trocar.tasks.peg_transfer.goals import PegSet, Transfer
from trocar.tasks.peg_transfer.perception import DepthView
from trocar.tasks.peg_transfer.truth import TransferScore, score_transfers

SETTINGS = Settings(jaw_play_rad=0.0)  # the ideal laboratory has none


class Wrapped:
    """A device that passes everything on to another one; subclasses override what should fail."""

    def __init__(self, inner):
        self.inner = inner

    def __getattr__(self, name):
        return getattr(self.inner, name)


def silent(arm: str, motion: int, share: float = 0.0):
    """Return a wrapper whose ``arm`` stops for good after ``share`` of its ``motion``-th motion."""

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


def stuck(arm: str, closings: int | None = None):
    """Return a wrapper whose ``arm`` cannot close its jaws: at the first ``closings`` blocks, or (None) ever."""

    class Stuck(Wrapped):
        tried = -1  # agents first close the jaws on nothing, to read their encoder: does not count

        async def jaw(self, name, angle_rad):
            if name == arm and angle_rad < 0.1:
                self.tried += 1
                if closings is None or 1 <= self.tried <= closings:
                    angle_rad = SETTINGS.release_rad
            return await self.inner.jaw(name, angle_rad)

    return Stuck


class Chooser:
    """A person at a console, who chooses goals by these numbers among those offered; keeps what was offered."""

    def __init__(self, *numbers):
        self.numbers, self.offered = list(numbers), []

    async def choose(self, goals):
        self.offered.append(goals)
        return self.numbers.pop(0)


def played(
    variant: str,
    goals: Sequence[Transfer],
    *,
    blocks: Sequence[SE3] | None = None,
    robot=Wrapped,
    camera=Wrapped,
    arms: Sequence[str] = (),
    budget_s: float = 60.0,
    settings: Settings = SETTINGS,
    perception=None,
    registered_off_m: Mapping[str, Sequence[float]] = {},
    person: Chooser | None = None,
) -> tuple[SimLaboratory, bool, list[TransferScore]]:
    """Play transfers in an ideal cell; return the laboratory, whether the agent ended in time, and the scores.

    ``registered_off_m``: offset (3,), in the world, of an arm's registered base from its true one.
    """
    blocks = blocks or [standing(peg, (0.5e-3, 0.3e-3), 0.3 + peg) for peg in range(6)]
    lab = ideal_laboratory(*blocks, station=coarse(STATION))
    lab.wrap_robot(lambda cell: robot(cell.robot))
    bases = dict(lab.cell.T_world_base_registered)
    bases |= {name: SE3.from_parts(translation_m=off_m) @ bases[name] for name, off_m in registered_off_m.items()}
    cameras = {name: camera(device) for name, device in lab.cell.cameras.items()}
    seated = {SEAT: person} if person else {}
    lab.cell = replace(lab.cell, cameras=cameras, T_world_base_registered=bases, assistants=seated)
    agent = agent_of(briefed(lab, variant, goals, arms=arms, settings=settings, perception=perception))
    in_time = lab.run(lambda cell: agent.run(), budget_s)
    return lab, in_time, score_transfers(goals, lab.truth(), lab.log.events, handover=variant == "handover")


def briefed(
    lab, variant: str = "unilateral", goals=(), *, arms=(), settings: Settings = SETTINGS, perception=None
) -> AgentContext:
    """Return the context of an agent in a laboratory; by default, its arms are those of the variant."""
    arms = arms or (("psm1",) if variant == "unilateral" else ("psm1", "psm2"))
    rng, perception = np.random.default_rng(0), perception or DepthView()
    return AgentContext(lab.cell, goals, PegSet(variant=variant), arms, PLANNERS["spline"], perception, rng, settings)


def named(lab: SimLaboratory, name: str) -> list:
    """Return the events of this name."""
    return [event for event in lab.log.events if event["name"] == name]


def distance_of_arms_m(lab: SimLaboratory) -> float:
    """Return the least distance between the two instruments, from the true joints at 100 Hz."""
    both = []
    for name, rows in lab.recorder.joints("true").items():
        model = lab.session.station.arms[name].model
        both.append(capsules(model, rows[:, :6], rows[:, 6]).moved(lab.session.T_world_base[name]))
    return float(capsule_distances_m(*both).min())


def at_rest(lab: SimLaboratory) -> bool:
    """Return whether no arm's set-point is moving."""
    return not any(lab.cell.robot.setpoint(name).moving for name in lab.cell.arms)
