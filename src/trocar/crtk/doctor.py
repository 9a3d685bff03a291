"""What is wrong with a robot that speaks CRTK, judged from what was heard of it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from trocar.crtk.camera_checks import CAMERA, CameraHeard
from trocar.crtk.heard_arm import ArmHeard, Finding
from trocar.crtk.listening import Heard
from trocar.crtk.motion_checks import MOTION
from trocar.crtk.wire_checks import WIRE
from trocar.lab.station import Station
from trocar.lab.topics import Topics

ARM = WIRE | MOTION
"""Checks of an arm by name: the expected result in words, and the test."""


class Verdict(Enum):
    """Outcome of a check."""

    PASS = "pass"
    FAIL = "fail"
    NONE = "not applicable"


@dataclass(frozen=True)
class Check:
    """One check of one arm or camera.

    Attributes:
        of: arm or camera.
        name: of the check.
        verdict: outcome.
        found: value, or why the check cannot be made.
        bound: what the value should be.
        remedy: what to do, if the check failed.
    """

    of: str
    name: str
    verdict: Verdict
    found: str
    bound: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.of}, {self.name}: {self.found} (should be: {self.bound}); {self.remedy}"


def examine_arm(heard: Heard, station: Station, topics: Topics, arm: str) -> list[Check]:
    """Return all checks of an arm; a check is not applicable if the failure of another makes it pointless."""
    about, found = ArmHeard(arm, station, topics, heard), []
    for name, (bound, test) in ARM.items():
        found.append(_check(arm, name, bound, test(about)))
        if found[-1].verdict is not Verdict.PASS:
            about.failed.add(name)
    return found


def examine_camera(heard: Heard, station: Station, topics: Topics, camera: str) -> list[Check]:
    """Return all checks of a camera."""
    about = CameraHeard(camera, station, topics, heard)
    return [_check(camera, name, bound, test(about)) for name, (bound, test) in CAMERA.items()]


def _check(of: str, name: str, bound: str, finding: Finding) -> Check:
    verdict = {True: Verdict.PASS, False: Verdict.FAIL, None: Verdict.NONE}[finding.well]
    return Check(of, name, verdict, finding.found, bound, finding.remedy if verdict is Verdict.FAIL else "")
