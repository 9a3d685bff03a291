"""The look and the parts of a page for a browser: sections, tables, pictures. Nothing is loaded from a network."""

from __future__ import annotations

import base64
from collections.abc import Iterable
from dataclasses import dataclass
from html import escape
from pathlib import Path

from rich.table import Table

STYLE = """
:root{color-scheme:light dark;--ink:#1c1f23;--quiet:#5c6670;--line:#d8dde2;--paper:#fff;--card:#f4f6f8;--mark:#0b63a5;
--warn:#fff4d6;--ours:#e8f1fa}
@media (prefers-color-scheme:dark){:root{--ink:#e6e9ec;--quiet:#a3adb8;--line:#3a424b;--paper:#15181c;--card:#1f242a;
--mark:#7fbdf0;--warn:#3d3413;--ours:#1c3045}}
*{box-sizing:border-box}
body{font:16px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,sans-serif;color:var(--ink);background:var(--paper);
max-width:64em;margin:0 auto;padding:1.5em 1.2em 4em}
h1{font-size:1.7em;line-height:1.2;margin:.3em 0 0}h2{font-size:1.25em;margin:2.2em 0 .4em;padding-top:.5em;
border-top:1px solid var(--line)}h3{font-size:1.05em;margin:1.4em 0 .3em}
a{color:var(--mark)}p.sub,figcaption,caption,.quiet{color:var(--quiet)}p.sub{margin:.3em 0 0}
nav{margin:.8em 0 0;font-size:.9em}nav a{margin-right:1.1em;white-space:nowrap}
dl.headline{display:grid;grid-template-columns:repeat(auto-fit,minmax(13em,1fr));gap:.8em;margin:1.2em 0}
dl.headline div{background:var(--card);border-radius:8px;padding:.7em 1em}dl.headline dt{color:var(--quiet);
font-size:.9em}dl.headline dd{margin:0}dl.headline dd.figure{font-size:1.5em;font-weight:600;line-height:1.3}
p.warning{background:var(--warn);border-radius:6px;padding:.5em .8em;margin:.5em 0}
.wide{overflow-x:auto;margin:.8em 0}
table{border-collapse:collapse;font-size:.92em;font-variant-numeric:tabular-nums}
caption{caption-side:bottom;text-align:left;font-size:.92em;padding-top:.4em}
td,th{padding:.28em 1.1em .28em .3em;text-align:left;vertical-align:top;font-weight:400;
border-top:1px solid var(--line)}
thead th{font-weight:600;border-top:0;vertical-align:bottom}td.number,th.number{text-align:right}
td.number{white-space:nowrap}
tr.ours td,tr.ours th{font-weight:600;background:var(--ours)}tr.dim td,tr.dim th{color:var(--quiet)}
table.compact{font-size:.85em;line-height:1.35}
figure{margin:1em 0}figcaption{font-size:.9em;margin-top:.3em}
img{max-width:100%;height:auto;background:#fff;border-radius:6px;display:block}
div.pictures{display:grid;grid-template-columns:repeat(auto-fill,minmax(17em,1fr));gap:1em;margin:1em 0}
div.pictures figure{margin:0}div.pictures img{width:100%}
iframe{width:100%;height:36em;border:1px solid var(--line);border-radius:6px;background:#fff}
pre{background:var(--card);border-radius:6px;padding:.8em 1em;overflow-x:auto;white-space:pre-wrap;font-size:.88em}
ul.notes{padding-left:1.2em}ul.notes li{margin:.2em 0}
@media print{
:root{color-scheme:light;--ink:#000;--quiet:#444;--line:#bbb;--paper:#fff;--card:#f2f2f2;--mark:#000;--warn:#f2f2f2;
--ours:#ececec}
@page{margin:16mm 14mm}body{font-size:9.5pt;max-width:none;padding:0}nav,iframe,.screen{display:none}
h2,h3{break-after:avoid}figure,tr,dl.headline div,pre{break-inside:avoid}.wide{overflow:visible}
dl.headline{grid-template-columns:repeat(4,1fr)}dl.headline dd.figure{font-size:1.25em}
td,th{padding-right:.7em}
div.pictures{grid-template-columns:repeat(3,1fr)}img{max-height:17cm;width:auto}a{text-decoration:none}
thead{display:table-header-group}}
"""
MIME = {".png": "image/png", ".webp": "image/webp"}


@dataclass(frozen=True)
class Captioned:
    """A picture for a page.

    Attributes:
        path: of its file.
        alt: what it shows, for those who do not see it.
        caption: below it.
    """

    path: Path
    alt: str
    caption: str


def document(title: str, sub: Iterable[str], parts: Iterable[str]) -> str:
    """Return a page: its title, lines under it, and parts in HTML."""
    lines = "".join(f"<p class=sub>{escape(line)}</p>" for line in sub)
    return (
        "<!doctype html><html lang=en><head><meta charset=utf-8><meta name=viewport "
        f"content='width=device-width, initial-scale=1'><title>{escape(title)}</title><style>{STYLE}</style></head>\n"
        f"<body><header><h1>{escape(title)}</h1>{lines}</header>\n<main>" + "\n".join(parts) + "</main></body></html>\n"
    )


def section(name: str, title: str, *parts: str) -> str:
    """Return a section with a heading and the anchor ``name``; empty if it has no parts."""
    inside = "\n".join(part for part in parts if part)
    return f'<section id="{name}"><h2>{escape(title)}</h2>\n{inside}</section>' if inside else ""


def paragraph(text: str, kind: str = "") -> str:
    """Return a paragraph; ``kind`` is its class."""
    return f"<p{f' class={kind}' if kind else ''}>{escape(text)}</p>"


def bullets(lines: Iterable[str]) -> str:
    """Return a list of sentences; empty if there are none."""
    inside = "".join(f"<li>{escape(line)}</li>" for line in lines)
    return f"<ul class=notes>{inside}</ul>" if inside else ""


def table(printed: Table, compact: bool = False) -> str:
    """Return a console table as HTML, its title as a heading, the first cell of each row as its header.

    Rows in bold are marked as our own, dim ones as quiet; ``compact`` sets it in smaller type.
    """
    columns = list(printed.columns)

    def line(cells: Iterable[str], kind: str, head: bool = False) -> str:
        found = []
        for number, (column, cell) in enumerate(zip(columns, cells, strict=True)):
            tag = f"th scope={'col' if head else 'row'}" if head or number == 0 else "td"
            right = " class=number" if column.justify == "right" else ""
            found.append(f"<{tag}{right}>{escape(cell)}</{tag[:2]}>")
        return f"<tr{f' class={kind}' if kind else ''}>{''.join(found)}</tr>"

    kinds = [{"bold": "ours", "dim": "dim"}.get(str(row.style), "") for row in printed.rows]
    rows = zip(*([str(cell) for cell in column.cells] for column in columns), strict=True)
    body = "".join(line(row, kind) for row, kind in zip(rows, kinds, strict=True))
    title = f"<h3>{escape(str(printed.title))}</h3>" if printed.title else ""
    below = f"<caption>{escape(str(printed.caption))}</caption>" if printed.caption else ""
    top, look = line([str(column.header) for column in columns], "", head=True), " class=compact" if compact else ""
    return f"{title}<div class=wide><table{look}>{below}<thead>{top}</thead><tbody>{body}</tbody></table></div>"


def picture(shown: Captioned) -> str:
    """Return a picture, embedded in the page, with its caption."""
    data = base64.b64encode(shown.path.read_bytes()).decode()
    source = f"data:{MIME[shown.path.suffix]};base64,{data}"
    return (
        f'<figure><img src="{source}" alt="{escape(shown.alt)}" title="{escape(shown.path.name)}">'
        f"<figcaption>{escape(shown.caption)}</figcaption></figure>"
    )
