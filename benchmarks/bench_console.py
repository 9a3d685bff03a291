"""Peg transfer by a scripted person over the console's socket, who sees late and whose hand trembles.

The person sees the true poses of tips and blocks, as through a stereo view, but those of ``--late`` seconds ago, and
moves a device whose position trembles. It plans nothing: it goes above a block, down, closes, lifts, goes over the peg,
down, opens, and corrects the errors that it sees on the way, at the cell's own pace.

Run: .venv/bin/python benchmarks/bench_console.py --seed 31
Ten demonstrations of one transfer each, as a run that `trocar export` takes:
     .venv/bin/python benchmarks/bench_console.py --transfers 1 --trials 10 --out out/person
"""

from __future__ import annotations

import argparse
import json
import socket
import threading
import time
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from trocar.arms import fk
from trocar.console import Watch
from trocar.eval.config import RunConfig
from trocar.eval.folder import load_trials, open_folder
from trocar.eval.jobs import play_run
from trocar.eval.trial import Trial
from trocar.geometry import SE3, SO3
from trocar.sim.laboratory import SimLaboratory
from trocar.tasks.peg_transfer.goals import Transfer
from trocar.tasks.peg_transfer.grasps import Grasp, choose_grasp
from trocar.tasks.peg_transfer.task import PegTransfer

RATE_HZ = 30.0
SPEED_M_S, SPEED_RAD_S = 0.06, 1.2
SCALE = 0.3
"""Metres that the tip moves per metre of the hand."""
GAIN = 1.5
"""Share of the visible error that the hand corrects per second."""
NEAR_M, NEAR_RAD = 1.0e-3, 0.06
STILL_S, PATIENCE_S = 0.25, 6.0
ABOVE_M = 0.035
OPEN = 0.35
"""Share of the jaws' range to which they open round a wall."""
CARRIED_M, LOWERED_M = 0.050, 0.018
"""Height of a block's frame over the board's plane on the way to a peg, and where it is let go."""
STANDS_M = 8e-3
TRIES = 3
ARM = "psm1"


class Person:
    """Speaks to the console as any device does, in a thread of its own for each trial.

    Args:
        port: of the console's inputs.
        late_s: delay of what is seen.
        tremor_m: standard deviation of the hand's place, low-passed at 8 Hz.
        rng: of the tremor.
    """

    def __init__(self, port: int, late_s: float, tremor_m: float, rng: np.random.Generator):
        self.port, self.late_s, self.tremor_m, self.rng = port, late_s, tremor_m, rng
        self.laboratory: SimLaboratory | None = None

    def begin(self, laboratory: SimLaboratory, goals: Sequence[Transfer]) -> None:
        """Begin with a trial."""
        self.views: deque[tuple[float, dict[str, SE3]]] = deque(maxlen=400)
        self.scene: Any = laboratory.task._scene
        self.laboratory, self.goals = laboratory, goals
        self.hand, self.turned, self.shake = np.zeros(3), SO3.exp(np.zeros(3)), np.zeros(3)
        self.thread = threading.Thread(target=self.run, daemon=True)
        self.thread.start()

    def look(self) -> None:
        """Note the true poses of now; called on the cell's thread."""
        laboratory = self.laboratory
        if laboratory is None:
            return
        world = laboratory.world
        tip = world.T_world_base[ARM] @ fk(world.models[ARM], world.joints(ARM))
        places = {name: world.free_pose(name) for name in world.free_bodies if name.startswith("block")}
        self.views.append((self.now_s(), {"tip": tip, **places}))

    def now_s(self) -> float:
        """Return the cell's time, by which the person acts: a busy machine does not delay it."""
        return self.laboratory.now_s() if self.laboratory is not None else 0.0

    def sleep(self, seconds: float) -> None:
        """Wait on the cell's clock."""
        end_s = self.now_s() + seconds
        while self.now_s() < end_s:
            time.sleep(0.001)

    def seen(self) -> dict[str, SE3]:
        """Return the poses that the person sees: those of ``late_s`` ago."""
        now = self.now_s()
        return next((view for at, view in reversed(self.views) if at <= now - self.late_s), self.views[0][1])

    def run(self) -> None:
        """Clear the board."""
        with socket.create_connection(("127.0.0.1", self.port)) as connection:
            self.stream = connection.makefile("rwb")
            while not self.views:
                time.sleep(0.05)
            self.sleep(self.late_s + 0.1)
            for source, target in self.goals:
                any(self.transfer(source, target) for _ in range(TRIES))
            self.say(wish="done")

    def transfer(self, source: int, target: int) -> bool:
        """Carry the block on one peg to another; return False if it was not lifted, to try again."""
        assert self.laboratory is not None
        world, scene = self.laboratory.world, self.scene
        board, block, T_world_board = scene.board, scene.block, scene.T_world_board
        seen = self.seen()
        names = [name for name in seen if name != "tip"]
        blocks = SE3(np.stack([(T_world_board.inverse() @ seen[name]).matrix for name in names]))
        off = np.linalg.norm(blocks.translation_m[:, :2] - board.pegs_m[source][:2], axis=1)
        mine = int(off.argmin())
        T_base_board = world.T_world_base[ARM].inverse() @ T_world_board
        grasp = choose_grasp(world.models[ARM], T_base_board, blocks[mine], board, block, blocks)
        if off[mine] > STANDS_M or not isinstance(grasp, Grasp):
            print(f"no block to grasp on peg {source}")
            return True
        over, T_tip = SE3.from_parts(translation_m=[0.0, 0.0, ABOVE_M]), T_world_board @ grasp.T_board_tip
        self.go(over @ T_tip, OPEN)
        self.go(T_tip, OPEN)
        self.wait(0.6, 0.0)
        self.go(over @ T_tip, 0.0)
        if self.seen()[names[mine]].translation_m[2] - seen[names[mine]].translation_m[2] < ABOVE_M / 2:
            self.wait(0.6, OPEN)
            return False
        place = T_world_board.apply([*board.pegs_m[target][:2], 0.0])
        upright = (T_world_board @ blocks[mine]).rotation
        for height_m in (CARRIED_M, LOWERED_M):
            goal = SE3.from_parts(upright, place + [0.0, 0.0, height_m])
            self.go(goal, 0.0, of=names[mine])
        self.wait(0.6, OPEN)
        self.go(over @ self.seen()["tip"], OPEN)
        return True

    def go(self, goal: SE3, jaw: float, of: str = "tip") -> None:
        """Move until the tip, or the block that it holds, is seen at its goal, for ``PATIENCE_S`` at most.

        The person clutches first, so that hand and arm agree again where the arm could not follow.
        """
        self.say(arm=ARM, held=False)
        began, since = self.now_s(), 0.0
        while self.now_s() - began < PATIENCE_S:
            now = self.seen()[of]
            off, turn = goal.translation_m - now.translation_m, (goal.rotation @ now.rotation.inverse()).log()
            near = np.linalg.norm(off) < NEAR_M and np.linalg.norm(turn) < NEAR_RAD
            since = (since or self.now_s()) if near else 0.0
            if since and self.now_s() - since > STILL_S:
                return
            self.move(limited(GAIN * off, SPEED_M_S), limited(GAIN * turn, SPEED_RAD_S), jaw)

    def wait(self, seconds: float, jaw: float) -> None:
        """Hold still."""
        end = self.now_s() + seconds
        while self.now_s() < end:
            self.move(np.zeros(3), np.zeros(3), jaw)

    def move(self, velocity: np.ndarray, turning: np.ndarray, jaw: float) -> None:
        """Move the hand for one period."""
        step_s = 1 / RATE_HZ
        share = 1 - np.exp(-2 * np.pi * 8.0 * step_s)
        noise = self.rng.normal(scale=self.tremor_m * np.sqrt((2 - share) / share), size=3)
        self.shake = self.shake + share * (noise - self.shake)
        self.hand, self.turned = self.hand + velocity / SCALE * step_s, SO3.exp(turning * step_s) @ self.turned
        turn = self.turned.as_quaternion()[[1, 2, 3, 0]]
        place = (self.hand + self.shake).tolist()
        self.say(arm=ARM, held=True, position=place, quaternion=turn.tolist(), scale=SCALE, jaw=jaw)
        self.sleep(step_s)

    def say(self, **line: object) -> None:
        """Send a line and read the answer."""
        self.stream.write(json.dumps(line).encode() + b"\n")
        self.stream.flush()
        self.stream.readline()


def limited(vector: np.ndarray, most: float) -> np.ndarray:
    """Return a vector, shortened to this length if it is longer."""
    length = float(np.linalg.norm(vector))
    return vector if length <= most else vector * (most / length)


class Seat(Watch):
    """A console at which the scripted person sits."""

    def __init__(self, person: Person, **how: Any):
        super().__init__(**how)
        self.person = person
        if self._inputs is not None:
            person.port = self._inputs.port

    def attend(self, config: RunConfig, laboratory: SimLaboratory) -> None:
        """Show the laboratory to the person, who begins."""
        super().attend(config, laboratory)
        show = self.console._show

        def both() -> None:
            show()
            self.person.look()

        self.console._show = both
        self.person.begin(laboratory, config.task.goals())

    def play(self, config: RunConfig, out: Path | None) -> None:
        """Play the trials of a run with the person at the console, print how they ended, and keep them in ``out``."""
        with TemporaryDirectory() as aside:
            folder = out or Path(aside)
            for wrong in play_run(config, folder, open_folder(config, folder), attendant=self, raise_errors=True):
                print(wrong)
            for trial in load_trials(folder)[0]:
                print_trial(trial)


def print_trial(trial: Trial) -> None:
    """Print the outcome of a trial."""
    done = sum(score["succeeded"] for score in trial.scores)
    print(f"{done} of {len(trial.scores)} transfers in {trial.duration_s:.0f} s, {len(trial.collisions)} collisions")
    print(f"ended {trial.ended} {trial.reason}")
    for number, score in enumerate(trial.scores, 1):
        print(number, score)


def main() -> None:
    """Run the trials."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--late", type=float, default=0.2, help="Seconds by which the person sees late.")
    parser.add_argument("--tremor-mm", type=float, default=1.0)
    parser.add_argument("--transfers", type=int, default=12)
    parser.add_argument("--speed", type=float, default=1.0, help="Seconds of the cell's clock a second.")
    parser.add_argument("--method", default="person")
    parser.add_argument("--trials", type=int, default=1)
    parser.add_argument("--out", type=Path, help="Folder of the run; default: it is not kept.")
    given = parser.parse_args()
    task = PegTransfer(transfers=given.transfers, budget_s=600.0)
    config = RunConfig(task, method=given.method, seed=given.seed, trials=given.trials)
    person = Person(0, given.late, 1e-3 * given.tremor_mm, np.random.default_rng(given.seed))
    with Seat(person, speed=given.speed, port=None, inputs=0) as seat:
        seat.play(config, given.out)
    p50, p95 = 1e3 * np.percentile(seat.latencies_s, (50, 95))
    print(f"from the hand to the set-point: p50 {p50:.0f} ms, p95 {p95:.0f} ms")


if __name__ == "__main__":
    main()
