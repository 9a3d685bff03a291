"""Additions to viser's page: a title and a legend that catch no clicks, and a policy that forbids network access."""

from __future__ import annotations

from html import escape

from trocar.replay import Replay
from trocar.view.film import Film
from trocar.view.palette import CONTACT, DRIVEN, PLANNED, Rgb, css

NOTICE = "Simulated. For research, not for use on patients."

POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval' blob: data:; style-src 'unsafe-inline'; "
    "img-src data: blob:; connect-src data: blob:; worker-src blob: data:; font-src data:"
)
"""Security policy: the browser lets the page load only its own content."""

STYLE = """
#trocar { position: fixed; inset: 0 auto auto 0; z-index: 1; margin: 12px; padding: 8px 14px;
  max-width: calc(100vw - 90px); border-radius: 6px; background: rgb(255 255 255 / 82%); pointer-events: none;
  font: 13px/1.5 system-ui, "Segoe UI", Roboto, Helvetica, Arial, sans-serif; color: #22262b; }
#trocar h1 { font-size: 16px; font-weight: 600; margin: 0; }
#trocar ul { list-style: none; margin: 4px 0 0; padding: 0; display: flex; flex-wrap: wrap; gap: 0 16px; }
#trocar i { display: inline-block; vertical-align: middle; margin-right: 6px; }
#trocar i.line { width: 22px; height: 0; border-top: 4px solid; }
#trocar i.ball { width: 11px; height: 11px; border-radius: 50%; }
#trocar p { margin: 2px 0 0; font-size: 12px; color: #59606a; }
.mantine-Notifications-root { margin-top: 84px; }
"""


def with_overlay(page: str, replay: Replay, film: Film) -> str:
    """Return viser's page with the replay's title and legend over it, and without network access."""
    entries = [
        *([_entry("line", PLANNED, "tip, planned"), _entry("line", DRIVEN, "tip, driven")] if replay.tools else []),
        *([_entry("ball", CONTACT, "contact")] if replay.contacts else []),
    ]
    title = escape(replay.title)
    block = (
        f'<div id="trocar"><h1>{title}</h1><ul>{"".join(entries)}</ul>'
        f"<p>{film.rate_hz:g} frames per second. {NOTICE}</p></div>"
    )
    page = page.replace("<title>Viser</title>", f"<title>{title}</title>", 1)
    page = page.replace("<head>", f'<head><meta http-equiv="Content-Security-Policy" content="{POLICY}">', 1)
    page = page.replace("</head>", f"<style>{STYLE}</style></head>", 1)
    return page.replace("</body>", f"{block}</body>", 1)


def _entry(kind: str, colour: Rgb, name: str) -> str:
    where = "border-color" if kind == "line" else "background"
    return f'<li><i class="{kind}" style="{where}: {css(colour)}"></i>{name}</li>'
