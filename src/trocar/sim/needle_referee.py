"""The referee of sutures: needle, jaws and joints as they really were."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.arms import fk
from trocar.errors import TrocarError
from trocar.geometry import SE3
from trocar.scene import SutureScene
from trocar.scene.truth import NeedleTruth
from trocar.sim.needle import HeldNeedle
from trocar.sim.referee import SAMPLE_TICKS
from trocar.sim.world import World


class NeedleReferee:
    """Watches needle and arm at every tick of the controller."""

    def __init__(self, world: World, needle: HeldNeedle, arm: str):
        scene = world.cell.scene
        if not isinstance(scene, SutureScene):
            raise TrocarError(f"a referee of needles cannot judge a {type(scene).__name__}")
        self._world, self._needle, self._arm = world, needle, arm
        self._scene = scene
        self._T_circle_world = scene.T_world_circle.inverse()
        self._T_circle_base = self._T_circle_world @ world.cell.T_world_base[arm]
        self._times: list[float] = []
        self._poses: list[NDArray[np.float64]] = []
        self._joints: list[NDArray[np.float64]] = []
        self._states: list[NDArray[np.float64]] = []
        self._state_times: list[float] = []

    def observe(self) -> None:
        """Look once; called after each tick of the controller."""
        if len(self._times) % SAMPLE_TICKS == 0:
            self._states.append(self._world.data.qpos.copy())
            self._state_times.append(self._world.time_s)
        self._times.append(self._world.time_s)
        self._poses.append((self._T_circle_world @ self._needle.T_world_needle).matrix)
        self._joints.append(self._world.joints(self._arm))

    def states(self) -> NDArray[np.float64]:
        """Return the whole world's positions (n, nq) at 20 Hz, to draw or replay them."""
        return np.array(self._states)

    def truth(self) -> NeedleTruth:
        """Return all that was seen so far."""
        q = np.array(self._joints).reshape(-1, 6)
        return NeedleTruth(
            times_s=np.array(self._times),
            T_circle_needle=SE3(np.array(self._poses).reshape(-1, 4, 4)),
            T_circle_tip=self._T_circle_base @ fk(self._world.cell.arms[self._arm], q),
            q=q,
            p_needle_tip_m=self._scene.p_needle_tip_m,
        )

    def arrays(self) -> dict[str, NDArray]:
        """Return what a trial keeps of what was seen."""
        truth = self.truth()
        return {
            "times_s": np.array(self._state_times),
            "qpos": self.states().astype(np.float32),
            "truth_s": truth.times_s,
            "needle": truth.T_circle_needle.matrix.astype(np.float32),
            f"joints_{self._arm}": truth.q,
            f"tip_{self._arm}": truth.T_circle_tip.translation_m.astype(np.float32),
        }
