"""Colours of overlays on a scene: distinguishable when colour-blind (Okabe and Ito 2008), visible on any table."""

from __future__ import annotations

Rgb = tuple[int, int, int]

PLANNED: Rgb = (40, 120, 255)
DRIVEN: Rgb = (95, 215, 40)
CONTACT: Rgb = (214, 60, 160)
SKY: Rgb = (238, 240, 243)
HORIZON: Rgb = (206, 211, 217)

SPANS: tuple[Rgb, ...] = (
    (86, 180, 233),
    (230, 159, 0),
    (60, 190, 150),
    (240, 228, 66),
    (204, 121, 167),
    (235, 125, 60),
    (110, 150, 220),
    (180, 180, 180),
    (170, 200, 90),
    (150, 130, 200),
)
"""Colours of an arm's activities, in the order in which they first occur; repeated if there are more."""


def mixed(colour: Rgb, other: Rgb, share: float) -> Rgb:
    """Return a colour mixed with a share of another."""
    red, green, blue = (round((1 - share) * a + share * b) for a, b in zip(colour, other, strict=True))
    return red, green, blue


def css(colour: Rgb) -> str:
    """Return a colour in CSS notation."""
    return "#{:02x}{:02x}{:02x}".format(*colour)
