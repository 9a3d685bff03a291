"""Commands within the limits, beside the correction that they replace: limits, time, and where joints and tip end up.

Motions as the agents plan them (peg transfers, sutures) and through the recorded waypoints, driven in the identified
plants with models fitted on noisy recordings of these plants. All of it takes two or three minutes;
``--models play --rounds 1`` half a minute.

Run: .venv/bin/python benchmarks/bench_command_limits.py [--models play ridge] [--rounds N]; the recordings:
TROCAR_DATA, or shared/data beside the repository.
"""

import argparse
import os
import time
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.ndimage import uniform_filter1d

from trocar.arms import MOTION_LIMITS, fk, ik
from trocar.calibration.command_path import CommandRequest, command_paths
from trocar.calibration.compensation import Compensator, HysteresisState, sample_positions
from trocar.calibration.excitation import EXERCISE_RAD, random_smooth_path
from trocar.calibration.models import MODELS
from trocar.calibration.plant import PLANTS
from trocar.calibration.recording import Recording
from trocar.geometry import SE3
from trocar.lab import load_station
from trocar.motion import limit_use, plan_through, rest_to_rest
from trocar.robots.compensated import RANGE_GUARD
from trocar.tasks.peg_transfer.agents import GRASP_RULES, Settings
from trocar.tasks.peg_transfer.grasps import Grasp, choose_grasp, choose_place, held_block
from trocar.tasks.peg_transfer.task import PegTransfer
from trocar.tasks.suture.agents.circle import JOINED, TRAVELS, along
from trocar.tasks.suture.agents.circle import Settings as SutureSettings
from trocar.tasks.suture.planning.segments import suture_segments
from trocar.tasks.suture.task import CircleSutures
from trocar.trajectory import Trajectory

PEG_TASK, SUTURE_TASK = PegTransfer(), CircleSutures()
PEG_STATION = PEG_TASK.at(load_station(PEG_TASK.station))
SUTURE_STATION = SUTURE_TASK.at(load_station(SUTURE_TASK.station))
ARM, PAPER = PEG_STATION.arm("psm1").model, MOTION_LIMITS["paper"]
LOW_M = 10e-3
REPLAY_S = 2e-3
WARM_UP = 3  # motions that take up the slack, unknown at the start


class Corrected:
    """The correction without limits: inverted point by point, averaged over three knots, never slowed down."""

    def __init__(self, model, q_start):
        self.compensator = Compensator(model)
        self.compensator.start(q_start)

    def commands(self, desired, q_start):
        """Return commands and the joints that they are meant for."""
        times, wanted = desired.sample(0.020)
        rows, model = np.arange(len(times)), self.compensator.model
        positions = rows if model.rate_independent else sample_positions(wanted, model.training)
        at = np.interp(positions, rows, times)
        raw = self.compensator.path(desired(at)) - desired(at)
        raw[0] = q_start - wanted[0]
        correction = np.column_stack([np.interp(times, at, column) for column in raw.T])
        smooth = uniform_filter1d(correction, 3, axis=0, mode="nearest")
        fade = np.minimum(1.0, np.minimum(rows, rows[::-1]) / 3)
        correction += fade[:, None] * (smooth - correction)
        lower, upper = ARM.lower + RANGE_GUARD, ARM.upper - RANGE_GUARD
        free = wanted + correction
        q_cmd = np.where((wanted > lower) & (wanted < upper), np.clip(free, lower, upper), free)
        velocity = np.gradient(q_cmd, times, axis=0)
        velocity[[0, -1]] = 0.0
        velocity[q_cmd != free] = 0.0
        return Trajectory.hermite(times - times[0], q_cmd, velocity), desired


class Limited:
    """The commands of :func:`command_paths`."""

    def __init__(self, model, q_start):
        self.memory = HysteresisState.at_rest(model, q_start)

    def commands(self, desired, q_start):
        """Return commands and the joints that they are meant for."""
        request = CommandRequest(
            self.memory, desired, q_start, np.zeros(6), PAPER, ARM.lower + RANGE_GUARD, ARM.upper - RANGE_GUARD
        )
        path = command_paths({"arm": request})["arm"]
        self.memory = path.memory_at(path.commands.duration_s)
        return path.commands, path.desired


def peg_transfers(name, rng, rounds):
    """Return the joints at the start, and the motions of whole trials as the agent plans them."""
    settings, known, arm = Settings(), PEG_TASK.nominal(), PEG_STATION.arm(name)
    home = arm.park_q()
    motions = _wake(home)
    for _ in range(rounds):
        scene = PEG_TASK.scene(rng, PEG_STATION)
        T_base_board = arm.T_world_base.inverse() @ scene.T_world_board
        T_board_blocks = scene.T_world_board.inverse() @ scene.T_world_blocks
        blocks = {peg: T_board_blocks[peg] for peg in range(len(T_board_blocks.matrix))}
        q, up = home, T_base_board.matrix[:3, 2]

        def raised(T_board_tip, height_m, base=T_base_board):
            x, y, _ = T_board_tip.translation_m
            return ik(ARM, base @ SE3.from_parts(T_board_tip.rotation, [x, y, height_m]))

        for source, target in PEG_TASK.goals():
            grasp = _grasped(T_base_board, blocks, source, known)
            if grasp is None:
                continue
            T_board_tip = T_base_board.inverse() @ fk(ARM, q)
            points = [q] if q is home else [q, raised(T_board_tip, settings.clear_height_m)]
            points += [raised(grasp.T_board_tip, settings.clear_height_m), ik(ARM, T_base_board @ grasp.T_board_tip)]
            T_tip_block = held_block(grasp.T_board_tip, blocks[source], known.block)
            others = [pose for peg, pose in blocks.items() if peg != source]
            yaw = float(np.arctan2(grasp.T_board_tip.matrix[1, 0], grasp.T_board_tip.matrix[0, 0]))
            place = choose_place(
                ARM, T_base_board, T_tip_block, known.board, known.block, target, others, settings.drop_m, yaw
            )
            if isinstance(place, str):
                continue
            height = float(grasp.T_board_tip.translation_m[2]) + settings.lift_m
            down = ik(ARM, T_base_board @ place)
            carried = [points[-1], raised(grasp.T_board_tip, height), raised(place, height), down]
            motions += [plan_through(ARM, stops, PAPER, up=up).trajectory for stops in (points, carried)]
            blocks[target] = place @ T_tip_block
            del blocks[source]
            q = down
        motions.append(rest_to_rest(q, home, PAPER))
    return home, motions


def _wake(home):
    swing = np.append(np.zeros(3), EXERCISE_RAD)
    stops = [home, home + swing, home - swing, home]
    return [rest_to_rest(a, b, PAPER) for a, b in pairwise(stops)]


def _grasped(T_base_board, blocks, source, known):
    others = [pose for peg, pose in blocks.items() if peg != source]
    for outer, min_gap_m, max_roll_rad in GRASP_RULES:
        if outer:
            continue
        grasp = choose_grasp(
            ARM,
            T_base_board,
            blocks[source],
            known.board,
            known.block,
            others,
            depth_m=Settings().depth_m,
            min_gap_m=min_gap_m,
            max_roll_rad=max_roll_rad,
        )
        if isinstance(grasp, Grasp):
            return grasp
    return None


def recorded_transfers(rng):
    """Return the splines through the recorded waypoints, each reached by a plain move."""
    data = Path(os.environ.get("TROCAR_DATA", Path(__file__).parents[2] / "shared" / "data"))
    with np.load(data / "dvrk/motion/reference_waypoints.npz") as recorded:
        waypoints = np.clip(recorded["waypoints"], ARM.lower, ARM.upper)
    q = waypoints[0][0]
    motions = _wake(q)
    for four in waypoints[rng.permutation(len(waypoints))]:
        if np.abs(four[0] - q).max() > JOINED:
            motions.append(rest_to_rest(q, four[0], PAPER))
        motions.append(plan_through(ARM, four, PAPER, range_slack=0.02).trajectory)
        q = four[-1]
    return waypoints[0][0], motions


def sutures():
    """Return the sutures of the task as its agent drives them."""
    settings = SutureSettings()
    home = q = SUTURE_STATION.arm("psm1").park_q()
    motions = _wake(home)
    for suture in SUTURE_TASK.goals():
        for segment in suture_segments(suture):
            if len(segment.q) < 2:
                continue
            if np.abs(segment.q[0] - q).max() > JOINED:
                motions.append(rest_to_rest(q, segment.q[0], settings.limits))
                q = segment.q[0]
            speed = settings.travel_speed_m_s if segment.name in TRAVELS else settings.driving_speed_m_s
            motions.append(along(np.concatenate([q[None], segment.q[1:]]), segment.length_m / speed))
            q = segment.q[-1]
        motions.append(rest_to_rest(q, home, settings.limits))
        q = home
    return home, motions


def fitted(kind, plant, box, rng):
    """Return a model fitted on a noisy recording of the plant."""
    q = random_smooth_path(ARM, rng, box=box)
    measured = plant.measure(plant.run(q), rng)
    return MODELS[kind].fit(Recording(q, measured, np.ones(len(q), bool), 0.8 * np.arange(len(q))), rng)


@dataclass
class Tally:
    """What one way of commanding did on all motions; errors are those of the true joints."""

    velocity: list = field(default_factory=list)
    acceleration: list = field(default_factory=list)
    added_s: list = field(default_factory=list)
    end: list = field(default_factory=list)
    end_tip_m: list = field(default_factory=list)
    low_tip_m: list = field(default_factory=list)
    tip_m: list = field(default_factory=list)
    joints_rad: list = field(default_factory=list)
    compute_ms: list = field(default_factory=list)

    def row(self):
        """Return the cells of the table."""
        end, low = np.abs(1e3 * np.array(self.end)), 1e3 * np.concatenate(self.low_tip_m or [np.zeros(1)])
        whole = 1e3 * np.concatenate(self.tip_m)
        rms = np.sqrt(np.mean(end**2, axis=0))
        return [
            f"{np.median(self.velocity):.2f} / {max(self.velocity):.2f}",
            f"{np.median(self.acceleration):.2f} / {max(self.acceleration):.6f}",
            f"{1e3 * np.mean(self.added_s):.1f} / {1e3 * max(self.added_s):.0f}",
            " ".join(f"{one:.1f}" for one in rms) + f" / {end.max():.1f}",
            f"{1e3 * _rms(self.end_tip_m):.3f} / {1e3 * max(self.end_tip_m):.2f}",
            f"{_rms(low):.3f} / {low.max():.2f}",
            f"{_rms(whole):.3f} / {whole.max():.2f}",
            f"{1e3 * np.median(self.joints_rad):.0f} / {1e3 * max(self.joints_rad):.0f}",
            f"{np.median(self.compute_ms):.0f} / {np.quantile(self.compute_ms, 0.95):.0f}",
        ]


HEAD = [
    "plant, motions",
    "model",
    "commands",
    "velocity med / max",
    "acceleration med / max",
    "added ms a motion mean / max",
    "end q4 q5 q6 mrad RMS / max",
    "tip at end mm RMS / max",
    "tip in lowest 10 mm",
    "tip all along",
    "joints mrad med / max",
    "compute ms p50 / p95",
]


def _rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def tally(way, plant, home, motions, rng):
    """Return what a way of commanding does in a plant whose slack nobody knows at the start."""
    found = Tally()
    q = home - plant.run(home[None])[0] + home
    state = tuple(np.array(plant.start(q)) + rng.uniform(-1.0, 1.0, 3) * plant.radii)
    commander = way(q)
    for number, motion in enumerate(motions):
        began = time.process_time()
        commands, desired = commander.commands(motion, q)
        compute_ms = 1e3 * (time.process_time() - began)
        steps = 1 + int(np.ceil(commands.duration_s / REPLAY_S))
        times = np.linspace(0.0, commands.duration_s, steps)
        sent, asked, joints = commands(times), desired(desired.times_s[0] + times), np.empty((steps, 6))
        for row, command in enumerate(sent):
            joints[row], state = plant.step(state, command)
        q = sent[-1]
        if number < WARM_UP:
            continue
        use = limit_use(ARM, commands, PAPER)
        tip = fk(ARM, asked).translation_m
        off = np.linalg.norm(fk(ARM, joints).translation_m - tip, axis=1)
        low = _low(tip[:, 2])
        found.velocity.append(use.velocity_ratio)
        found.acceleration.append(use.acceleration_ratio)
        found.added_s.append(commands.duration_s - motion.duration_s)
        found.end.append((joints - asked)[-1, 3:])
        found.end_tip_m.append(off[-1])
        if low.any():
            found.low_tip_m.append(off[low])
        found.tip_m.append(off)
        found.joints_rad.append(np.abs(joints - asked)[:, 3:].max())
        found.compute_ms.append(compute_ms)
    return found


def _low(height_m):
    """Return where (n,) a tip is in the lowest 10 mm of a lift or a lowering."""
    rises, sinks = height_m.max() - height_m[0] > 1.5 * LOW_M, height_m.max() - height_m[-1] > 1.5 * LOW_M
    lifting = np.logical_and.accumulate(height_m < height_m[0] + LOW_M) & rises
    lowering = np.logical_and.accumulate((height_m < height_m[-1] + LOW_M)[::-1])[::-1] & sinks
    return lifting | lowering


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", nargs="+", default=["play", "ridge", "offset"], choices=list(MODELS))
    parser.add_argument("--rounds", type=int, default=2, help="trials of twelve peg transfers")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    print("| " + " | ".join(HEAD) + " |\n" + "|---" * len(HEAD) + "|")
    for plant_name, plant in PLANTS.items():
        name = plant_name.split("_", maxsplit=1)[0]
        box = PEG_TASK.calibration(PEG_STATION, name)
        rng = np.random.default_rng(options.seed)
        cases = {"peg transfers": (box, peg_transfers(name, rng, options.rounds))}
        if name == "psm1":
            cases["recorded transfers"] = (box, recorded_transfers(rng))
            cases["sutures"] = (SUTURE_TASK.calibration(SUTURE_STATION, name), sutures())
        for title, (case_box, (home, motions)) in cases.items():
            for kind in options.models:
                model = fitted(kind, plant, case_box, np.random.default_rng(options.seed))
                for said, way in (("as it was", Corrected), ("limited", Limited)):
                    found = tally(
                        lambda q, way=way, model=model: way(model, q),
                        plant,
                        home,
                        motions,
                        np.random.default_rng(options.seed),
                    )
                    cells = [f"{plant_name}, {len(motions)} {title}", kind, said, *found.row()]
                    print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
