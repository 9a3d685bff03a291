"""A day in a laboratory: what is true of it, and what registration found. Simulator truth; no agent may import this."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from trocar.geometry import SE3
from trocar.geometry.rigid_fit import fit_rigid
from trocar.station.registration import CheckerboardRegistration, Registration
from trocar.station.station import Station
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
        T_world_camera_registered: as registration found them; true where the world refers to them.
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
    how = station.registration
    if isinstance(how, CheckerboardRegistration):
        found, seen = _by_checkerboard(bases, cameras, how, rng)
    else:
        found, seen = {name: _register(T, how, rng) for name, T in bases.items()}, cameras
    kept = {name: arm.T_world_base_registered for name, arm in station.arms.items()}
    kept_seen = {name: camera.T_world_camera_registered for name, camera in station.cameras.items()}
    return Session(station, transmissions, bases, found | _known(kept), cameras, dict(seen) | _known(kept_seen))


def _known(poses: Mapping[str, SE3 | None]) -> dict[str, SE3]:
    return {name: T for name, T in poses.items() if T is not None}


def _transmissions(station: Station, rng: np.random.Generator) -> dict[str, Transmission]:
    return {name: arm.transmission.drawn(rng) for name, arm in station.arms.items()}


def _register(T_world_base: SE3, how: Registration, rng: np.random.Generator) -> SE3:
    """Return the base as a rigid fit to noisy points finds it."""
    p_world = rng.uniform(*how.volume_m, (how.points, 3))
    p_base = T_world_base.inverse().apply(p_world)
    seen = p_world + how.sd_m * rng.standard_normal(p_world.shape)
    return fit_rigid(p_base, seen).T_target_source


def _by_checkerboard(
    bases: Mapping[str, SE3], cameras: Mapping[str, SE3], how: CheckerboardRegistration, rng: np.random.Generator
) -> tuple[dict[str, SE3], dict[str, SE3]]:
    """Return bases and cameras as boards on the bases' brackets show them; the first base is the world's reference."""
    sd = np.repeat([how.sd_m, how.sd_rad], 3)
    off = {}
    for name in bases:
        T_board_found = SE3.exp(sd * rng.standard_normal(6))
        off[name] = how.T_world_board @ T_board_found @ how.T_world_board.inverse()
    world = off[next(iter(bases))].inverse()
    found = {name: world @ off[name] @ T for name, T in bases.items()}
    return found, {name: world @ T for name, T in cameras.items()}
