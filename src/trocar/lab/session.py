"""A session in a laboratory: its true state, and what registration found. Simulator truth; no agent may import it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from trocar.arms import ArmModel, fk, ik
from trocar.counting import counted
from trocar.errors import InvalidInput, OutOfReach
from trocar.geometry import SE3
from trocar.geometry.arrays import Array
from trocar.geometry.rigid_fit import fit_rigid
from trocar.lab.flaws import FLAWS, Difficulty
from trocar.lab.station import CheckerboardRegistration, Registration, Station, StationArm
from trocar.lab.transmission import JawCable, Transmission

WHITE_SHARE = 0.15
"""Share of a registration point's noise that is independent. Errors of the outer joints cause the rest, so that
neighbouring points have similar errors, as in the recorded sets (``benchmarks/bench_cell.py``)."""

MIN_POINTS = 4
"""Minimum number of registration points that a station file must request, and that an arm must reach."""


@dataclass(frozen=True, eq=False)
class Session:
    """The true state of a laboratory between two set-ups, and what registration found.

    Attributes:
        station: the laboratory.
        models: the true arms, whose wrist lengths differ slightly from the nominal model's.
        transmissions: transmissions of this session, by arm.
        jaws: cables of the jaws, by arm.
        T_world_base: true poses of the bases.
        T_world_base_registered: registered poses of the bases.
        T_world_camera: true poses of the cameras.
        T_world_camera_registered: registered poses; the first is exact if it is the world's reference.
    """

    station: Station
    models: Mapping[str, ArmModel]
    transmissions: Mapping[str, Transmission]
    jaws: Mapping[str, JawCable]
    T_world_base: Mapping[str, SE3]
    T_world_base_registered: Mapping[str, SE3]
    T_world_camera: Mapping[str, SE3]
    T_world_camera_registered: Mapping[str, SE3]

    def remounted(self, rng: np.random.Generator) -> Session:
        """Return the session with its instruments remounted: new transmissions, jaw cables and wrist lengths."""
        transmissions = _transmissions(self.station, rng)
        return replace(
            self, models=_models(self.station, rng), transmissions=transmissions, jaws=_jaws(self.station, rng)
        )


def draw_session(station: Station, rng: np.random.Generator) -> Session:
    """Return a session drawn at this station, at the station's difficulty."""
    station = _with_its_sensors(station)
    transmissions = _transmissions(station, rng)
    bases = {name: arm.T_world_base for name, arm in station.arms.items()}
    cameras = {name: camera.T_world_camera for name, camera in station.cameras.items()}
    how = station.registration
    if isinstance(how, CheckerboardRegistration):
        found, seen = _by_checkerboard(bases, cameras, how, rng)
    else:
        found = {
            name: _register(name, arm, transmissions[name], how, station.difficulty, rng)
            for name, arm in station.arms.items()
        }
        seen = _seen_from_the_first(cameras, station.difficulty, rng)
    kept = {name: arm.T_world_base_registered for name, arm in station.arms.items()}
    kept_seen = {name: camera.T_world_camera_registered for name, camera in station.cameras.items()}
    models, jaws = _models(station, rng), _jaws(station, rng)
    found, seen = found | _known(kept), dict(seen) | _known(kept_seen)
    return Session(station, models, transmissions, jaws, bases, found, cameras, seen)


def _known(poses: Mapping[str, SE3 | None]) -> dict[str, SE3]:
    return {name: T for name, T in poses.items() if T is not None}


def _transmissions(station: Station, rng: np.random.Generator) -> dict[str, Transmission]:
    return {name: arm.transmission.drawn(rng, station.difficulty) for name, arm in station.arms.items()}


def _models(station: Station, rng: np.random.Generator) -> dict[str, ArmModel]:
    """Return the arms with tools whose wrist length differs slightly from the model's."""
    (sd_m,), found = station.difficulty["tool"], station.models
    for (name, model), own in zip(found.items(), rng.spawn(len(found)), strict=True):
        if sd_m > 0.0:
            found[name] = replace(model, wrist_length_m=model.wrist_length_m + sd_m * float(own.standard_normal()))
    return found


def _jaws(station: Station, rng: np.random.Generator) -> dict[str, JawCable]:
    (size_rad,) = station.difficulty["jaw"]
    return {
        name: JawCable.drawn(own, size_rad)
        for name, own in zip(station.arms, rng.spawn(len(station.arms)), strict=True)
    }


def _with_its_sensors(station: Station) -> Station:
    """Return the station with sensors whose errors have the size that its difficulty sets."""
    scale = station.difficulty.scale("depth") * float(FLAWS["depth"].recorded[0])
    if scale == 1.0:
        return station
    cameras = {name: replace(camera, flaws=camera.flaws.with_depth(scale)) for name, camera in station.cameras.items()}
    return replace(station, cameras=cameras)


def points_of_registration(
    arm: StationArm, transmission: Transmission, how: Registration, difficulty: Difficulty, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Return registration points (n, 3) in the base according to the encoders, and in the world as they are seen.

    Errors of the outer joints shift the points, neighbouring ones similarly. The wrist's cables play no role, since
    only the shaft is observed.

    Args:
        arm: the arm to register.
        transmission: its transmission in this session.
        how: where the points lie, and how well they are seen.
        difficulty: the session's difficulty.
        rng: random numbers for the points.
    """
    p_world = rng.uniform(*how.volume_m, (how.points, 3))
    p_base = arm.T_world_base.inverse().apply(p_world)
    noise = how.sd_m * rng.standard_normal(p_world.shape)
    if not difficulty["outer"].any():
        return p_base, p_world + noise
    seen = p_world + WHITE_SHARE * noise
    q_park, moved_rng = arm.park_q(), rng.spawn(1)[0]
    memory, reached, off = transmission.start(q_park, moved_rng), [], []
    for number in _tour(p_base):
        p = p_base[number]
        try:
            q = ik(arm.model, SE3.from_parts(translation_m=p), reference=q_park)
        except OutOfReach:
            continue
        q_true, memory = transmission.step(memory, q)
        there = fk(arm.model, np.concatenate([q_true[:3], q[3:]])).translation_m
        reached.append(number)
        off.append(arm.T_world_base.rotation.apply(there - p))
    return p_base[reached], seen[reached] + np.array(off).reshape(-1, 3)


def _tour(points: Array) -> list[int]:
    """Return the indices of points (n, 3) in the order of a visit: after each, the nearest remaining one."""
    order, been = [0], np.zeros(len(points))
    for _ in points[1:]:
        been[order[-1]] = np.inf
        order.append(int(np.argmin(np.sum((points - points[order[-1]]) ** 2, axis=1) + been)))
    return order


def _register(
    name: str,
    arm: StationArm,
    transmission: Transmission,
    how: Registration,
    difficulty: Difficulty,
    rng: np.random.Generator,
) -> SE3:
    """Return the base as a rigid fit finds it, shifted by the flaw ``registration``.

    Raises:
        InvalidInput: the arm reaches fewer than ``MIN_POINTS`` of the points.
    """
    p_base, seen = points_of_registration(arm, transmission, how, difficulty, rng)
    if len(p_base) < MIN_POINTS:
        low, high = (", ".join(f"{1e3 * value:g}" for value in corner) for corner in how.volume_m)
        raise InvalidInput(
            f"arm {name!r}",
            f"reaches {len(p_base)} of the {counted(how.points, 'point')} that register its base, in the box from "
            f"{low} to {high} mm; {MIN_POINTS} or more are needed",
            f"move its base ('base' of [arms.{name}]) or the box ('volume_mm' of [registration]), and try "
            "`trocar station check`",
        )
    (shift_m,) = difficulty["registration"]
    return fit_rigid(p_base, seen + shift_m * rng.spawn(1)[0].standard_normal(3)).T_target_source


def _seen_from_the_first(
    cameras: Mapping[str, SE3], difficulty: Difficulty, rng: np.random.Generator
) -> dict[str, SE3]:
    """Return cameras as registered: the first is the world's reference, the others have errors relative to it."""
    (sd_m,), found, others = difficulty["cameras"], dict(cameras), list(cameras)[1:]
    for name, own in zip(others, rng.spawn(len(others)), strict=True):
        found[name] = SE3.from_parts(translation_m=sd_m * own.standard_normal(3)) @ found[name]
    return found


def _by_checkerboard(
    bases: Mapping[str, SE3], cameras: Mapping[str, SE3], how: CheckerboardRegistration, rng: np.random.Generator
) -> tuple[dict[str, SE3], dict[str, SE3]]:
    """Return bases and cameras as found from boards on brackets; the first base is the world's reference."""
    sd = np.repeat([how.sd_m, how.sd_rad], 3)
    off = {}
    for name in bases:
        T_board_found = SE3.exp(sd * rng.standard_normal(6))
        off[name] = how.T_world_board @ T_board_found @ how.T_world_board.inverse()
    # every base is found with the error of its own board; as the reference, the first one is right by definition
    world = off[next(iter(bases))].inverse()
    found = {name: world @ off[name] @ T for name, T in bases.items()}
    return found, {name: world @ T for name, T in cameras.items()}
