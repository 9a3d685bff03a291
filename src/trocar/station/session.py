"""A day in a laboratory: what is true of it, and what registration found. Simulator truth; no agent may import this."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from trocar.geometry import SE3
from trocar.geometry.rigid_fit import fit_rigid
from trocar.station.station import Registration, Station
from trocar.station.transmission import Transmission


@dataclass(frozen=True, eq=False)
class Session:
    """The true state of a laboratory between two set-ups, and what registration found of it.

    Attributes:
        station: the laboratory.
        transmissions: this session's, by arm.
        T_world_base: true bases.
        T_world_base_registered: as registration found them.
        T_world_camera: true poses of the cameras.
        T_world_camera_registered: as registration found them: the cameras' frames are what the world's refers to.
    """

    station: Station
    transmissions: Mapping[str, Transmission]
    T_world_base: Mapping[str, SE3]
    T_world_base_registered: Mapping[str, SE3]
    T_world_camera: Mapping[str, SE3]
    T_world_camera_registered: Mapping[str, SE3]

    def remounted(self, rng: np.random.Generator) -> Session:
        """Return the same cell after its instruments were mounted again: other transmissions."""
        return replace(self, transmissions=_transmissions(self.station, rng))


def draw_session(station: Station, rng: np.random.Generator) -> Session:
    """Return a day in this laboratory."""
    transmissions = _transmissions(station, rng)
    bases = {name: arm.T_world_base for name, arm in station.arms.items()}
    cameras = {name: camera.T_world_camera for name, camera in station.cameras.items()}
    registered = {name: _register(T, station.registration, rng) for name, T in bases.items()}
    kept = {name: arm.T_world_base_registered for name, arm in station.arms.items()}
    registered |= {name: T for name, T in kept.items() if T is not None}
    return Session(station, transmissions, bases, registered, cameras, cameras)


def _transmissions(station: Station, rng: np.random.Generator) -> dict[str, Transmission]:
    return {name: arm.transmission.drawn(rng) for name, arm in station.arms.items()}


def _register(T_world_base: SE3, how: Registration, rng: np.random.Generator) -> SE3:
    """Return the base as a rigid fit to noisy points finds it."""
    p_world = rng.uniform(*how.volume_m, (how.points, 3))
    p_base = T_world_base.inverse().apply(p_world)
    seen = p_world + how.sd_m * rng.standard_normal(p_world.shape)
    return fit_rigid(p_base, seen).T_target_source
