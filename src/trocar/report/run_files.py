"""Everything that a run's folder shows beside its trials: summary, pictures, page."""

from __future__ import annotations

import html
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from trocar.errors import TrocarError
from trocar.report.driven_figures import draw_joints, draw_needle
from trocar.report.paths import draw_paths
from trocar.report.storyboard import draw_storyboard
from trocar.report.summary import summarise
from trocar.report.tables import NAMES
from trocar.report.timechart import draw_timechart
from trocar.scene import Pegboard
from trocar.trials.trial import Trial


def load_trials(folder: Path) -> list[Trial]:
    """Return the finished trials of a run's folder, in order."""
    if not folder.is_dir():
        raise TrocarError(f"folder {str(folder)!r} does not exist; make one with `trocar run`")
    paths = sorted(folder.glob("trial_*.npz"))
    if not paths:
        raise TrocarError(f"folder {str(folder)!r} holds no trial_*.npz; make some with `trocar run`")
    return [Trial.load(path) for path in paths]


def write_report(folder: Path, trials: Sequence[Trial]) -> tuple[dict[str, Any], list[Path]]:
    """Write ``summary.json``, the pictures and ``report.html``; return the summary and the files' paths."""
    summary = summarise(trials)
    path = folder / "summary.json"
    draft = path.with_name(f".{path.name}.{os.getpid()}.part")
    draft.write_text(json.dumps(summary, indent=1) + "\n")
    draft.replace(path)
    files = [path, *_pictures(folder, trials)]
    page = folder / "report.html"
    page.write_text(_page(summary, [file for file in files if file.suffix == ".png"]))
    return summary, [*files, page]


def _pictures(folder: Path, trials: Sequence[Trial]) -> list[Path]:
    files = []
    shown = next((trial for trial in trials if trial.captions), None)
    first = trials[0]
    what = f"{first.about['task']} {first.about['variant']}, {first.about['method']}"
    if shown is not None:
        frames = [
            (caption, _decode(shown.arrays[f"picture_{number}"])) for number, caption in enumerate(shown.captions)
        ]
        title = f"{what}, trial {shown.about['index']} of seed {shown.about['seed']} (simulated)"
        files.append(draw_storyboard(frames, folder / "storyboard.png", title, columns=3 if len(frames) <= 9 else 4))
    if first.spans:
        files += DRAW[str(first.about["task"])](folder, first, what)
        spans = [
            {**vars(span), "transfer": int(index)}
            for span, index in zip(
                first.spans,
                _transfer_at(first, np.array([span.start_s for span in first.spans])),
                strict=True,
            )
        ]
        piece = NAMES[str(first.about["task"])]
        files.append(draw_timechart(spans, folder / "timechart.png", title=f"Time chart, {what}", piece=piece))
    return files


def _pegboard_pictures(folder: Path, trial: Trial, what: str) -> list[Path]:
    working, times = trial.spans[0].arm, trial.arrays["times_s"]
    title = f"Path of {working}'s tip over the board, {what}"
    tips, pegs = trial.arrays[f"tip_{working}"], Pegboard().pegs_m
    return [draw_paths(times, tips, _transfer_at(trial, times), pegs, folder / "paths.png", title=title)]


def _suture_pictures(folder: Path, trial: Trial, what: str) -> list[Path]:
    return [
        draw_joints(trial, folder / "joints.png", f"Joints of {trial.spans[0].arm} driven and planned, {what}"),
        draw_needle(trial, folder / "needle.png", f"Path of the needle's tip, {what}"),
    ]


DRAW = {"peg-transfer": _pegboard_pictures, "suture": _suture_pictures}
"""The pictures that are a task's own."""


def _decode(png: np.ndarray) -> np.ndarray:
    image = cv2.imdecode(png, cv2.IMREAD_COLOR)
    if image is None:
        raise TrocarError("a picture in the first trial cannot be decoded; delete that trial and run it again")
    return np.ascontiguousarray(image[..., ::-1])


def _transfer_at(trial: Trial, times_s: np.ndarray) -> np.ndarray:
    """Return the number of the transfer that runs at each time, -1 where none does."""
    index = np.full(len(times_s), -1)
    for number, transfer in enumerate(trial.transfers):
        index[(times_s >= transfer["start_s"] - 1e-9) & (times_s < transfer["end_s"] - 1e-9)] = number  # type: ignore[operator]
    return index


def _page(summary: dict[str, Any], pictures: Sequence[Path]) -> str:
    rows = "".join(
        f"<tr><th>{html.escape(key)}</th><td>{html.escape(json.dumps(value))}</td></tr>"
        for key, value in summary.items()
    )
    images = "".join(f'<p><img src="{picture.name}" alt="{picture.stem}"></p>' for picture in pictures)
    title = f"{summary['task']} {summary['variant']}, {summary['method']}"
    return (
        f"<!doctype html><meta charset=utf-8><title>{html.escape(title)}</title>"
        "<style>body{font:15px sans-serif;max-width:70em;margin:2em auto}img{max-width:100%}"
        "th{text-align:left;vertical-align:top;padding-right:1em;font-weight:600}</style>"
        f"<h1>{html.escape(title)}</h1><p>Simulated. Research use only, not a medical device.</p>"
        f"<table>{rows}</table>{images}\n"
    )
