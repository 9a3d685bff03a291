"""Builds the truth that the debridement referee would have recorded: one arm, some fragments, step by step."""

from __future__ import annotations

import numpy as np

from trocar.geometry import SE3, SO3
from trocar.tasks.debridement.goals import Receptacle
from trocar.tasks.debridement.truth import DebridementTruth, Sights

TICK_S = 0.01
TABLE_M = -0.162
LYING_M = TABLE_M + 0.004
RECEPTACLE = SE3.from_parts(SO3.identity(), [-0.0745, 0.012, TABLE_M])
INSIDE = np.array([-0.0745, 0.012, TABLE_M + 0.005])
OVER = np.array([-0.0745, 0.012, TABLE_M + 0.05])
HOME = np.array([-0.06, -0.06, TABLE_M + 0.07])
FIRST, SECOND = np.array([-0.05, -0.07, LYING_M]), np.array([-0.09, -0.08, LYING_M])


class Story:
    """The record of one arm, ``left``, which starts with open jaws; each method appends ticks or events."""

    def __init__(self, *fragments_m, arms=("left",)):
        self.tip, self.jaw_rad = HOME.copy(), 1.2
        self.places = [np.array(place, dtype=float) for place in fragments_m or (FIRST, SECOND)]
        self.held, self.touched = set(), set()
        self.rows, self.events, self.arms, self.hidden = [], [], arms, set()
        self.sights = []
        self.wait(0.1)

    @property
    def now_s(self):
        return (len(self.rows) - 1) * TICK_S

    def _tick(self):
        k = len(self.places)
        self.rows.append(
            (
                self.tip.copy(),
                self.jaw_rad,
                np.array(self.places),
                np.isin(np.arange(k), list(self.held)),
                np.isin(np.arange(k), list(self.held | self.touched)),
            )
        )
        if not self.sights or self.now_s - self.sights[-1][0] > 0.49:
            self.sights.append((self.now_s, [0.0 if n in self.hidden else 1.0 for n in range(k)]))

    def wait(self, seconds):
        for _ in range(round(seconds / TICK_S)):
            self._tick()
        return self

    def move(self, to_m, speed_m_s=0.05):
        start, end = self.tip.copy(), np.array(to_m, dtype=float)
        offsets = {n: self.places[n] - start for n in self.held | self.touched}
        count = max(1, round(np.linalg.norm(end - start) / speed_m_s / TICK_S))
        for share in np.arange(1, count + 1) / count:
            self.tip = start + share * (end - start)
            for n, offset in offsets.items():
                self.places[n] = self.tip + offset
            self._tick()
        return self

    def above(self, place_m, height_m=0.012):
        return self.move([*place_m[:2], TABLE_M + height_m])

    def jaws(self, to_rad, gripping=(), seconds=0.4):
        count = round(seconds / TICK_S)
        start = self.jaw_rad
        if to_rad > start:
            self.held = set()
        for share in np.arange(1, count + 1) / count:
            self.jaw_rad = start + share * (to_rad - start)
            if to_rad < start and share > 0.8:
                self.held = set(gripping)
            self._tick()
        return self

    def lose(self, n, to_m):
        """Let a fragment fall out of the jaws to a place."""
        self.held.discard(n)
        self.places[n] = np.array(to_m, dtype=float)
        return self.wait(0.2)

    def note(self, name, **values):
        self.events.append({"name": name, "time_s": round(self.now_s, 6), **values})
        return self

    def look(self, *places_m):
        places = [list(map(float, place)) for place in places_m]
        return self.note("detected", arm="left", image_s=self.now_s, fragments=places)

    # Sequences of steps.

    def grasp(self, n, gripping=None, allocate=True):
        if allocate:
            self.note("allocated", arm="left", place=list(map(float, self.places[n])))
        self.above(self.places[n]).note("closing", arm="left")
        return self.jaws(0.4, [n] if gripping is None else gripping).wait(0.3)

    def lift(self):
        return self.move(self.tip + [0, 0, 0.05])

    def deliver(self, *fragments, to_m=INSIDE, over_m=OVER):
        self.move(over_m).note("releasing", arm="left")
        for n in fragments:
            self.places[n] = np.array(to_m, dtype=float)
        return self.jaws(1.2).wait(0.8)

    def clear(self, n):
        return self.grasp(n).lift().deliver(n).move(HOME)

    def truth(self):
        tips, jaws, places, held, touched = (np.array(column) for column in zip(*self.rows, strict=True))
        still, nobody = np.tile(HOME, (len(tips), 1)), np.zeros_like(held)
        other = self.arms[1:]
        seen_s, seen = zip(*self.sights, strict=True)
        return DebridementTruth(
            times_s=np.arange(len(tips)) * TICK_S,
            T_world_fragments=SE3.from_parts(SO3.identity(), places),
            held_by={"left": held} | dict.fromkeys(other, nobody),
            touched_by={"left": touched} | dict.fromkeys(other, nobody),
            jaw_rad={"left": jaws} | dict.fromkeys(other, np.full(len(tips), 0.5)),
            T_world_tips={
                name: SE3.from_parts(SO3.identity(), rows)
                for name, rows in [("left", tips), *((name, still) for name in other)]
            },
            T_world_receptacle=RECEPTACLE,
            receptacle=Receptacle(),
            table_z_m=TABLE_M,
            sights=Sights(np.array(seen_s), np.array(seen)),
        )
