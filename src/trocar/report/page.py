"""The look and the parts of a page for a browser: sections, tables, pictures. Nothing is loaded from a network."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from itertools import zip_longest
from pathlib import Path

from rich.table import Table

STYLE = """
:root{color-scheme:light dark;--ink:#1c1f23;--quiet:#5c6670;--line:#d8dde2;--paper:#fff;--card:#f4f6f8;--mark:#0b63a5;
--warn:#fff4d6;--ours:#e8f1fa;--bad:#b3400a}
@media (prefers-color-scheme:dark){:root{--ink:#e6e9ec;--quiet:#a3adb8;--line:#3a424b;--paper:#15181c;--card:#1f242a;
--mark:#7fbdf0;--warn:#3d3413;--ours:#1c3045;--bad:#f2a071}}
*{box-sizing:border-box}
body{font:16px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,sans-serif;color:var(--ink);background:var(--paper);
max-width:64em;margin:0 auto;padding:1.5em 1.2em 4em}
h1{font-size:1.7em;line-height:1.2;margin:.3em 0 0;overflow-wrap:anywhere}
h2{font-size:1.25em;margin:2.2em 0 .4em;padding-top:.5em;
border-top:1px solid var(--line)}h3{font-size:1.05em;margin:1.4em 0 .3em}
a{color:var(--mark)}p.sub,figcaption,caption,.quiet{color:var(--quiet)}p.sub{margin:.3em 0 0}
nav{margin:.8em 0 0;font-size:.9em;display:flex;flex-wrap:wrap;gap:.1em 1.1em}nav a,p.sub{overflow-wrap:anywhere}
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
iframe{width:100%;height:36em;border:1px solid var(--line);border-radius:6px;background:var(--card)}
pre{background:var(--card);border-radius:6px;padding:.8em 1em;overflow-x:auto;white-space:pre-wrap;font-size:.88em}
ul.notes{padding-left:1.2em}ul.notes li{margin:.2em 0}
body.broad{max-width:90em}.whole{white-space:nowrap}
table.listing{width:100%}table.listing thead a{color:inherit;text-decoration:none}
table.listing tbody th{max-width:24em}
table.listing thead a:hover{text-decoration:underline}table.listing tbody tr:hover{background:var(--card)}
th[aria-sort=ascending] a::after{content:" \\2191"}th[aria-sort=descending] a::after{content:" \\2193"}
.range{position:relative;display:inline-block;width:5.5em;height:.5em;border-radius:3px;background:var(--line);
vertical-align:middle;margin-right:.7em}
.range i{position:absolute;top:0;bottom:0;border-radius:3px;background:var(--mark);opacity:.45}
.range b{position:absolute;top:-.2em;bottom:-.2em;width:3px;margin-left:-1.5px;border-radius:2px;background:var(--mark)}
.bad{color:var(--bad)}
table.listing tr.note td{border-top:0;padding-top:0;font-size:.94em;color:var(--quiet);overflow-wrap:anywhere}
table.listing tr.note:hover{background:none}
button{font:inherit;color:var(--paper);background:var(--mark);border:0;border-radius:6px;padding:.3em .9em;
cursor:pointer}
input[type=checkbox]{width:1.05em;height:1.05em;accent-color:var(--mark);margin:.25em 0 0}
div.player{position:relative;margin:1em 0}div.player p{position:absolute;inset:0 0 auto;text-align:center;top:40%;
color:var(--quiet);margin:0 1em}
div.player iframe{position:relative;height:min(40em,72vh);background:transparent;display:block}
div.player{background:var(--card);border-radius:6px}
@media(min-width:72em){div.beside{display:grid;grid-template-columns:minmax(0,1fr) 25em;gap:2.2em;align-items:start}
div.beside h2{margin-top:.5em;border-top:0;padding:0}div.beside section+section h2{margin-top:1.6em}}
@media(max-width:46em){
table.listing,table.listing tbody,table.listing tr{display:block}
table.listing thead tr{display:flex;flex-wrap:wrap;gap:.1em 1em;padding-bottom:.6em}
table.listing thead:has(a) tr::before{content:"Sort by";color:var(--quiet)}table.listing thead th{font-weight:400}
table.listing th[aria-sort]{font-weight:600}
table.listing thead th{padding:0}table.listing thead th:not(:has(a)){display:none}
table.listing tbody tr{border-top:1px solid var(--line);padding:.6em 0;position:relative}
table.listing tbody td:has(input){position:absolute;right:0;top:.5em}table.listing tbody th{max-width:none}
table.listing tbody th,table.listing tbody td{display:flex;justify-content:space-between;gap:1.2em;border:0;
padding:.1em 0;text-align:right;white-space:normal}
table.listing tbody td:empty{display:none}table.listing tbody tr.note{border:0;padding:0 0 .6em}
table.listing tbody tr.note td{display:block;text-align:left}
table.listing tbody th{text-align:left;font-weight:600;overflow-wrap:anywhere}
table.listing td[data-label]::before{content:attr(data-label);color:var(--quiet);text-align:left;white-space:nowrap}
table.listing .range{display:none}td:has(input)+th{padding-right:2em}h1{font-size:1.4em}}
@media print{
:root{color-scheme:light;--ink:#000;--quiet:#444;--line:#bbb;--paper:#fff;--card:#f2f2f2;--mark:#000;--warn:#f2f2f2;
--ours:#ececec;--bad:#000}
@page{margin:16mm 14mm}body{font-size:9.5pt;max-width:none;padding:0}nav,iframe,.screen{display:none}
h2,h3{break-after:avoid}figure,tr,dl.headline div,pre{break-inside:avoid}.wide{overflow:visible}
dl.headline{grid-template-columns:repeat(4,1fr)}dl.headline dd.figure{font-size:1.25em}
td,th{padding-right:.7em}
div.pictures{grid-template-columns:repeat(3,1fr)}img{max-height:17cm;width:auto}a{text-decoration:none}
thead{display:table-header-group}}
"""
POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-src 'self'; form-action 'self'; "
    "base-uri 'none'"
)
"""Security policy of each page: the browser runs no script in it and loads only its own pictures and the replay beside
it. Names, reasons and settings come from files that others may have made."""
MIME = {".png": "image/png", ".webp": "image/webp"}


@dataclass(frozen=True)
class Captioned:
    """A picture for a page.

    Attributes:
        path: of its file.
        alt: what it shows, for readers who cannot see it.
        caption: below it.
    """

    path: Path
    alt: str
    caption: str


def document(title: str, sub: Iterable[str], parts: Iterable[str], *, broad: bool = False) -> str:
    """Return a page: its title, lines under it, and parts in HTML; a ``broad`` one has room for a wide table."""
    lines = "".join(f"<p class=sub>{escape(line)}</p>" for line in sub)
    heading = escape(title).replace("/", "/<wbr>")
    return (
        "<!doctype html><html lang=en><head><meta charset=utf-8>"
        f'<meta http-equiv=Content-Security-Policy content="{POLICY}"><meta name=viewport '
        f"content='width=device-width, initial-scale=1'><title>{escape(title)}</title><style>{STYLE}</style></head>\n"
        f"<body{' class=broad' if broad else ''}><header><h1>{heading}</h1>{lines}</header>\n<main>"
        + "\n".join(parts)
        + "</main></body></html>\n"
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

    Bold rows are marked as our own, dim rows are greyed; ``compact`` sets the table in smaller type.
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


@dataclass(frozen=True)
class Column:
    """A column of a :func:`listing`.

    Attributes:
        name: its heading.
        number: whether it holds numbers.
        link: address of the page sorted by this column; empty: none.
        order: ``ascending`` or ``descending`` if rows are sorted by it.
    """

    name: str
    number: bool = False
    link: str = ""
    order: str = ""


def listing(columns: Sequence[Column], rows: Iterable[Sequence[str]], notes: Iterable[str] = ()) -> str:
    """Return a table of HTML cells. A row's header is its first cell, or its second if the first column has no name.

    ``notes`` has an HTML sentence to go below each row; empty: none. On a narrow screen each row becomes a card, whose
    lines begin with the names of the columns.
    """
    head = 0 if columns[0].name else 1
    top = "".join(
        f"<th scope=col{' class=number' if column.number else ''}"
        f"{f' aria-sort={column.order}' if column.order else ''}>"
        f"{link(column.link, column.name) if column.link else escape(column.name)}</th>"
        for column in columns
    )

    def cell(place: int, column: Column, html: str) -> str:
        if place == head:
            return f"<th scope=row>{html}</th>"
        label = f' data-label="{escape(column.name)}"' if column.name else ""
        return f"<td{label}{' class=number' if column.number else ''}>{html}</td>"

    body = "".join(
        f"<tr>{''.join(cell(k, column, html) for k, (column, html) in enumerate(zip(columns, row, strict=True)))}</tr>"
        + (f"<tr class=note>{'<td></td>' * head}<td colspan={len(columns) - head}>{note}</td></tr>" if note else "")
        for row, note in zip_longest(rows, notes, fillvalue="")
    )
    return f"<div class=wide><table class=listing><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>"


def link(address: str, text: str, **more: str) -> str:
    """Return a link; ``more``: other attributes."""
    others = "".join(f' {name}="{escape(value)}"' for name, value in more.items())
    return f'<a href="{escape(address)}"{others}>{escape(text)}</a>'


def range_of(value: float, low: float, high: float) -> str:
    """Return a bar from 0 to 1 on which an interval and a value in it are marked."""
    wide = max(high - low, 0.0)
    return (
        f'<span class=range aria-hidden=true><i style="left:{100 * low:.1f}%;width:{100 * wide:.1f}%"></i>'
        f'<b style="left:{100 * value:.1f}%"></b></span>'
    )


def picture(shown: Captioned) -> str:
    """Return a picture, embedded in the page, with its caption."""
    data = base64.b64encode(shown.path.read_bytes()).decode()
    source = f"data:{MIME[shown.path.suffix]};base64,{data}"
    return (
        f'<figure><img src="{source}" alt="{escape(shown.alt)}" title="{escape(shown.path.name)}">'
        f"<figcaption>{escape(shown.caption)}</figcaption></figure>"
    )
