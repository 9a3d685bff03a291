"""The six grasps of a block, the poses that release it over a peg, and the choice among them."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.arms import ArmModel, Instrument, ik
from trocar.errors import InvalidInput, OutOfReach
from trocar.geometry import SE3, SO3, shown
from trocar.tasks.peg_transfer.shapes import Block, Pegboard

GRASP_ASIDE_M = (-1.0e-3, 1.0e-3)
"""x of the two grasp points on the side at +y, in the block frame; rotated by +-120 deg for the other two sides
(from the program of Hwang et al. 2022)."""
GRASP_FROM_MIDDLE_M = 5.0e-3
"""y of these points: a little outside the middle of the wall, since the inner finger has the peg beside it."""
DEPTH_M = 4.0e-3
"""Depth of the tip below a block's top face."""
MIN_OPENING_M, MAX_OPENING_M = 2.0e-3, 8.0e-3
OPENING_STEP_M = 0.1e-3
"""Distances between the inner faces of the open fingers that are tried."""
SELF_M, REACH_M = 2e-3, 30e-3
"""Another block is an obstacle between these distances: nearer is the grasped block itself, further is out of reach."""
MIN_GAP_M = 0.15e-3
MAX_ROLL_RAD = np.radians(70.0)
MARGIN_RAD = np.radians(5.0)
"""Margin between the wrist's joints and their limits."""
NEAR_END_M = 3.0e-3
"""A finger's thickness is taken this far behind its end, about as deep as the finger is in a block."""
YAWS_RAD = np.radians(np.arange(0.0, 360.0, 7.5))
"""Rotations of the tool that are tried over a peg."""
OUTER_FINGER_M = 4.5e-3
"""Distance from the tip to the middle of the open outer finger, outwards."""
FINGER_ROOM_M = 0.7e-3
"""Offset of a released block from the axis of its peg, towards the held wall. It makes room between wall and peg for
the inner finger to open; the hole is 1 mm wider at the corner opposite the wall."""
ROOM_M = 2.5e-3
"""Sufficient clearance: the tool does not turn to gain more."""


@dataclass(frozen=True, eq=False)
class Grasp:
    """A feasible grasp.

    Attributes:
        T_board_tip: pose of the tip: tool vertical, tip in the wall of the block, jaws opening along the tip's x.
        q: (6,) joints in this pose, before cable compensation.
        jaw_rad: opening of the jaws during the approach, the one with the largest clearance.
        clearance_m: smallest gap between an open finger and a wall, peg or neighbour.
        candidate: number of the grasp, 0 to 5.
    """

    T_board_tip: SE3
    q: NDArray[np.float64]
    jaw_rad: float
    clearance_m: float
    candidate: int


_RULES = (
    (True, 0.15e-3, np.radians(70.0)),
    (True, 0.15e-3, np.radians(110.0)),
    (False, 0.15e-3, np.radians(70.0)),
    (False, 0.15e-3, np.radians(110.0)),
    (True, -0.6e-3, np.radians(110.0)),
    (False, -0.6e-3, np.radians(110.0)),
)
"""Rules for grasps, tried in turn: whether the wall must be on the arm's own side, least gap round the open
fingers (m), largest roll (rad). Rules for the own side apply only to a block for another arm: held there, it leaves
room for that arm. With a negative gap, a finger must slide off the peg's round end or push the block aside."""


def grasp_candidates(
    depth_m: float = DEPTH_M,
    from_middle_m: float = GRASP_FROM_MIDDLE_M,
    aside_m: tuple[float, float] = GRASP_ASIDE_M,
) -> SE3:
    """Return ``T_block_tip`` (6,): tip z out of the block, tip x along the outward normal of the side.

    Args:
        depth_m: depth of the tip below the top face.
        from_middle_m: distance of the tip from the block's middle, along that normal.
        aside_m: x of the two grasp points on the side at +y, in the block frame.
    """
    yaws = np.radians(120.0) * np.arange(3)
    turn = SO3.axis("z", np.repeat(yaws, 2))
    points = np.array([(x, from_middle_m, depth_m) for x in aside_m] * 3)
    outward = SO3(np.column_stack([(0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)]))
    return SE3.from_parts(turn @ outward, turn.apply(points))


def choose_grasp(
    arm: ArmModel,
    T_base_board: SE3,
    T_board_block: SE3,
    board: Pegboard,
    block: Block,
    others: Sequence[SE3] = (),
    *,
    avoid: Collection[int] = (),
    max_roll_rad: float = MAX_ROLL_RAD,
    min_gap_m: float = MIN_GAP_M,
    depth_m: float = DEPTH_M,
    towards: NDArray[np.float64] | None = None,
) -> Grasp | str:
    """Return the feasible grasp with the largest clearance of the fingers, or one sentence why there is none.

    The block hangs loosely on its peg, so the wall that is farthest from the peg leaves the inner finger the most room
    (the paper's choice). Each grasp is tried with both orientations of the tool.

    Args:
        arm: the arm that grasps.
        T_base_board: pose of the board in the arm's base.
        T_board_block: perceived pose; only position and yaw matter, since the tool stays vertical.
        board: its pegs are obstacles.
        block: shape of the blocks.
        others: poses of the other blocks on the board, which are obstacles too.
        avoid: candidates that have failed; chosen only if no other is feasible.
        max_roll_rad: largest |roll| (facts: 70 deg).
        min_gap_m: smallest gap between a finger and a wall, peg or neighbour.
        depth_m: depth of the tip below the top face.
        towards: direction (2,) in the board's plane that the outer side of the wall has to face; None: any.

    Raises:
        InvalidInput: a pose is not a single finite one.
    """
    if T_board_block.matrix.shape != (4, 4) or not np.isfinite(T_board_block.matrix).all():
        raise InvalidInput("T_board_block", "is not one finite pose", "choose_grasp needs one (4, 4)")
    here = T_board_block.translation_m[:2]
    near = [T for T in others if SELF_M < np.linalg.norm(T.translation_m[:2] - here) < REACH_M]
    best: Grasp | None = None
    blocked: list[str] = []
    for candidate, T_board_tip in enumerate(vertical_grasps(T_board_block, depth_m)):
        outwards = T_board_tip.matrix[:2, 0]  # before the tool is turned round, its x points out of the block
        if towards is not None and outwards @ towards <= 0:
            blocked.append(f"{candidate}: on the far side")
            continue
        opening, gap = _opening(T_board_tip, T_board_block, board, block, near, arm.instrument)
        if gap < min_gap_m:
            blocked.append(f"{candidate}: {gap * 1e3:.2f} mm of clearance")
            continue
        for pose in (T_board_tip, T_board_tip @ SE3.from_parts(SO3.axis("z", np.pi))):
            try:
                q = ik(arm, T_base_board @ pose)
            except OutOfReach:
                blocked.append(f"{candidate}: out of reach")
                continue
            if not wrist_has_room(arm, q, max_roll_rad):
                blocked.append(f"{candidate}: roll {shown(q[3], 'rad', '.0f')} or wrist at its limit")
                continue
            jaw = 2 * float(np.arcsin(min(opening / 2 / arm.tip_length_m, 1.0)))
            grasp = Grasp(pose, q, jaw, gap, candidate)
            if best is None or _rank(grasp, avoid) > _rank(best, avoid):
                best = grasp
    return best or f"none of the six grasps is feasible ({'; '.join(blocked)})"


def plan_grasp(
    arm: ArmModel,
    T_base_board: SE3,
    T_board_block: SE3,
    board: Pegboard,
    block: Block,
    others: Sequence[SE3] = (),
    *,
    avoid: Collection[int] = (),
    depth_m: float = DEPTH_M,
    hands_over: bool = False,
) -> Grasp | str:
    """Return the grasp by the first rule that allows one, or one sentence why none does.

    Arguments as in ``choose_grasp``. ``hands_over``: whether the block is for another arm, so that walls on the arm's
    own side are preferred.
    """
    own_side, grasp = T_base_board.inverse().translation_m[:2], ""
    for outer, min_gap_m, max_roll_rad in _RULES:
        if outer and not hands_over:
            continue
        rule = {"min_gap_m": min_gap_m, "max_roll_rad": max_roll_rad, "towards": own_side if outer else None}
        grasp = choose_grasp(
            arm, T_base_board, T_board_block, board, block, others, avoid=avoid, depth_m=depth_m, **rule
        )
        if isinstance(grasp, Grasp):
            return grasp
    return grasp


def _rank(grasp: Grasp, avoid: Collection[int]) -> tuple[bool, float, float]:
    """Return the sort key of a grasp: not failed before, then clearance, then small roll."""
    return grasp.candidate not in avoid, round(grasp.clearance_m, 5), -abs(float(grasp.q[3]))


def vertical_grasps(
    T_board_block: SE3,
    depth_m: float,
    from_middle_m: float = GRASP_FROM_MIDDLE_M,
    aside_m: tuple[float, float] = GRASP_ASIDE_M,
) -> list[SE3]:
    """Return the six candidates in the board frame, with the tool vertical even if the block is tilted."""
    poses = []
    for matrix in (T_board_block @ grasp_candidates(depth_m, from_middle_m, aside_m)).matrix:
        x = np.array([matrix[0, 0], matrix[1, 0], 0.0])
        x /= np.linalg.norm(x)
        z = np.array([0.0, 0.0, 1.0])
        poses.append(SE3.from_parts(SO3.unchecked(np.column_stack([x, np.cross(z, x), z])), matrix[:3, 3]))
    return poses


def _opening(
    T_board_tip: SE3, T_board_block: SE3, board: Pegboard, block: Block, near: list[SE3], instrument: Instrument
) -> tuple[float, float]:
    """Return the opening (distance of the fingers' inner faces) with the largest clearance, and the clearance, in m.

    The inner finger is in the hole, the outer one beside the block; gaps to walls are measured along the radius.
    """
    openings = np.arange(MIN_OPENING_M, MAX_OPENING_M + 1e-9, OPENING_STEP_M)
    inner, outer = (_finger(T_board_tip, side * openings / 2, instrument) for side in (-1, 1))
    gaps = []
    radius, angle = _polar(T_board_block, inner)
    gaps.append(block.hole_radius_m(angle) - radius)
    for pose in (T_board_block, *near):
        radius, angle = _polar(pose, outer)
        gaps.append(radius - block.outer_radius_m(angle))
    pegs = board.pegs_m[:, :2]
    for finger in (inner, outer):
        gaps.append(np.linalg.norm(finger[:, :, None] - pegs, axis=-1).min(-1) - board.peg_radius_m)
    clearance = np.min(gaps, axis=(0, 2))
    best = int(np.argmax(clearance))
    return float(openings[best]), float(clearance[best])


def _finger(T_board_tip: SE3, face_m: NDArray[np.float64], instrument: Instrument) -> NDArray[np.float64]:
    """Return points (n, m, 2) in the board's plane on a finger's outline, for positions (n,) of its inner face."""
    across, along = np.linspace(-0.5, 0.5, 9), np.linspace(0, 1, 5)
    square = [(a, b) for a in (0.0, 1.0) for b in across] + [(a, b) for a in along for b in (-0.5, 0.5)]
    outline = np.array(square) * [instrument.finger_thickness_m(NEAR_END_M), instrument.finger_width_m]
    sign = np.sign(face_m)[:, None]
    x = face_m[:, None] + sign * outline[:, 0]
    local = np.stack([x, np.broadcast_to(outline[:, 1], x.shape)], -1)
    return local @ T_board_tip.matrix[:2, :2].T + T_board_tip.translation_m[:2]


def _polar(T_board_block: SE3, xy_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return radius and angle, in a block's frame, of points (..., 2) in the board's plane."""
    local = (xy_m - T_board_block.translation_m[:2]) @ T_board_block.matrix[:2, :2]
    return np.hypot(local[..., 0], local[..., 1]), np.arctan2(local[..., 1], local[..., 0])


def wrist_has_room(arm: ArmModel, q: NDArray[np.float64], max_roll_rad: float) -> bool:
    """Return whether joints (6,) keep a margin to the wrist's limits, and the roll small."""
    wrist = zip(arm.joints[4:], q[4:], strict=True)
    return abs(q[3]) <= max_roll_rad and all(j.lower + MARGIN_RAD <= v <= j.upper - MARGIN_RAD for j, v in wrist)


def yaw_of(pose: SE3) -> float:
    """Return the yaw of a pose in rad: the angle about z from its frame's x axis to its own."""
    return float(np.arctan2(pose.matrix[1, 0], pose.matrix[0, 0]))


def held_block(T_board_tip: SE3, T_board_block: SE3, block: Block) -> SE3:
    """Return ``T_tip_block`` after the jaws have closed: they centre the wall of the block between them."""
    matrix = (T_board_tip.inverse() @ T_board_block).matrix.copy()
    matrix[0, 3] = np.sign(matrix[0, 3]) * block.wall_middle_m
    return SE3.unchecked(matrix)


def choose_place(
    arm: ArmModel,
    T_base_board: SE3,
    T_tip_block: SE3,
    board: Pegboard,
    block: Block,
    peg: int,
    others: Sequence[SE3],
    drop_m: float,
    yaw_rad: float = 0.0,
) -> SE3 | str:
    """Return the pose of the tip at which to release a held block over a peg, or one sentence why there is none.

    The tool is vertical, and any yaw of the block is allowed. If there is enough clearance to other blocks and pegs,
    the tool keeps its current yaw: the residual cable errors are then similar at both ends of the transfer and cancel.

    Arguments as in ``choose_grasp``. ``T_tip_block`` is the pose of the block in the jaws, ``peg`` the target,
    ``drop_m`` the height of the block's lower face above the plate, ``yaw_rad`` the tool's current yaw on the board.
    """
    foot = board.pegs_m[peg]
    near = np.linalg.norm(board.pegs_m[:, :2] - foot[:2], axis=1)
    pegs = board.pegs_m[(near > 1e-6) & (near < REACH_M), :2]
    near_blocks = [T for T in others if 1e-3 < np.linalg.norm(T.translation_m[:2] - foot[:2]) < REACH_M]
    blocks = np.array([T.translation_m[:2] for T in near_blocks]).reshape(-1, 2)
    best: tuple[tuple[float, float], SE3] | None = None
    level = SO3.between(-T_tip_block.matrix[:3, 2], [0.0, 0.0, 1.0])
    for yaw in yaw_rad + YAWS_RAD:
        upright = SO3.axis("z", yaw) @ level
        centre = upright.apply(T_tip_block.translation_m)
        height = block.height_m + drop_m - centre[2]
        x, y = hole_over(foot, SE3.from_parts(upright), T_tip_block) - centre[:2]
        pose = SE3.from_parts(upright, [x, y, foot[2] + height])
        try:
            q = ik(arm, T_base_board @ pose)
        except OutOfReach:
            continue
        if not wrist_has_room(arm, q, MAX_ROLL_RAD):
            continue
        T_board_block, outwards = pose @ T_tip_block, upright.matrix[:2, 0]
        finger = pose.translation_m[:2] - np.sign(T_tip_block.translation_m[0]) * OUTER_FINGER_M * outwards
        room = min(
            float(np.min(np.linalg.norm(pegs - finger, axis=1) - board.peg_radius_m, initial=1.0)),
            float(np.min(np.linalg.norm(blocks - finger, axis=1) - block.corner_m, initial=1.0)),
            min((block.gap_m(T_board_block, other) for other in near_blocks), default=1.0),
        )
        rank = min(room, ROOM_M), float(outwards @ [np.cos(yaw_rad), np.sin(yaw_rad)])  # room, then little rotation
        if best is None or rank > best[0]:
            best = rank, pose
    return best[1] if best else f"no pose over peg {peg} keeps the roll and the wrist within their limits"


def hole_over(foot_m: NDArray[np.float64], T_board_tip: SE3, T_tip_block: SE3) -> NDArray[np.float64]:
    """Return the point (2,) in the board's plane where a held block's hole has to be to receive a peg."""
    outwards = -np.sign(T_tip_block.translation_m[0]) * T_board_tip.matrix[:2, 0]
    return np.asarray(foot_m[:2] + FINGER_ROOM_M * outwards, dtype=np.float64)
