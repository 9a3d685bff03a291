"""The painted spheres that an instrument wears in the simulated cell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from xml.etree.ElementTree import Element

import numpy as np

from trocar.arms import ArmModel
from trocar.perception.fiducials import COLORS, Fixture
from trocar.sim.elements import add, text

ROD = (0.03, 0.03, 0.03)
"""Colour of the cross that carries the jaw's spheres."""


def printed(fixture: Fixture, rng: np.random.Generator) -> Fixture:
    """Return a fixture as printed: each sphere slightly off its place."""
    off = fixture.print_sd_m * rng.standard_normal((len(fixture.spheres), 3))
    moved = [
        replace(sphere, center_m=tuple((np.array(sphere.center_m) + shift).tolist()))
        for sphere, shift in zip(fixture.spheres, off, strict=True)
    ]
    return replace(fixture, spheres=tuple(moved))


def add_fixture(
    roll: Element, yaw: Element, name: str, arm: ArmModel, fixture: Fixture, bits: Mapping[str, str]
) -> None:
    """Attach a fixture's spheres to the roll link (frame 4) and the yaw link (frame 6) of an arm.

    ``bits`` define what they collide with. MuJoCo's rays miss geoms that nothing collides with if the body's other
    geoms are not near.
    """
    centers = fixture.frame_centers_m(arm)
    for number, (sphere, center) in enumerate(zip(fixture.spheres, centers, strict=True)):
        add(
            roll if fixture.on_shaft[number] else yaw,
            "geom",
            name=f"{name}_sphere{number}",
            type="sphere",
            size=text(sphere.radius_m),
            pos=text(center),
            rgba=text((*COLORS[sphere.color], 1)),
            **bits,
        )
    for number in np.flatnonzero(~fixture.on_shaft):
        add(
            yaw,
            "geom",
            name=f"{name}_rod{number}",
            type="capsule",
            size=text(fixture.arm_radius_m),
            fromto=text((*fixture.hub_m, *centers[number])),
            rgba=text((*ROD, 1)),
            **bits,
        )
