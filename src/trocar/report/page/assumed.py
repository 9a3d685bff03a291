"""The assumptions behind a run's figures, and how to reproduce them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from trocar.lab.flaws import HARSH, HARSHER, MILD, RECORDED
from trocar.report.page.elements import bullets, paragraph, table
from trocar.report.tables import percent

LEVELS = {
    RECORDED: "The laboratory's errors are as large as in recordings of real instruments, or assumed where none exist.",
    MILD: "The laboratory's errors are smaller than in recordings of real instruments.",
    HARSH: f"The laboratory's errors are {HARSHER:g} times as large as in recordings of real instruments.",
}


def assumed(summary: Mapping[str, Any], notes: Sequence[str]) -> list[str]:
    """Return how hard the laboratory was, every flaw with its size, and the notes, as HTML.

    Args:
        summary: keys as in ``summary.json``.
        notes: sentences that a reader must know.
    """
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
        table(("what the laboratory has", "how"), told, compact=True) if told else "",
        table(("flaw", "size", "what it is"), rows, compact=True) if rows else "",
    ]


def reproduced(summary: Mapping[str, Any], command: str) -> list[str]:
    """Return the command, what it was run with, and how fast it was, as HTML.

    Args:
        summary: keys as in ``summary.json``.
        command: that repeats the run.
    """
    use = summary["command_limit_use"]
    versions = ", ".join(f"{name} {number}" for name, number in summary["versions"].items())
    compute = "; ".join(
        f"{name} {ms['p50']:.0f} / {ms['p95']:.0f} ms" for name, ms in sorted(summary["compute_ms"].items())
    )
    factor = summary["realtime_factor"]
    rows = [
        ("seed", str(summary["seed"])),
        ("versions", versions),
        ("fingerprint of the run", str(summary["fingerprint"])),
        ("computations, median / 95th percentile", compute or "-"),
        ("computations over their budget", percent(summary["missed_budgets"])),
        ("speed of the simulation", "-" if factor is None else f"{factor:.1f} x real time"),
        (
            "largest share of the limits sent",
            f"velocity {percent(use['velocity'])}, acceleration {percent(use['acceleration'])}",
        ),
    ]
    said = "The same command with the same versions makes the same trials, byte for byte; computation times differ."
    if "FILE" in command.split():
        said += " FILE stands for a file that was given."
    return [f"<pre><code>{escape(command)}</code></pre>", paragraph(said), table(("what", "value"), rows, compact=True)]
