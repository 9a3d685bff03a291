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


def put_state(model: mujoco.MjModel, data: mujoco.MjData, state: bytes) -> None:
    """Bring a copy of a world into a state that :func:`state_of` returned; all bodies are in their places then."""
    mujoco.mj_setState(model, data, np.frombuffer(state), WHOLE)
    mujoco.mj_kinematics(model, data)
