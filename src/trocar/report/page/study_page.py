"""The page of a study of several runs."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path

from trocar.files.output import write_text
from trocar.report.page.elements import bullets, document, section


def study_page(
    path: str | Path, title: str, sub: str, parts: Sequence[str], notes: Sequence[str], folders: Sequence[str]
) -> Path:
    """Write the page of a study of several runs and return its path.

    Args:
        path: of the page.
        title: of the study.
        sub: a line under it.
        parts: HTML between head and notes.
        notes: sentences that a reader must know.
        folders: of the runs, beside the page.
    """
    links = "".join(
        f'<li><a href="{escape(name)}">{escape(name)}</a>: a folder for <code>trocar report</code> and '
        "<code>trocar view</code></li>"
        for name in folders
    )
    inside = [
        *parts,
        section("notes", "Noted", bullets(notes)),
        section("runs", "Runs", f"<ul>{links}</ul>"),
    ]
    return write_text(path, document(title, [sub, "Research use only, not a medical device."], inside), "report")
