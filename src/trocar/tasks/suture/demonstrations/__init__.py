"""Recorded sutures, and the manipulability of the arms in them, which is part of the reward (paper, IV-A2)."""

from trocar.tasks.suture.demonstrations.demonstrations import (
    Demonstrations,
    demonstrations_from_joints,
    load_demonstrations,
    synthetic_demonstrations,
)

__all__ = ["Demonstrations", "demonstrations_from_joints", "load_demonstrations", "synthetic_demonstrations"]
