"""Outcomes of a suture."""

from __future__ import annotations

from trocar.cell import Outcome


class SutureOutcome(Outcome):
    """How a suture ended."""

    DONE = "the needle went in and came out where it should"
    JOINT_LIMIT = "the next step of the primitive leaves the range of a joint, and the arm stopped there"
    NEEDLE_MISSED = "the jaws closed on nothing where the needle should have been"
    NEEDLE_SLIPPED = "the needle moved in the closed jaws"
    OFF_TARGET = "the needle went in or came out too far from where it was planned"
    NOT_PULLED = "the needle came out where it should, but the second arm did not pull it through"
    NEEDLE_DROPPED = "the jaws that held the needle lost it"
    HANDOVER_REFUSED = "the jaws closed on nothing where the other arm held the needle out"
    NOT_DRIVEN = "no needle went in there"
