"""The page of a run, to be opened in a browser."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from trocar.output import write_text

STYLE = """
:root{color-scheme:light dark}
body{font:16px/1.5 system-ui,sans-serif;max-width:62em;margin:2em auto;padding:0 1em}
h1{font-size:1.5em;margin-bottom:0}p.sub{opacity:.7;margin-top:.2em}
table{border-collapse:collapse;margin:1em 0}td,th{padding:.25em .9em .25em 0;text-align:left;vertical-align:top}
tr+tr td,tr+tr th{border-top:1px solid #8884}img{max-width:100%;background:#fff;border-radius:4px}
iframe{width:100%;height:34em;border:1px solid #8884;border-radius:4px}
@media print{iframe{display:none}}
"""


def write_page(
    path: str | Path, summary: Mapping[str, Any], pictures: Sequence[str | Path], notes: Sequence[str]
) -> Path:
    """Write the page and return its path.

    Args:
        path: of the page; pictures and the replay lie beside it.
        summary: keys as in ``summary.json``.
        pictures: in order.
        notes: sentences that a reader must know.
    """
    path = Path(path)
    title = ", ".join(str(summary[key]) for key in ("task", "variant", "method") if summary[key])
    replay = path.with_name("replay.html").is_file()
    parts = [
        "<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content='width=device-width'>",
        f"<title>{html.escape(title)}</title><style>{STYLE}</style>",
        f"<h1>{html.escape(title)}</h1><p class=sub>Simulated. Research use only, not a medical device.</p>",
        _table(_headline(summary)),
        "<h2>Replay</h2><iframe src=replay.html title=replay></iframe>" if replay else "",
        "".join(f'<p><img src="{p.name}" alt="{p.stem}"></p>' for p in map(Path, pictures)),
        "<h2>Time</h2>" + _table([(name, f"{s:.2f} s") for name, s in summary["parts_s"].items()]),
        "<h2>Assumed and noted</h2><ul>" + "".join(f"<li>{html.escape(note)}</li>" for note in notes) + "</ul>",
        _table([(what, how) for what, how in summary["flaws"].items()]),
        "</html>\n",
    ]
    return write_text(path, "".join(parts), "report")


def _headline(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    low, high = summary["success_ci95"]
    use = summary["command_limit_use"]
    rows = [
        (
            f"{summary['piece']}s",
            f"{summary['succeeded']} of {summary['attempted']} "
            f"(95 % interval {100 * low:.0f} to {100 * high:.0f} %, which counts sessions)",
        ),
        ("sessions, trials", f"{summary['sessions']}, {summary['trials']}"),
        ("mean time", "-" if summary["mean_time_s"] is None else f"{summary['mean_time_s']:.2f} s"),
        ("collisions a trial", f"{summary['collisions_per_trial']:.2f}"),
        ("failures", ", ".join(f"{name} {count}" for name, count in summary["failures"].items()) or "none"),
        ("limits used by what was sent", f"velocity {use['velocity']:.2f}, acceleration {use['acceleration']:.2f}"),
        ("seed, station", f"{summary['seed']}, {summary['station']}"),
    ]
    return rows


def _table(rows: Sequence[tuple[str, str]]) -> str:
    return (
        "<table>"
        + "".join(f"<tr><th>{html.escape(str(k))}</th><td>{html.escape(str(v))}</td></tr>" for k, v in rows)
        + "</table>"
    )


def listed(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table with a head as HTML."""

    def line(cells: Sequence[str], kind: str) -> str:
        return "<tr>" + "".join(f"<{kind}>{html.escape(cell)}</{kind}>" for cell in cells) + "</tr>"

    return "<table>" + line(head, "th") + "".join(line(row, "td") for row in rows) + "</table>"


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
    path = Path(path)
    links = "".join(
        f'<li><a href="{html.escape(name)}">{html.escape(name)}</a>: a folder for <code>trocar report</code> and '
        "<code>trocar view</code></li>"
        for name in folders
    )
    text = [
        "<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content='width=device-width'>",
        f"<title>{html.escape(title)}</title><style>{STYLE}</style>",
        f"<h1>{html.escape(title)}</h1>",
        f"<p class=sub>{html.escape(sub)} Research use only, not a medical device.</p>",
        *parts,
        "<h2>Noted</h2><ul>" + "".join(f"<li>{html.escape(note)}</li>" for note in notes) + "</ul>",
        f"<h2>Runs</h2><ul>{links}</ul></html>\n",
    ]
    return write_text(path, "".join(text), "report")


def pictured(pictures: Sequence[str | Path], captions: Mapping[str, str]) -> list[str]:
    """Return pictures that lie beside the page, with captions by the files' names, as HTML."""
    return [
        f'<p><img src="{picture.name}" alt="{picture.stem}"><br>{html.escape(captions.get(picture.name, ""))}</p>'
        for picture in map(Path, pictures)
    ]
