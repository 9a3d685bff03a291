"""Errors and times of perception over random scenes with all sensor flaws on.

Run: python benchmarks/bench_perception.py [scenes]
"""

from __future__ import annotations

import sys
import time

import numpy as np
from random_cells import overhead, random_scene, world_of

from trocar.geometry import SE3
from trocar.tasks.peg_transfer.perception.blocks import find_block
from trocar.tasks.peg_transfer.perception.board import find_board


def main(scenes: int) -> None:
    errors, times = [], {"render": [], "board": [], "block": []}
    board_errors, missed, phantoms, empty = [], 0, 0, 0
    for seed in range(scenes):
        rng = np.random.default_rng(seed)
        scene, pegs = random_scene(rng, int(rng.integers(1, 10)))
        model, data = world_of(scene)
        camera = overhead(model)
        image = _timed(times["render"], camera.render, data, rng)
        board = _timed(times["board"], find_board, image, camera.T_world_camera, scene.board)
        if isinstance(board, str):
            board_errors.append(np.full(6, np.nan))
            continue
        board_errors.append((scene.T_world_board.inverse() @ board).log())
        T_camera_board = camera.T_world_camera.inverse() @ board
        for peg in range(len(scene.board.pegs_m)):
            found = _timed(times["block"], find_block, image, T_camera_board, scene.board, scene.block, peg)
            if peg not in pegs:
                empty += 1
                phantoms += not isinstance(found, str)
            elif isinstance(found, str):
                missed += 1
                print(f"missed: seed {seed}, peg {peg}: {found}")
            else:
                true = scene.T_world_blocks[list(pegs).index(peg)]
                errors.append(_error(board @ found, true))
    position_mm, yaw_deg = np.abs(np.array(errors)).T
    shift = np.array(board_errors)
    total = len(errors) + missed
    print(f"{scenes} scenes, {total} blocks, {empty} empty pegs, all sensor flaws on, board found by find_board")
    print(
        f"block position error mm   p50 {np.median(position_mm):.3f}  p95 {np.percentile(position_mm, 95):.3f}  "
        f"max {position_mm.max():.3f}   (target p95 .5)"
    )
    print(
        f"block yaw error deg       p50 {np.median(yaw_deg):.3f}  p95 {np.percentile(yaw_deg, 95):.3f}  "
        f"max {yaw_deg.max():.3f}   (target p95 2)"
    )
    print(f"false negatives {missed} of {total}, false positives {phantoms} of {empty}")
    print(
        f"board: not found {int(np.isnan(shift[:, 0]).sum())} of {scenes}; "
        f"p95 {1e3 * np.nanpercentile(np.linalg.norm(shift[:, :3], axis=1), 95):.3f} mm, "
        f"{np.degrees(np.nanpercentile(np.linalg.norm(shift[:, 3:], axis=1), 95)):.3f} deg"
    )
    for name, values in times.items():
        print(f"{name:7s} ms   p50 {1e3 * np.median(values):.1f}  p95 {1e3 * np.percentile(values, 95):.1f}")


def _timed(into, function, *arguments):
    start = time.perf_counter()
    result = function(*arguments)
    into.append(time.perf_counter() - start)
    return result


def _error(found: SE3, true: SE3) -> tuple[float, float]:
    """Return distance in mm and yaw in deg modulo 120 between two poses of a block in the world."""
    x, y = (true.inverse() @ found).matrix[:2, 0]
    yaw = (np.degrees(np.arctan2(y, x)) + 60) % 120 - 60
    return 1e3 * float(np.linalg.norm(found.translation_m - true.translation_m)), float(yaw)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
