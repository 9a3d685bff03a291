"""The work of a study: sessions are calibrated, trials are run and reduced, all by any number of workers."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from trocar.errors import TrocarError
from trocar.tasks.peg_transfer.study.cells import Cell, opened
from trocar.tasks.peg_transfer.study.row import read_row
from trocar.trials.orders import TrialOrder, calibrate, play
from trocar.trials.workers import Workers, run_all

Tick = Callable[[str, int, int], None]
"""Called with what is done now, how many units are done, and of how many."""


def run_study(cells: Sequence[Cell], workers: Workers, tick: Tick) -> list[str]:
    """Run what a study lacks; return a sentence for each trial that is void.

    Args:
        cells: of the study.
        workers: who work.
        tick: for a progress bar.
    """
    sessions, todo = opened(cells)
    wanted = sum(len(cell.places) for cell in cells)
    calibrated = [order for order in sessions if any(config.chosen_method.calibrated for config, _ in order.runs)]
    for done, _ in enumerate(run_all(calibrate, calibrated, workers), start=1):
        tick("calibrating sessions", done, len(calibrated))
    there = wanted - len(todo)
    tick("running trials", there, wanted)
    void = []
    for done, (_, sentence) in enumerate(run_all(play_and_reduce, todo, workers), start=1):
        tick("running trials", there + done, wanted)
        void += [sentence] if sentence else []
    return void


def play_and_reduce(order: TrialOrder) -> str:
    """Run a trial, unless it is there, and keep its row; return why it is void, empty if it is not."""
    void = play(order)
    if not void:
        try:
            read_row(order.path, order.config.fingerprint)
        except TrocarError as error:  # the trial is kept; the report says what is wrong with it
            return str(error)
    return void
