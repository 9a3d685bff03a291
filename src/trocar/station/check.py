"""Does a station make sense? Each finding is a sentence."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from trocar.arms import SOLIDS, capsules, fk
from trocar.errors import TrocarError
from trocar.geometry import shown
from trocar.geometry.capsules import Capsules, capsule_distances_m
from trocar.perception.image import Intrinsics, StereoRig
from trocar.station.station import Station, StationArm


def check_station(station: Station) -> list[str]:
    """Return what is wrong with a station; nothing if all is well.

    Looked at are: whether every arm can rest where it should, inside its workspace and apart from the others, and
    whether every camera looks at what is fixed on the table, or at the arms' workspaces.
    """
    found: list[str] = []
    resting: dict[str, NDArray[np.float64]] = {}
    for name, arm in station.arms.items():
        try:
            resting[name] = arm.park_q()
        except TrocarError as error:
            found.append(f"arm {name!r} cannot rest where 'park' says: {error}")
    for name, arm in station.arms.items():
        found += _jaws(name, arm)
    for name, q in resting.items():
        found += _outside(name, station.arms[name], q)
    solids = {name: _solids(station.arms[name], q) for name, q in resting.items()}
    for a, b in combinations(solids, 2):
        found += _too_near(station, (a, solids[a]), (b, solids[b]))
    for name in station.cameras:
        found += _blind(station, name)
    return found


def _solids(arm: StationArm, q: NDArray[np.float64]) -> Capsules:
    return capsules(arm.model, q, arm.park_jaw_rad).moved(arm.T_world_base)


def _jaws(name: str, arm: StationArm) -> list[str]:
    jaw = arm.model.jaw
    if jaw.lower <= arm.park_jaw_rad <= jaw.upper:
        return []
    bounds = f"[{shown(jaw.lower, 'rad', '.0f')}, {shown(jaw.upper, 'rad', '.0f')}]"
    return [f"arm {name!r} rests with its jaws open {shown(arm.park_jaw_rad, 'rad', '.0f')}, outside {bounds}"]


def _outside(name: str, arm: StationArm, q: NDArray[np.float64]) -> list[str]:
    found = [
        f"arm {name!r} rests with joint {joint.name!r} at {value:.4f} {joint.unit}, outside "
        f"[{joint.lower:.4f}, {joint.upper:.4f}]"
        for joint, value in zip(arm.model.joints, q.tolist(), strict=True)
        if not joint.lower <= value <= joint.upper
    ]
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


def _in_view(lens: Intrinsics, p_camera_m: NDArray[np.float64]) -> bool:
    x, y, z = p_camera_m
    if z <= 0:
        return False
    u, v = lens.fx * x / z + lens.cx, lens.fy * y / z + lens.cy
    return 0 <= u < lens.width and 0 <= v < lens.height


def _mm(point_m: NDArray[np.float64]) -> str:
    return ", ".join(f"{1e3 * value:.0f}" for value in point_m)
