"""Check a station for consistency; each problem is returned as a sentence."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from trocar.arms import SOLIDS, capsules, fk, ik
from trocar.checks import outside
from trocar.errors import InvalidInput, OutOfReach
from trocar.geometry import SE3, SO3, TURN, shown
from trocar.geometry.arrays import Array
from trocar.geometry.capsules import Capsules, capsule_distances_m
from trocar.lab.station import Registration, Station, StationArm
from trocar.perception.image import Intrinsics, StereoRig

ABOVE_FIXTURE_M = 0.01
"""An arm must reach the point this high above a fixture to work there."""
REGISTERED_SHARE = 0.25
"""Share of the box of registration points that a well-placed arm reaches; built-in stations have three quarters or
more."""

STRAIGHT = (SO3.identity(),)
"""The tip's rotation when it is aligned with the base."""

_QUARTERS = [TURN * k / 4 for k in range(4)]
_FACES = [*(SO3.axis("y", angle) for angle in _QUARTERS), SO3.axis("x", TURN / 4), SO3.axis("x", -TURN / 4)]
ALL_WAYS = tuple(face @ SO3.axis("z", angle) for face in _FACES for angle in _QUARTERS)
"""The 24 orientations of a cube."""


def check_station(station: Station) -> list[str]:
    """Return the problems of a station; empty if there are none.

    Every arm must be able to park, inside its workspace and apart from the others; the arms must reach the points of
    their registration and the fixtures; each camera must see a fixture or, without fixtures, an arm's workspace.
    """
    resting, found = _resting(station)
    for name, arm in station.arms.items():
        found += _jaws(name, arm)
    for name, q in resting.items():
        found += _outside(name, station.arms[name], q)
    solids = {name: _solids(station.arms[name], q) for name, q in resting.items()}
    for a, b in combinations(solids, 2):
        found += _too_near(station, (a, solids[a]), (b, solids[b]))
    found += _out_of_reach(station)
    for name in station.cameras:
        found += _blind(station, name)
    return found


def require_reach(station: Station) -> None:
    """Raise InvalidInput if an arm cannot park, or work is out of reach, so that no session can be drawn."""
    wrong = [*_resting(station)[1], *_out_of_reach(station)]
    if wrong:
        raise InvalidInput(f"station {station.name!r}:", wrong[0], "`trocar station check` lists all problems")


def _resting(station: Station) -> tuple[dict[str, Array], list[str]]:
    """Return the joints (6,) in which each arm rests, and a sentence for each arm that cannot."""
    resting: dict[str, Array] = {}
    found: list[str] = []
    for name, arm in station.arms.items():
        try:
            resting[name] = arm.park_q()
        except OutOfReach as error:
            found.append(f"arm {name!r} cannot rest where 'park' says: {error}")
    return resting, found


def _solids(arm: StationArm, q: Array) -> Capsules:
    return capsules(arm.model, q, arm.park_jaw_rad).moved(arm.T_world_base)


def _jaws(name: str, arm: StationArm) -> list[str]:
    jaw = arm.model.jaw
    if jaw.lower <= arm.park_jaw_rad <= jaw.upper:
        return []
    bounds = f"[{shown(jaw.lower, 'rad', '.0f')}, {shown(jaw.upper, 'rad', '.0f')}]"
    return [f"arm {name!r} rests with its jaws open {shown(arm.park_jaw_rad, 'rad', '.0f')}, outside {bounds}"]


def _outside(name: str, arm: StationArm, q: Array) -> list[str]:
    found = []
    for joint, value in zip(arm.model.joints, q.tolist(), strict=True):
        if not joint.lower <= value <= joint.upper:
            at, ends = outside(value, joint.lower, joint.upper)
            found.append(f"arm {name!r} rests with joint {joint.name!r} at {at} {joint.unit}, outside {ends}")
    if found or arm.workspace_m is None:
        return found
    tip = (arm.T_world_base @ fk(arm.model, q)).translation_m
    if ((tip < arm.workspace_m[0]) | (tip > arm.workspace_m[1])).any():
        return [f"arm {name!r} rests with its tip at {_mm(tip)} mm, outside its workspace"]
    return []


def _too_near(station: Station, first: tuple[str, Capsules], second: tuple[str, Capsules]) -> list[str]:
    distances = capsule_distances_m(first[1], second[1])
    i, j = np.unravel_index(int(np.argmin(distances)), distances.shape)
    if distances[i, j] >= max(station.min_distance_m, 0.0):
        return []
    return [
        f"{SOLIDS[i]} of {first[0]!r} and {SOLIDS[j]} of {second[0]!r} rest {shown(distances[i, j], 'm')} apart; "
        f"the station asks for {shown(station.min_distance_m, 'm')}"
    ]


def _out_of_reach(station: Station) -> list[str]:
    """Return sentences on work out of reach: the points that register a base, and what is fixed on the table."""
    found = []
    if isinstance(station.registration, Registration):
        corners = np.array(station.registration.volume_m)
        places = np.stack(np.meshgrid(*np.linspace(corners[0], corners[1], 3).T), axis=-1).reshape(-1, 3)
        for name, arm in station.arms.items():
            share = float(reaches(arm, places).mean())
            if share < REGISTERED_SHARE:
                found.append(
                    f"arm {name!r} reaches {100 * share:.0f} % of the box in which its base is registered, from "
                    f"{_mm(corners[0])} to {_mm(corners[1])} mm; move its base ('base' of [arms.{name}]) or the box "
                    "('volume_mm' of [registration])"
                )
    for name, T in station.T_world_fixture.items():
        above = T.apply([0.0, 0.0, ABOVE_FIXTURE_M])
        if not any(reaches(arm, above[None], ALL_WAYS)[0] for arm in station.arms.values()):
            found.append(
                f"fixture {name!r} at {_mm(T.translation_m)} mm is out of reach of {', '.join(station.arms)}, however "
                f"they turn their wrists; move it ('xyz_mm' of [fixtures.{name}]), or an arm's base"
            )
    return found


def _blind(station: Station, name: str) -> list[str]:
    camera = station.cameras[name]
    lens = camera.model.left if isinstance(camera.model, StereoRig) else camera.model
    targets = {f"fixture {key!r}": T.translation_m for key, T in station.T_world_fixture.items()}
    if not targets:
        boxes = {key: arm.workspace_m for key, arm in station.arms.items()}
        targets = {f"workspace of {key!r}": box.mean(0) for key, box in boxes.items() if box is not None}
    unseen = [what for what, p in targets.items() if not _in_view(lens, camera.T_world_camera.inverse().apply(p))]
    if targets and len(unseen) == len(targets):
        return [f"camera {name!r} sees the middle of none of: {', '.join(targets)}"]
    return []


def _in_view(lens: Intrinsics, p_camera_m: Array) -> bool:
    x, y, z = p_camera_m
    if z <= 0:
        return False
    u, v = lens.fx * x / z + lens.cx, lens.fy * y / z + lens.cy
    return 0 <= u < lens.width and 0 <= v < lens.height


def _mm(point_m: Array) -> str:
    return ", ".join(f"{1e3 * value:.0f}" for value in point_m)


def reaches(arm: StationArm, p_world_m: Array, turns: Sequence[SO3] = STRAIGHT) -> NDArray[np.bool_]:
    """Return which points (n,) the tip of an arm reaches.

    Args:
        arm: the arm and its base.
        p_world_m: (n, 3) points in the world.
        turns: rotations of the tip in the base; reaching the point with one of them is enough.
    """
    p_base = arm.T_world_base.inverse().apply(p_world_m)
    found = [ik(arm.model, SE3.from_parts(turn, p_base), unreachable="nan") for turn in turns]
    return np.asarray(np.isfinite(found).all(axis=-1).any(axis=0))
