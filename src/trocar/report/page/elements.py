"""The elements of pages, as HTML; all arguments are text and are escaped."""

from __future__ import annotations

import base64
from collections.abc import Collection, Iterable, Mapping, Sequence
from html import escape
from pathlib import Path

from rich.table import Table

from trocar.report.page.look import STYLE
from trocar.report.picture import Picture

MIME = {".png": "image/png", ".webp": "image/webp"}


def document(title: str, sub: Iterable[str], parts: Iterable[str]) -> str:
    """Return a page.

    Args:
        title: of the page, and its first heading.
        sub: lines under it.
        parts: HTML, in order.
    """
    lines = "".join(f"<p class=sub>{escape(line)}</p>" for line in sub)
    return (
        "<!doctype html><html lang=en><head><meta charset=utf-8><meta name=viewport "
        f"content='width=device-width, initial-scale=1'><title>{escape(title)}</title><style>{STYLE}</style></head>\n"
        f"<body><header><h1>{escape(title)}</h1>{lines}</header>\n<main>" + "\n".join(parts) + "</main></body></html>\n"
    )


def section(name: str, title: str, *parts: str) -> str:
    """Return a section with a heading.

    Args:
        name: anchor for links within the page.
        title: of the heading.
        parts: HTML, in order; without any there is no section.
    """
    inside = "\n".join(part for part in parts if part)
    return f'<section id="{name}"><h2>{escape(title)}</h2>\n{inside}</section>' if inside else ""


def paragraph(text: str, kind: str = "") -> str:
    """Return a paragraph; ``kind`` is its class."""
    return f"<p{f' class={kind}' if kind else ''}>{escape(text)}</p>"


def bullets(lines: Iterable[str]) -> str:
    """Return a list of sentences; empty if there are none."""
    inside = "".join(f"<li>{escape(line)}</li>" for line in lines)
    return f"<ul class=notes>{inside}</ul>" if inside else ""


def table(
    head: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    caption: str = "",
    numbers: Collection[int] = (),
    kinds: Sequence[str] = (),
    compact: bool = False,
) -> str:
    """Return a table; the first cell of each row is its header.

    Args:
        head: of the columns.
        rows: cells.
        caption: below it.
        numbers: columns that are right-aligned.
        kinds: class of each row, ``ours`` or ``dim``; empty: none.
        compact: set in smaller type.
    """

    def line(cells: Sequence[str], kind: str, heads: bool) -> str:
        found = []
        for column, cell in enumerate(cells):
            number = " class=number" if column in numbers else ""
            if heads or column == 0:
                found.append(f"<th scope={'col' if heads else 'row'}{number}>{escape(cell)}</th>")
            else:
                found.append(f"<td{number}>{escape(cell)}</td>")
        return f"<tr{f' class={kind}' if kind else ''}>{''.join(found)}</tr>"

    rows = list(rows)
    kinds = kinds or [""] * len(rows)
    body = "".join(line(row, kind, heads=False) for row, kind in zip(rows, kinds, strict=True))
    below = f"<caption>{escape(caption)}</caption>" if caption else ""
    look = " class=compact" if compact else ""
    top = line(head, "", heads=True)
    return f"<div class=wide><table{look}>{below}<thead>{top}</thead><tbody>{body}</tbody></table></div>"


def of_table(printed: Table) -> str:
    """Return a console table as a table of the page, with its title as a heading."""
    columns = list(printed.columns)
    cells = [[str(cell) for cell in column.cells] for column in columns]
    kinds = [{"bold": "ours", "dim": "dim"}.get(str(row.style), "") for row in printed.rows]
    numbers = {place for place, column in enumerate(columns) if column.justify == "right"}
    made = table(
        [str(column.header) for column in columns],
        list(zip(*cells, strict=True)),
        caption=str(printed.caption or ""),
        numbers=numbers,
        kinds=kinds,
    )
    return f"<h3>{escape(str(printed.title))}</h3>{made}" if printed.title else made


def picture(shown: Picture) -> str:
    """Return a picture, embedded in the page, with its caption."""
    data = base64.b64encode(shown.path.read_bytes()).decode()
    source = f"data:{MIME[shown.path.suffix]};base64,{data}"
    return (
        f'<figure><img src="{source}" alt="{escape(shown.alt)}" title="{escape(shown.path.name)}">'
        f"<figcaption>{escape(shown.caption)}</figcaption></figure>"
    )


def pictures(shown: Iterable[Picture]) -> str:
    """Return several small pictures beside each other; empty if there are none."""
    inside = "".join(picture(one) for one in shown)
    return f"<div class=pictures>{inside}</div>" if inside else ""


def captioned(paths: Iterable[str | Path], captions: Mapping[str, str]) -> list[str]:
    """Return pictures one below the other, with captions by the files' names."""
    files = map(Path, paths)
    return [picture(Picture(file, f"Chart: {captions[file.name]}", captions[file.name])) for file in files]
