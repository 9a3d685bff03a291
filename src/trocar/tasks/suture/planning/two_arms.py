"""Plan what two arms do to sew round a circle: who holds the needle how, from its stand to the last pull."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, capsules, fk, ik_unbounded
from trocar.errors import OutOfReach
from trocar.geometry import SE3, TURN
from trocar.geometry.capsules import capsule_distances_m
from trocar.tasks.suture.demonstrations import Demonstrations
from trocar.tasks.suture.planning.clearance import APART_M, JAW_OPEN_RAD
from trocar.tasks.suture.planning.handover import Handover, Holder, between, handover_places, plan_handovers, taking
from trocar.tasks.suture.planning.plan import Planner, SuturePlan
from trocar.tasks.suture.planning.primitive import Suture, sutures_at
from trocar.tasks.suture.planning.pull import (
    LIFTED_M,
    ROOM_RAD,
    Pull,
    grip_segments,
    holding_still,
    out_segments,
    plan_pull,
    reach_segment,
    room_rad,
    shifted,
)
from trocar.tasks.suture.planning.rewards import DexterityMap, Preset, dexterity
from trocar.tasks.suture.planning.segments import UP, Segment
from trocar.tasks.suture.planning.setup import Puller, SutureSetup
from trocar.tasks.suture.planning.summary import misplaced_port
from trocar.tasks.suture.stand import T_stand_needle


@dataclass(frozen=True, eq=False)
class SecondArm:
    """The arm that pulls.

    Attributes:
        model: the arm's model.
        T_world_base: pose of its base.
        home_q: (6,) where it rests while the first arm drives.
    """

    model: ArmModel
    T_world_base: SE3
    home_q: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class TwoArmPlan:
    """What the two arms do between the first one's sutures.

    Attributes:
        stand: the first arm's paths to its grasp of the needle in the stand, and up from there with the needle.
        pulls: the second arm's part of each suture.
        handovers: from each suture to the next, the best first; one set fewer than there are sutures.
    """

    stand: tuple[Segment, Segment]
    pulls: tuple[Pull, ...]
    handovers: tuple[tuple[Handover, ...], ...]

    def joints(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return all joints (n, 6) of the first arm, and (k, 6) of the second, on these paths."""
        first = [*self.stand, *(each.take for alternatives in self.handovers for each in alternatives)]
        second = [way for pull in self.pulls for grip in pull.grips for way in grip_segments(grip)]
        second += [way for pull in self.pulls for way in out_segments(pull.grips[-1])]
        second += [each.part for alternatives in self.handovers for each in alternatives]
        return np.concatenate([way.q for way in first]), np.concatenate([way.q for way in second])


def plan_pulled(
    preset: Preset,
    planner: Planner,
    positions: int,
    first_home_q: NDArray[np.float64],
    second: SecondArm,
    recorded: Demonstrations | None = None,
) -> tuple[DexterityMap, SuturePlan]:
    """Return the map of a setup with the second arm's port, and the best plan whose needles this arm can pull through.

    Feasibility comes first. Sutures of the best plan that the second arm cannot pull through are forbidden, and the
    best remaining plan is taken, until all can be pulled or no plan is feasible. So no better plan is overlooked.

    Args:
        preset: setup and reward.
        planner: makes the best plan of a map.
        positions: of the grid.
        first_home_q: (6,) where the first arm rests while the second one moves.
        second: the other arm.
        recorded: demonstrations that M comes from; default: the surrogate.
    """
    setup = replace(preset.setup, puller=Puller.at(second.T_world_base.translation_m))
    map = dexterity(setup, replace(preset.reward, feasible_first=True), positions, recorded)
    pulled: set[tuple[int, int]] = set()
    while (plan := planner(map)).feasible:
        forbidden = []
        for suture in sutures_at(setup, plan.positions_rad, plan.directions):
            place = (suture.row, round(suture.theta_rad * positions / TURN))
            if place in pulled:
                continue
            try:
                plan_pull(suture, second.model, second.T_world_base, first_home_q)
                pulled.add(place)
            except OutOfReach:
                forbidden.append(place)
        if not forbidden:
            break
        apart_m = map.joints.arms_apart_m.copy()
        apart_m[tuple(np.transpose(forbidden))] = -np.inf
        map = replace(map, joints=replace(map.joints, arms_apart_m=apart_m))
    return map, plan


def plan_two_arms(
    sutures: Sequence[Suture],
    home_q: NDArray[np.float64],
    second: SecondArm,
    T_world_stand: SE3,
    cameras: Sequence[SE3],
) -> TwoArmPlan:
    """Return how the first arm takes the needle from its stand, and how the second pulls it through and hands it back.

    Args:
        sutures: in order, with the first arm and its base.
        home_q: (6,) where the first arm rests while the second one moves.
        second: the other arm.
        T_world_stand: pose of the stand, z up.
        cameras: the cameras' poses in the world; the one nearest to the circle looks at the needle.

    Raises:
        OutOfReach: an arm cannot do its part; the message names it.
    """
    setup = sutures[0].setup
    if misplaced := misplaced_port(replace(setup, puller=Puller.at(second.T_world_base.translation_m))):
        raise OutOfReach(f"{misplaced}; move it or the wall")
    T_circle_world = setup.circle.T_world_circle.inverse()
    eyes_m = [T_circle_world.apply(camera.translation_m) for camera in cameras]
    places = handover_places(setup, min(eyes_m, key=lambda place: float(np.linalg.norm(place))))
    stand = from_stand(sutures[0], T_world_stand)
    pulls, handovers = [], []

    def handover_room_rad(giver: SutureSetup) -> float:
        return float(places.both_rad(giver).max())

    for suture in sutures:
        ends = len(pulls) + 1 == len(sutures)
        pull = plan_pull(suture, second.model, second.T_world_base, home_q, None if ends else handover_room_rad)
        last = pull.grips[-1]
        _require_apart(second, between(second.home_q, reach_segment(pull.grips[0]).q[0]), suture)
        pulls.append(pull)
        if not ends:
            giver = Holder(last.setup, second.home_q, out_segments(last)[-1].q[-1])
            handovers.append(plan_handovers(giver, Holder(setup, home_q, home_q), places))
    return TwoArmPlan(stand, tuple(pulls), tuple(handovers))


def from_stand(suture: Suture, T_world_stand: SE3) -> tuple[Segment, Segment]:
    """Return the first arm's paths to its grasp of the needle in the stand, and straight up with the needle.

    Raises:
        OutOfReach: the arm does not reach the needle there.
    """
    setup = suture.setup
    T_circle_needle = setup.circle.T_world_circle.inverse() @ T_world_stand @ T_stand_needle(setup.needle)
    take = taking(setup, T_circle_needle)
    q = take.q[-1]
    if not np.isfinite(take.q).all() or room_rad(setup.arm, take.q).min() < ROOM_RAD:
        raise OutOfReach("the first arm does not reach the needle in its stand; put the fixture 'stand' elsewhere")
    return take, replace(rising(setup, q), name="lift")


def rising(setup: SutureSetup, q: NDArray[np.float64]) -> Segment:
    """Return the path straight up from joints (6,)."""
    up = shifted(setup.T_base_circle.inverse() @ fk(setup.arm, q), np.zeros(3), LIFTED_M * UP)
    risen = ik_unbounded(setup.arm, setup.T_base_circle @ up, near=np.broadcast_to(q, (len(up.matrix), 6)))
    return Segment("rise", risen, LIFTED_M)


def _require_apart(second: SecondArm, path: NDArray[np.float64], suture: Suture) -> None:
    """Raise OutOfReach if the second arm, on this path to a suture's end, comes too near to the first arm there."""
    coming = capsules(second.model, path, JAW_OPEN_RAD).moved(second.T_world_base)
    if capsule_distances_m(coming, holding_still(suture)).min() < APART_M:
        raise OutOfReach(f"the second arm meets the first on its way to {suture}; place it elsewhere")
