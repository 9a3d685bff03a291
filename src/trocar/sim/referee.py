"""The referee sees everything and tells no agent: block poses, tips, collisions."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.arms import fk
from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.scene import Scene
from trocar.scene.truth import Collision, Truth
from trocar.sim.world import World

SAMPLE_TICKS = 5
"""Controller ticks between two samples of the poses: 20 Hz."""
HIT_N = 0.5
"""A touch of a peg's side with less force than this is sliding, not a collision; .5 N bends no peg visibly."""
APART_S = 0.2
"""A touch that comes back within this time is the same collision."""


@dataclass
class _Touch:
    first_s: float
    last_s: float
    force_n: float


class Referee:
    """Watches a world with a pegboard tick by tick."""

    def __init__(self, world: World):
        self._world = world
        scene = world.cell.scene
        if not isinstance(scene, Scene):
            raise TrocarError(f"a referee of pegs cannot judge a {type(scene).__name__}")
        self._T_board_world = scene.T_world_board.inverse()
        self._ticks = 0
        self._times: list[float] = []
        self._blocks: list[NDArray[np.float64]] = []
        self._states: list[NDArray[np.float64]] = []
        self._tips: dict[str, list[NDArray[np.float64]]] = {name: [] for name in world.arms}
        self._open: dict[tuple[str, str, str], _Touch] = {}
        self._collisions: list[Collision] = []
        self._owner = np.full(world.model.ngeom, -1)
        for number, index in enumerate(world.arms.values()):
            self._owner[index.geoms] = number
        self._names = list(world.arms)

    def observe(self) -> None:
        """Look once; called after each tick of the controller."""
        if self._ticks % SAMPLE_TICKS == 0:
            self._sample()
        self._ticks += 1
        self._touches()

    def _sample(self) -> None:
        world = self._world
        self._times.append(world.time_s)
        self._states.append(world.data.qpos.copy())
        self._blocks.append((self._T_board_world @ world.blocks()).matrix)
        for name, arm in world.cell.arms.items():
            T = self._T_board_world @ world.cell.T_world_base[name] @ fk(arm, world.joints(name))
            self._tips[name].append(T.translation_m)

    def _touches(self) -> None:
        data, world = self._world.data, self._world
        pairs = data.contact.geom[: data.ncon]
        if not len(pairs):
            return
        owner = self._owner[pairs]
        held = self._held(pairs, owner)
        for contact in np.flatnonzero((owner >= 0).any(1) | (world.geom_peg[pairs] >= 0).any(1)):
            hit = self._hit(pairs[contact], owner[contact], held)
            if hit is not None:
                force = np.zeros(6)
                mujoco.mj_contactForce(world.model, data, int(contact), force)
                steep = abs(data.contact.frame[contact][2]) > 0.7
                if force[0] > HIT_N and not (steep and hit[2].startswith("peg")):
                    self._note(hit, float(force[0]))

    def _held(self, pairs: NDArray[np.int32], owner: NDArray[np.intp]) -> dict[int, str]:
        """Return the blocks that both fingers of an arm touch, with that arm's name."""
        held = {}
        block = self._world.geom_block[pairs]
        for number, (name, index) in enumerate(self._world.arms.items()):
            rows = (owner == number).any(1) & (block >= 0).any(1)
            touching = {finger: set(block[rows & (pairs == finger).any(1)].max(1).tolist()) for finger in index.fingers}
            for candidate in set.intersection(*touching.values()):
                held[candidate] = name
        return held

    def _hit(
        self, pair: NDArray[np.int32], owner: NDArray[np.intp], held: dict[int, str]
    ) -> tuple[str, str, str] | None:
        """Return (arm, what, against) if this contact is one that counts."""
        for a, b in ((0, 1), (1, 0)):
            peg = self._world.geom_peg[pair[b]]
            if owner[a] >= 0 and peg >= 0:
                return self._names[owner[a]], "arm", f"peg {peg}"
            block = self._world.geom_block[pair[a]]
            if block in held and peg >= 0:
                return held[int(block)], "held block", f"peg {peg}"
        if owner[0] >= 0 and owner[1] >= 0:
            return self._names[owner[0]], "arm", self._names[owner[1]]
        return None

    def _note(self, key: tuple[str, str, str], force_n: float) -> None:
        now = self._world.time_s
        touch = self._open.get(key)
        if touch is not None and now - touch.last_s <= APART_S:
            touch.last_s, touch.force_n = now, max(touch.force_n, force_n)
            return
        if touch is not None:
            self._close(key, touch)
        self._open[key] = _Touch(now, now, force_n)

    def _close(self, key: tuple[str, str, str], touch: _Touch) -> None:
        self._collisions.append(Collision(round(touch.first_s, 6), *key, round(touch.force_n, 3)))

    def arrays(self) -> dict[str, NDArray]:
        """Return what a trial keeps of what was seen."""
        truth = self.truth()
        return {
            "times_s": truth.times_s,
            "blocks": truth.T_board_blocks.matrix.astype(np.float32),
            "qpos": self.states().astype(np.float32),
            **{f"tip_{arm}": tips.astype(np.float32) for arm, tips in truth.p_board_tips.items()},
        }

    def states(self) -> NDArray[np.float64]:
        """Return the whole world's positions (n, nq) at the truth's times, to draw or replay them."""
        return np.array(self._states)

    def truth(self) -> Truth:
        """Return all that was seen so far."""
        pending = [Collision(round(t.first_s, 6), *key, round(t.force_n, 3)) for key, t in self._open.items()]
        collisions = sorted([*self._collisions, *pending], key=lambda c: (c.time_s, c.arm, c.against))
        return Truth(
            times_s=np.array(self._times),
            T_board_blocks=SE3(np.array(self._blocks)),
            p_board_tips={name: np.array(rows).reshape(-1, 3) for name, rows in self._tips.items()},
            collisions=tuple(collisions),
        )
