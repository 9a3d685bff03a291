"""The state of a cell's physics, so that another process can see it: a few kilobytes."""

from __future__ import annotations

import mujoco
import numpy as np

from trocar.sim.world import World

WHOLE = mujoco.mjtState.mjSTATE_INTEGRATION


def state_of(world: World) -> bytes:
    """Return everything that determines the physics from here on."""
    state = np.empty(mujoco.mj_stateSize(world.model, WHOLE))
    mujoco.mj_getState(world.model, world.data, state, WHOLE)
    return state.tobytes()


class WorldCopy:
    """The bodies of a world in another process.

    Attributes:
        data: of the physics; its bodies are in their places.
    """

    def __init__(self, model: mujoco.MjModel):
        self._model, self.data = model, mujoco.MjData(model)
        mujoco.mj_kinematics(model, self.data)

    def put(self, state: bytes) -> None:
        """Bring it into a state that :func:`state_of` returned."""
        mujoco.mj_setState(self._model, self.data, np.frombuffer(state), WHOLE)
        mujoco.mj_kinematics(self._model, self.data)
