"""The work of a study: sessions are calibrated, trials are run and reduced, all by any number of workers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from trocar.errors import TrocarError
from trocar.eval.conditions import Cell
from trocar.eval.config import RunConfig
from trocar.eval.folder import open_folder
from trocar.eval.jobs import SessionOrder, TrialOrder, calibrate, play
from trocar.eval.workers import Workers, run_all

Tick = Callable[[str, int, int], None]
"""Called with what is being done now, how many units are done, and how many there are."""

ReadRow = Callable[[Path, str], Any]
"""Returns and stores the row of a trial's file, whose run has this fingerprint; a module-level function."""


def opened(cells: Sequence[Cell]) -> tuple[list[SessionOrder], list[TrialOrder]]:
    """Make or resume the folders of all cells; return the sessions to calibrate and the trials to run, in order.

    Trials come session by session, so that an interrupted study has whole sessions of all cells.
    """
    runs = {cell.folder: (cell.config, cell.folder) for cell in cells}
    todo = [TrialOrder(cell.config, cell.folder, *place) for cell in cells for place in open_folder(*runs[cell.folder])]
    todo.sort(key=lambda order: order.session)
    missing: dict[int, dict[Path, tuple[RunConfig, Path]]] = {}
    for order in todo:
        missing.setdefault(order.session, {})[order.folder] = runs[order.folder]
    return [SessionOrder(tuple(found.values()), session) for session, found in missing.items()], todo


def run_study(cells: Sequence[Cell], read_row: ReadRow, workers: Workers, tick: Tick) -> list[str]:
    """Run the missing trials of a study; return a sentence for each trial that is void.

    Args:
        cells: of the study.
        read_row: makes the rows.
        workers: do the work.
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
    for done, (_, sentence) in enumerate(run_all(partial(play_and_reduce, read_row), todo, workers), start=1):
        tick("running trials", there + done, wanted)
        void += [sentence] if sentence else []
    return void


def play_and_reduce(read_row: ReadRow, order: TrialOrder) -> str:
    """Run a trial, unless it exists, and store its row; return why it is void, empty if it is valid."""
    void = play(order)
    if not void:
        try:
            read_row(order.path, order.config.fingerprint)
        except TrocarError as error:  # the trial is saved; the report says what is wrong with it
            return str(error)
    return void
