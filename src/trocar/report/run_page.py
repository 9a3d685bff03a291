"""A run's page: headline, figures, pictures, and what the simulator assumes."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import fields
from html import escape
from pathlib import Path
from typing import Any

from trocar.counting import counted
from trocar.eval import TASKS, TaskReport, pick_method
from trocar.eval.method import CLIENT
from trocar.eval.task import flag_of
from trocar.eval.trial import Trial
from trocar.files.output import write_text
from trocar.lab.flaws import DEFAULT, HARSH, HARSHER, MILD, RECORDED
from trocar.lab.station_file import built_in_stations, station_digest
from trocar.report.failures import REPLAY, Failed, Moments, failures_list, place_of
from trocar.report.page import Captioned, bullets, document, paragraph, picture, section, table
from trocar.report.summary import MISSED_WARNING
from trocar.report.tables import (
    failures_table,
    figure,
    goals_table,
    parts_table,
    percent,
    run_table,
    table_of,
    trials_table,
    where_of,
)

BESIDE = "<p class=quiet>Beside another run, session by session: <code>trocar open</code> with the folder of both.</p>"


def names_of(about: Mapping[str, Any]) -> str:
    """Return task, variant and method of a run, as far as they are known; ``about``: its summary, or a trial's."""
    return ", ".join(str(about[key]) for key in ("task", "variant", "method") if about.get(key))


def write_page(
    path: str | Path,
    summary: Mapping[str, Any],
    trials: Sequence[Trial],
    report: TaskReport,
    *,
    failed: Sequence[Failed],
    failed_pictures: Sequence[Captioned],
    moments: Moments,
    storyboard: Sequence[Captioned],
    timechart: Captioned | None,
    notes: Sequence[str],
    strange: Sequence[str],
    command: str,
) -> Path:
    """Write the page of a run and return its path; the replay of the first trial, if there is one, is beside it.

    Args:
        path: of the page.
        summary: of the run.
        trials: likewise, without their arrays; pictures are of the first.
        report: of their task.
        failed: all goals that were not reached; pictures of some of them.
        failed_pictures: these pictures.
        moments: where each failure is played, if anywhere.
        storyboard: pictures of the first trial, and others that a task draws.
        timechart: of the first trial; None: its script noted no spans.
        notes: sentences that a reader must know.
        strange: sentences about what is missing or unexpected.
        command: that repeats the run.
    """
    compared = [run_table(summary, report.paper_rows(summary), report.paper_count(summary)), *report.tables(summary)]
    goals = [goals_table(trials, report), *([trials_table(trials)] if len(trials) > 1 else [])]
    failures = failures_table(summary["failures"], summary["attempted"], summary["goal_noun"], report)
    rows = failures_list(trials, failed, moments)
    parts_s = table(parts_table(summary)) if summary["parts_s"] else ""
    title = names_of(summary).replace("-", " ")
    sections = {
        "compared": (
            "Beside the paper" if len(compared[0].rows) > 1 else "In numbers",
            [*map(table, compared), BESIDE],
        ),
        "failures": (
            "Failures",
            _failures(summary["goal_noun"], table(failures), rows, moments, failed, failed_pictures),
        ),
        "goals": (f"{summary['goal_noun'].capitalize()}s", map(table, goals)),
        "replay": ("Replay", _replay(Path(path), place_of(trials[0]))),
        "pictures": ("Pictures", map(picture, storyboard)),
        "time": ("Time", [parts_s, picture(timechart) if timechart else ""]),
        "assumed": ("What was assumed", _assumed(summary, notes)),
        "again": ("How to run it again", _reproduced(summary, command)),
    }
    made = {name: (head, made) for name, (head, parts) in sections.items() if (made := section(name, head, *parts))}
    links = "".join(f'<a href="#{name}">{escape(head)}</a>' for name, (head, _) in made.items())
    parts = [
        f"<nav aria-label=Contents>{links}</nav>",
        headline_cards(summary),
        *(paragraph(sentence, "warning") for sentence in [*strange, *_warnings(summary)]),
        *(html for _, html in made.values()),
    ]
    model = f", cable model {summary['model']}" if summary["model"] else ""
    where = (
        f"{counted(summary['trials'], 'trial')} in {counted(summary['sessions'], 'session')} at station "
        f"{summary['station']}, seed {summary['seed']}{model}, planner {summary['planner']}."
    )
    sub = [where, f"{where_of(summary).capitalize()}. Research use only, not a medical device."]
    return write_text(path, document(f"{title[:1].upper()}{title[1:]}", sub, parts), "report")


def headline_cards(summary: Mapping[str, Any]) -> str:
    """Return cards with success and its interval, time, collisions, complete trials."""
    noun, whole, mean_s = summary["goal_noun"], summary["completion_time_s"], summary["mean_time_s"]
    low, high = summary["success_ci95"]
    interval = f"95 % interval {100 * low:.1f} to {percent(high)}, counting {counted(summary['sessions'], 'session')}"
    spread = "" if whole["sd"] is None else f" ± {whole['sd']:.1f} (SD)"
    done = f"{summary['succeeded']} of {summary['attempted']}"
    complete = f"{summary['complete_trials']} of {summary['trials']}"
    cards = (
        (f"{noun}s done", done, f"{percent(summary['success_rate'])}, {interval}"),
        (
            f"mean time of a {noun}",
            "-" if mean_s is None else f"{mean_s:.2f} s",
            f"a whole trial: {whole['mean']:.1f}{spread} s",
        ),
        ("collisions per trial", figure(summary["collisions_per_trial"]), counted(summary["trials"], "trial")),
        ("complete trials", complete, f"in which every {noun} succeeded"),
    )
    inside = "".join(
        f"<div><dt>{escape(what)}</dt><dd class=figure>{escape(value)}</dd><dd class=quiet>{escape(more)}</dd></div>"
        for what, value, more in cards
    )
    return f"<dl class=headline>{inside}</dl>"


def _warnings(summary: Mapping[str, Any]) -> list[str]:
    """Return reasons to doubt the figures."""
    if summary["missed_budgets"] <= MISSED_WARNING:
        return []
    return [
        f"{percent(summary['missed_budgets'])} of computations take longer than the trial's clock counted for them, "
        "even where that time was declared (the machine's speed is taken into account): a real arm would have waited."
    ]


def _failures(
    noun: str,
    counts: str,
    rows: str,
    moments: Moments,
    failed: Sequence[Failed],
    drawn: Sequence[Captioned],
) -> list[str]:
    """Return the failures by name, a row for each that leads to its moment, and pictures of some."""
    if not rows:
        return [paragraph(f"No failure: every {noun} that was attempted succeeded.")]
    played, unplayed = (
        {place for (place, _), (link, _) in moments.items() if bool(link) is there} for there in (True, False)
    )
    more = (
        f"{counted(len(unplayed), 'more trial')} with failures: <code>trocar report DIR --session S --trial K</code> "
        "makes the replay of one, and <code>trocar open DIR</code> plays any."
    )
    left = len(failed) - len(drawn)
    pictures = f"<div class=pictures>{''.join(map(picture, drawn))}</div>" if drawn else ""
    return [
        counts if failed else "",
        rows,
        f"<p class=quiet>{more}</p>" if played and unplayed else "",
        pictures,
        paragraph(f"{counted(left, 'more failure')} without a picture here.", "quiet") if drawn and left else "",
    ]


def _replay(path: Path, shown: str) -> list[str]:
    if not path.with_name(REPLAY).is_file():
        return []
    return [
        f"<figure><iframe class=screen src={REPLAY} loading=lazy title='3D replay of {escape(shown)}'></iframe>"
        f'<figcaption>{escape(shown.capitalize())} in 3D; drag to rotate, scroll to zoom. <a href="{REPLAY}">'
        f"{REPLAY}</a> is next to this page.</figcaption></figure>"
    ]


LEVELS = {
    RECORDED: "The laboratory's errors are as large as in recordings of real instruments, or assumed where none exist.",
    MILD: "The laboratory's errors are smaller than in recordings of real instruments.",
    HARSH: f"The laboratory's errors are {HARSHER:g} times as large as in recordings of real instruments.",
}


def _assumed(summary: Mapping[str, Any], notes: Sequence[str]) -> list[str]:
    """Return how hard the laboratory was, every flaw with its size, and sentences that a reader must know."""
    flaws = {str(what): str(how) for what, how in summary["flaws"].items()}
    difficulty = flaws.pop("difficulty", "")
    level, _, named = difficulty.partition(", ")
    own = " The flaws named here have their own sizes." if named else ""
    told = [(what, how) for what, how in flaws.items() if ": " not in what]
    sized = [(*what.split(": ", 1), how) for what, how in flaws.items() if ": " in what]
    rows = [(name, how, about) for name, about, how in sized]
    return [
        paragraph(f"Difficulty: {difficulty}. {LEVELS.get(level, '')}{own}") if difficulty else "",
        bullets(f"{note[:1].upper()}{note[1:]}." for note in notes),
        table(table_of(("what the laboratory has", "how"), told), compact=True) if told else "",
        table(table_of(("flaw", "size", "what it is"), rows), compact=True) if rows else "",
    ]


def _reproduced(summary: Mapping[str, Any], command: str) -> list[str]:
    """Return the command, what it was run with, and how fast it was."""
    use, factor = summary["command_limit_use"], summary["realtime_factor"]
    compute = "; ".join(
        f"{name} {ms['p50']:.0f} / {ms['p95']:.0f} ms" for name, ms in sorted(summary["compute_ms"].items())
    )
    speed = "-" if summary["machine_speed"] is None else f"{summary['machine_speed']:.2f}"
    limits = f"velocity {percent(use['velocity'])}, acceleration {percent(use['acceleration'])}"
    rows = [
        ("seed", str(summary["seed"])),
        ("versions", ", ".join(f"{name} {number}" for name, number in summary["versions"].items())),
        ("fingerprint of the run", str(summary["fingerprint"])),
        ("computations, median / 95th percentile", compute or "-"),
        ("computations over their budget", percent(summary["missed_budgets"])),
        ("speed of this machine beside the one for which budgets were declared", speed),
        ("speed of the simulation", "-" if factor is None else f"{factor:.1f} x real time"),
        ("largest share of the limits sent", limits),
    ]
    said = "The same command with the same versions makes the same trials, byte for byte; computation times differ."
    if "FILE" in command.split():
        said += " FILE stands for a file that was given."
    code = f"<pre><code>{escape(command)}</code></pre>"
    return [code, paragraph(said), table(table_of(("what", "value"), rows), compact=True)]


FILE = "FILE"
"""Placeholder for a path, because a run stores the content of its files, not their paths."""


def command_of(about: Mapping[str, Any], sessions: int, trials: int) -> str:
    """Return the command that runs the same trials again, with ``FILE`` in place of each file that was given.

    ``about`` is a trial's: what distinguishes its run from others. ``trials`` are per session.
    """
    task = TASKS[about["task"]] if about["task"] in TASKS else None  # noqa: SIM401 (a registry has no get)
    if about["method"] == CLIENT:
        return _serving(task, about)
    words: list[str] = ["trocar", "run", about["task"]]
    words += ["--plugin", FILE] * len(about["plugins"])
    words += _options(task, about["options"])
    words += ["--method", about["method"]]
    if about["model"] and about["model"] != "play":
        words += ["--model", about["model"]]
    if about["calibration"]:
        words += ["--calibration", about["calibration"]]
    if about["prior"] not in (None, "none"):
        words += ["--prior", about["prior"] if about["prior"] == "fleet" else FILE]
    usual = pick_method(task, about["method"]) if task is not None else None
    for name in ("planner", "perception"):
        if about[name] and (usual is None or about[name] != getattr(usual, name)):
            words += [f"--{name}", about[name]]
    for setting in about["set"]:
        words += ["--set", setting]
    if about.get("robot"):
        words += ["--robot", f"{about['robot']}:{FILE}"]
        words += [word for arm in about["cables"] for word in ("--cables", f"{arm}={FILE}")]
        return shlex.join([*words, "--trials", str(trials), "--seed", str(about["seed"]), "--enable-motion"])
    words += _station(task, about)
    level, *named = map(str, about["difficulty"] or [DEFAULT])
    words += ["--difficulty", level] if level != DEFAULT else []
    for flaw in named:
        words += ["--flaw", flaw]
    switches = ("new_session", "refit_offsets", "flawless_camera")
    words += [f"--{name.replace('_', '-')}" for name in switches if about[name]]
    words += ["--sessions", str(sessions), "--trials", str(trials), "--seed", str(about["seed"])]
    return shlex.join(words)


def _serving(task: Any, about: Mapping[str, Any]) -> str:
    """Return the command that serves a trial again; what a client does then is up to the client."""
    named = _station(task, about)
    words = ["trocar", "crtk", "serve", named[1] if named else task.station, "--task", about["task"]]
    words += ["--plugin", FILE] * len(about["plugins"])
    usual = task().options() if task is not None else {}
    for name, value in about["options"].items():
        if value is not None and (name not in usual or usual[name] != value):
            words += ["--option", f"{name}={FILE if isinstance(value, dict | list) else value}"]
    words += ["--seed", str(about["seed"]), "--session", str(about["session"]), "--trial", str(about["index"])]
    return shlex.join(words)


def _options(task: Any, given: Mapping[str, Any]) -> list[str]:
    """Return the task's own options that differ from their defaults; all, if the task is unknown here."""
    usual = task().options() if task is not None else {}
    flags = {f.name: flag_of(f) for f in fields(task)} if task is not None else {}
    words: list[str] = []
    for name, value in given.items():
        if value is None or (name in usual and usual[name] == value):
            continue
        flag = flags.get(name) or f"--{name.replace('_', '-')}"
        if isinstance(value, bool):
            words.append(flag if value else f"--no-{flag[2:]}")
        else:
            words += [flag, FILE if isinstance(value, dict | list) else str(value)]
    return words


def _station(task: Any, about: Mapping[str, Any]) -> list[str]:
    """Return the option of the station, if it is not the task's default."""
    name, digest = about["station"], about["station_digest"]
    built_in = name in built_in_stations() and digest == station_digest(name)
    if built_in and task is not None and name == task.station:
        return []
    return ["--station", name if built_in else FILE]
