"""How values are displayed in a notebook: one line of text, and a small table below it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

SHOWN_ROWS = 40
"""Maximum number of rows shown; the rest of a longer table is only counted."""


def table(caption: object, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table as HTML, for a method ``_repr_html_``; its content is escaped.

    Args:
        caption: above it, usually the value's ``repr``.
        columns: their names, with units.
        rows: one text or number for each column.
    """
    kept = [[escape(str(cell)) for cell in row] for row in rows]
    more = len(kept) - SHOWN_ROWS
    head = "".join(f"<th>{escape(name)}</th>" for name in columns)
    body = "".join(f"<tr><td>{'</td><td>'.join(row)}</td></tr>" for row in kept[:SHOWN_ROWS])
    rest = f'<tr><td colspan="{len(columns)}">and {more} more</td></tr>' if more > 0 else ""
    return f"<div>{escape(str(caption))}<table><thead><tr>{head}</tr></thead><tbody>{body}{rest}</tbody></table></div>"
