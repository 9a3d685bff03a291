"""A replay made without a simulator: two PSMs over a pegboard each carry a block to and fro and touch a peg.

Instruments are built from ``Instrument``, their links are where ``frames`` puts them, and jaws hold what they carry.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw

from trocar.arms import PSM_CLASSIC, ArmModel, fk, frames, ik
from trocar.geometry import SE3, SO3
from trocar.replay import CameraImage, Contact, Goal, Replay, Solid, ToolPath

RATE_HZ = 100.0
BASES = {"psm1": (0.1332, 0.0, 0.166), "psm2": (-0.1332, 0.0, 0.166)}
SIDE = {"psm1": 1.0, "psm2": -1.0}
STEEL, CARBON, HOUSING = (0.62, 0.63, 0.66, 1.0), (0.10, 0.11, 0.13, 1.0), (0.55, 0.56, 0.60, 1.0)
RED, BLOCK_RED, BLACK = (0.83, 0.23, 0.07, 1.0), (0.80, 0.20, 0.07, 1.0), (0.035, 0.035, 0.04, 1.0)
JOINTS = (*(joint.name for joint in PSM_CLASSIC.joints), "jaw")
OPEN_RAD, CLOSED_RAD = 0.6, 0.1
CYCLE_S = 6.0  # there and back
PEGS_M = [(x, y) for x in (-0.0405, -0.0116, 0.0116, 0.0405) for y in (-0.0175, 0.0, 0.0175)]
PEG_RADIUS_M, PEG_HEIGHT_M = 1.75e-3, 20e-3
PLATES_M = ((0.100, 0.064, 0.0), (0.122, 0.083, -0.004), (0.152, 0.105, -0.009))  # width, depth, top
BLOCK_HEIGHT_M, BLOCK_SIDES_M = 15e-3, (4.4e-3, 9.5e-3)  # hole and outline: centre to corner


def made_up_replay(duration_s: float = 12.0, arms: Sequence[str] = ("psm1", "psm2"), blocks: int = 6) -> Replay:
    """Return a replay in which each arm carries one block to and fro, and the other blocks lie still.

    Each time to and fro is a goal; every second one is missed.
    """
    times = np.arange(0.0, duration_s + 0.5 / RATE_HZ, 1 / RATE_HZ)
    solids, poses = _table(), {"world": SE3.identity()}
    for k, (x, y) in enumerate(PEGS_M[:blocks]):
        solids += _block(f"block{k}")
        poses[f"block{k}"] = SE3.from_parts(None, np.tile([x, y, 0.0], (len(times), 1)))
    tools, joints, spans, events = {}, {}, [], []
    for number, arm in enumerate(arms):
        T_world_base = SE3.from_parts(SO3.axis("z", np.pi), BASES[arm])
        q, jaw = _driven(times, arm, T_world_base)
        desired = q + 0.01 * np.sin(0.8 * times)[:, None] * [0.3, 0.2, 0.02, 1, 1, 1]
        solids += _instrument(PSM_CLASSIC, arm)
        poses |= _links(PSM_CLASSIC, arm, T_world_base, q, jaw)
        tip = (T_world_base @ fk(PSM_CLASSIC, q)).translation_m
        tools[arm] = ToolPath((T_world_base @ fk(PSM_CLASSIC, desired)).translation_m, tip)
        joints[arm] = _joints(q, jaw, desired)
        spans += _spans(arm, duration_s)
        events += [{"name": "grasp", "time_s": t, "arm": arm} for t in np.arange(1.0, duration_s, CYCLE_S)]
        if number < blocks:
            poses[f"block{number}"] = _carried(T_world_base @ fk(PSM_CLASSIC, q), jaw)
    return Replay(
        title="Peg transfer, made up: two arms",
        times_s=times,
        solids=tuple(solids),
        T_world_body=poses,
        tools=tools,
        contacts=_contacts(duration_s, arms),
        ports_m={arm: np.array(BASES[arm]) for arm in arms},
        goals=tuple(
            Goal(arm, number, start_s, min(start_s + CYCLE_S, duration_s), number % 2 == 1)
            for arm in arms
            for number, start_s in enumerate(np.arange(0.0, duration_s, CYCLE_S).tolist())
        ),
        spans=tuple(spans),
        events=tuple(sorted(events, key=lambda event: event["time_s"])),
        joints=joints,
        joint_names=dict.fromkeys(arms, JOINTS),
        images=_images(duration_s),
    )


def still_replay() -> Replay:
    """Return a replay of one arm in which nothing moves."""
    replay = made_up_replay(1.0, ("psm1",), 1)
    still = {body: SE3(T.matrix[0]) if T.matrix.ndim == 3 else T for body, T in replay.T_world_body.items()}
    return replace(replay, T_world_body=still, tools={}, contacts=())


def _driven(times: NDArray, arm: str, T_world_base: SE3) -> tuple[NDArray, NDArray]:
    """Return joints (n, 6) and jaw opening (n,) of an arm that goes between two pegs, over the top, with rests."""
    phase = (times / CYCLE_S + (0.0 if arm == "psm1" else 0.13)) % 1.0
    share = np.clip(1.5 - np.abs(4 * phase - 2), 0.0, 1.0)
    share = share**2 * (3 - 2 * share)
    start, end = np.array([0.012, -0.02, 0.012]), np.array([0.042, 0.018, 0.012])
    p = start + share[:, None] * (end - start)
    p[:, 2] += 0.035 * np.sin(np.pi * share)
    p[:, 0] *= SIDE[arm]
    tilt = SO3.exp(np.stack([0.15 * np.sin(times), -0.3 * SIDE[arm] + 0 * times, 0.5 * share], -1))
    T_world_tip = SE3.from_parts(tilt, p)
    q = ik(PSM_CLASSIC, T_world_base.inverse() @ T_world_tip)
    jaw = np.where((phase > 0.15) & (phase < 0.85), CLOSED_RAD, OPEN_RAD)
    return q, np.convolve(np.pad(jaw, 15, mode="edge"), np.ones(31) / 31, "valid")


def _carried(T_world_tip: SE3, jaw: NDArray) -> SE3:
    """Return the poses of a block that hangs in closed jaws, and stays where it was released."""
    held = jaw < 0.5 * (OPEN_RAD + CLOSED_RAD)
    last_held = np.maximum.accumulate(np.where(held, np.arange(len(jaw)), 0))
    grip = SE3.from_parts(None, [0.0, 0.007, 0.004 - BLOCK_HEIGHT_M])
    return T_world_tip[last_held] @ grip


def _table() -> list[Solid]:
    """Return table, plates and pegs."""
    below = PLATES_M[-1][2] - 0.005
    solids = [_solid("world", "box", (0.25, 0.2, 0.005), [0, 0, below - 0.005], BLACK)]
    for width, depth, height in PLATES_M:
        half = 0.5 * (height - below)
        solids.append(_solid("world", "box", (width / 2, depth / 2, half), [0, 0, height - half], RED))
    for x, y in PEGS_M:
        half = 0.5 * (PEG_HEIGHT_M - PEG_RADIUS_M)
        solids.append(_solid("world", "capsule", (PEG_RADIUS_M, half), [x, y, half], RED))
    return solids


def _block(body: str) -> list[Solid]:
    """Return three walls round a triangular hole; the block stands on its body's origin."""
    corners = np.array([[np.cos(a), np.sin(a)] for a in np.radians([90, 210, 330])])
    hole, outline = (side * corners for side in BLOCK_SIDES_M)
    walls = []
    for k in range(3):
        flat = np.array([hole[k], hole[k - 1], outline[k], outline[k - 1]])
        vertices = np.concatenate([np.column_stack([flat, np.full(4, z)]) for z in (0.0, BLOCK_HEIGHT_M)])
        walls.append(Solid(body, "hull", (), SE3.identity(), BLOCK_RED, vertices))
    return walls


def _instrument(model: ArmModel, arm: str) -> list[Solid]:
    """Return the solids of an instrument on the bodies ``ARM_link4`` (roll) to ``ARM_finger_right``."""
    shape = model.instrument
    down = -model.wrist_sign
    sleeve, shaft = (-0.003, -0.018), (-0.019, -shape.shaft_length_m)
    along_x = SO3.axis("y", np.pi / 2)
    solids = []
    for (start, end), radius, colour in ((sleeve, 0.95, STEEL), (shaft, 1.0, CARBON)):
        middle, half = 0.5 * down * (start + end), 0.5 * (start - end)
        size = (radius * shape.shaft_radius_m, half)
        solids.append(_solid(f"{arm}_link4", "cylinder", size, [0, 0, middle], colour))
    drive = [0, 0, -down * (shape.shaft_length_m + 0.04)]
    solids.append(_solid(f"{arm}_link4", "box", (0.03, 0.045, 0.04), drive, HOUSING))
    half = 0.375 * model.wrist_length_m
    wrist = Solid(f"{arm}_link5", "capsule", (shape.wrist_radius_m, half), SE3.from_parts(along_x, [half, 0, 0]), STEEL)
    knuckle = _solid(
        f"{arm}_link6", "cylinder", (shape.knuckle_radius_m, 0.45 * shape.finger_width_m), [0, 0, 0], STEEL
    )
    fingers = [
        Solid(f"{arm}_finger_{name}", "hull", (), SE3.identity(), STEEL, shape.finger_m(side))
        for name, side in (("left", 1), ("right", -1))
    ]
    return [*solids, wrist, knuckle, *fingers]


def _links(model: ArmModel, arm: str, T_world_base: SE3, q: NDArray, jaw: NDArray) -> dict[str, SE3]:
    """Return the poses of an arm's bodies."""
    T_world_frame = T_world_base @ frames(model, q)
    links = {f"{arm}_link{k}": SE3(T_world_frame.matrix[:, k]) for k in range(1, 7)}
    for name, sign in (("left", 0.5), ("right", -0.5)):
        turn = SE3.from_parts(SO3.axis("z", np.pi / 2 + sign * jaw))
        links[f"{arm}_finger_{name}"] = links[f"{arm}_link6"] @ turn
    return {f"{arm}_base": T_world_base, **links}


def _joints(q: NDArray, jaw: NDArray, desired: NDArray) -> dict[str, NDArray]:
    """Return desired, commanded, measured and true joints (n, 7)."""
    true, wanted = np.column_stack([q, jaw]), np.column_stack([desired, jaw])
    return {"desired": wanted, "commanded": wanted + 0.002, "measured": wanted + 0.001, "true": true}


def _spans(arm: str, duration_s: float) -> list[tuple[str, str, float, float]]:
    """Return the script's time, second by second, as (arm, name, start, end)."""
    names = ("capture", "perceive", "plan", "move", "grasp", "move")
    ends = np.arange(0.0, duration_s + 1e-9, 1.0)
    return [(arm, names[k % len(names)], a, b) for k, (a, b) in enumerate(pairwise(ends))]


def _contacts(duration_s: float, arms: Sequence[str]) -> tuple[Contact, ...]:
    """Return one touch of a peg by each arm per cycle."""
    touches = [
        Contact(t, t + 0.3, (f"{arm} left finger", "peg 7"), (0.03 * SIDE[arm], 0.01, 0.02), 1.5)
        for arm in arms
        for t in np.arange(2.2, duration_s - 0.3, CYCLE_S)
    ]
    return tuple(sorted(touches, key=lambda touch: touch.time_s))


def _images(duration_s: float) -> tuple[CameraImage, ...]:
    """Return small pictures that say when they were taken."""
    found = []
    for t in np.arange(0.5, duration_s, 3.0):
        picture = Image.new("RGB", (240, 150), (70, 75, 85))
        ImageDraw.Draw(picture).text((20, 60), f"camera at {t:.1f} s", fill=(255, 255, 255))
        file = io.BytesIO()
        picture.save(file, "WEBP")
        found.append(CameraImage(float(t), "overhead", file.getvalue()))
    return tuple(found)


def _solid(body: str, shape: str, size: tuple[float, ...], p_body_m: ArrayLike, rgba: tuple) -> Solid:
    return Solid(body, shape, size, SE3.from_parts(None, p_body_m), rgba)
