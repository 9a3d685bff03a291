"""What the arms' fingers touch, and what clings to them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.sim.world import World
from trocar.tasks.debridement.scene import Fragment

NO_FINGER = -1
SOLID = 0
"""MuJoCo's ``contact.exclude`` for contacts with force; those within the gap are merely close."""


class Fingers:
    """Evaluates the contacts between fingers and fragments.

    Args:
        world: arms and fragments in their places; fragment k is the geom and the body ``fragment{k}``.
        fragments: in that order.
    """

    def __init__(self, world: World, fragments: tuple[Fragment, ...]):
        model, self._world = world.model, world
        self._cling_n = np.array([fragment.cling_n for fragment in fragments])
        self._body = np.array([model.body(f"fragment{k}").id for k in range(len(fragments))])
        self.fragment = np.full(model.ngeom, -1)
        self.fragment[[model.geom(f"fragment{k}").id for k in range(len(fragments))]] = np.arange(len(fragments))
        self.finger = np.full(model.ngeom, NO_FINGER)
        for number, index in enumerate(world.arms.values()):
            for side, geom in enumerate(index.fingers):
                self.finger[model.geom_bodyid == model.geom_bodyid[geom]] = 2 * number + side
        self._clings = np.zeros((2 * len(world.arms), len(fragments)), dtype=bool)

    def touched(self) -> NDArray[np.bool_]:
        """Return which finger touches which fragment now, or has it clinging to it: (arms, 2, fragments)."""
        fingers, fragments, solid, _ = self._meetings()
        found: NDArray[np.bool_] = self._clings.copy()
        found[fingers[solid], fragments[solid]] = True
        return found.reshape(-1, 2, found.shape[1])

    def held(self, touched: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which fragments are between the fingers of which arm: (arms, fragments).

        Both fingers touch the same one; or each touches a different one, and these press on each other.

        Args:
            touched: (arms, 2, fragments), by finger.
        """
        held: NDArray[np.bool_] = np.all(touched, axis=1)
        one = touched & ~held[:, None]
        if np.any(np.all(np.any(one, axis=2), axis=1)):
            data = self._world.data
            pairs = self.fragment[data.contact.geom[: data.ncon]]
            near = np.eye(held.shape[1], dtype=bool)
            for first, second in pairs[(pairs >= 0).all(axis=1)]:
                near[first, second] = near[second, first] = True
            held |= (one[:, 0] & (one[:, 1] @ near)) | (one[:, 1] & (one[:, 0] @ near))
        return held

    def pull(self) -> None:
        """Make charged fragments cling: a force towards each finger that they touched, until they are out of its reach.

        The reaction on the finger, a thousandth of what the drive holds, is neglected.
        """
        if not self._cling_n.any():
            return
        data = self._world.data
        data.xfrc_applied[self._body] = 0.0
        fingers, fragments, solid, contacts = self._meetings()
        near = np.zeros_like(self._clings)
        near[fingers, fragments] = True
        self._clings &= near
        self._clings[fingers[solid], fragments[solid]] = True
        self._clings &= self._cling_n > 0
        pulls = {
            (int(finger), int(fragment)): int(contact)
            for finger, fragment, contact in zip(fingers, fragments, contacts, strict=True)
            if self._clings[finger, fragment]
        }
        for (_, fragment), contact in pulls.items():
            body = self._body[fragment]
            out = data.contact.frame[contact][:3]  # from the first geom to the second
            towards = out if self.fragment[data.contact.geom[contact][0]] >= 0 else -out
            force = self._cling_n[fragment] * towards
            data.xfrc_applied[body, :3] += force
            data.xfrc_applied[body, 3:] += np.cross(data.contact.pos[contact] - data.xipos[body], force)

    def _meetings(self) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.bool_], NDArray[np.intp]]:
        """Return finger, fragment, whether it presses, and number of each contact between the two kinds."""
        data = self._world.data
        pairs = data.contact.geom[: data.ncon]
        fingers, fragments = self.finger[pairs].max(axis=1, initial=-1), self.fragment[pairs].max(axis=1, initial=-1)
        contacts = np.flatnonzero((fingers >= 0) & (fragments >= 0))
        return fingers[contacts], fragments[contacts], data.contact.exclude[contacts] == SOLID, contacts
