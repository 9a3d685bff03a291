"""A laboratory as it is at this moment, for pages that show it live."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, astuple
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trocar.eval.scenery import Scenery, contact_of
from trocar.eval.staged import Photographer, scenery_of
from trocar.hardware.laboratory import HardwareLaboratory, registered
from trocar.lab import Station
from trocar.log import Sighting
from trocar.perception.image import Image
from trocar.replay import Contact
from trocar.robots import TICK_S
from trocar.sim.laboratory import SimLaboratory
from trocar.sim.record import fixed_poses, solids_of
from trocar.sim.world import World

STRONGEST_S = 0.1
"""Delay after which a contact is reported, with its largest force until then."""


class Seen(NamedTuple):
    """A laboratory at one time. Events, spans and contacts are reported once each.

    Attributes:
        time_s: time on the cell's clock.
        arrays: arrays of one row each, named as those of a trial.
        events: new events of the log.
        spans: new ended spans of the log: arm, name, start_s, end_s.
        begun: spans that have not ended: arm, name, start_s.
        contacts: new contacts; simulator truth.
    """

    time_s: float
    arrays: Mapping[str, NDArray[np.float64]]
    events: tuple[Mapping[str, object], ...]
    spans: tuple[tuple[str, str, float, float], ...]
    begun: tuple[tuple[str, str, float], ...]
    contacts: tuple[Contact, ...] = ()


class Sight(ABC):
    """A live view of a laboratory.

    Attributes:
        scenery: what does not change, without images.
    """

    def __init__(self, laboratory: SimLaboratory | HardwareLaboratory, scenery: Scenery):
        self.scenery = scenery
        self._log, self._cameras = laboratory.log, laboratory.cameras
        self._events, self._spans = 0, 0
        self._shown: dict[str, tuple[Image, Sighting | None]] = {}

    @abstractmethod
    def look(self) -> Seen:
        """Return the laboratory as it is now, with the events and contacts since the last call."""

    def images(self) -> Mapping[str, Sighting]:
        """Return each camera's last image if, since the last call, it is new or something was found in it."""
        found: dict[str, Sighting] = {}
        for name, camera in self._cameras.items():
            sighting = self._log.sightings.get(name)
            images = [
                *(camera.taken[-1:] if isinstance(camera, Photographer) else ()),
                *([sighting.image] if sighting else []),
            ]
            image = max(images, key=lambda image: image.time_s, default=None)
            newest = sighting if sighting is not None and sighting.image is image else None
            if image is not None and self._shown.get(name) != (image, newest):
                self._shown[name] = image, newest
                found[name] = newest or Sighting(image, {})
        return found

    def _told(self) -> tuple[tuple[Any, ...], tuple[Any, ...], tuple[Any, ...]]:
        """Return the events and spans of the log since the last call, and the spans that have begun."""
        events = tuple(self._log.events[self._events :])
        spans = tuple(astuple(span) for span in self._log.spans[self._spans :])
        self._events, self._spans = self._events + len(events), self._spans + len(spans)
        return events, spans, tuple(self._log.begun)


class SimSight(Sight):
    """A live view of a simulated laboratory; simulator truth."""

    def __init__(self, laboratory: SimLaboratory):
        super().__init__(laboratory, scenery_of(laboratory))
        self._laboratory, self._until_s = laboratory, -1.0

    def look(self) -> Seen:
        """Return the laboratory as it is now, with the events and contacts since the last call."""
        laboratory, since_s = self._laboratory, self._until_s
        now_s = laboratory.now_s()
        self._until_s = now_s - STRONGEST_S
        touches = laboratory.contacts.collisions(since_s, self._until_s)
        arrays = {name: row for name, row in laboratory.recorder.arrays(-1).items() if not name.startswith("desired_")}
        return Seen(now_s, arrays, *self._told(), tuple(contact_of(asdict(touch)) for touch in touches))


class RobotSight(Sight):
    """A live view of real arms, according to their encoders."""

    def __init__(self, laboratory: HardwareLaboratory):
        super().__init__(laboratory, robot_scenery(laboratory.station))
        self._laboratory = laboratory

    def look(self) -> Seen:
        """Return the laboratory as it is now, with the events since the last call."""
        arrays = {}
        for arm in self._laboratory.robot.names:
            now = self._laboratory.robot.report(arm)
            arrays[f"commanded_{arm}"] = now.sent[None]
            arrays[f"measured_{arm}"] = np.append(now.reading.q, now.reading.jaw_rad)[None]
        return Seen(self._laboratory.cell.clock.now_s(), arrays, *self._told())


def sight_of(laboratory: SimLaboratory | HardwareLaboratory) -> Sight:
    """Return a live view of a laboratory."""
    return SimSight(laboratory) if isinstance(laboratory, SimLaboratory) else RobotSight(laboratory)


def robot_scenery(station: Station) -> Scenery:
    """Return the scenery of real arms: their solids, and their bases as registered."""
    bases = {name: registered(arm) for name, arm in station.arms.items()}
    world = World(station.models, bases)
    for name, arm in station.arms.items():
        world.place_arm(name, arm.park_q(), arm.model.jaw.lower)  # also computes the poses of all bodies
    return Scenery(
        solids=solids_of(world),
        T_world_body=fixed_poses(world),
        arms=station.models,
        T_world_base={},
        T_world_base_registered=bases,
        cameras={},
        tick_s=TICK_S,
    )
