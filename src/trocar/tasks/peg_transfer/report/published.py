"""The paper's figures on people and on its robot (Hwang et al. 2022): Fig. 10 and its caption."""

from __future__ import annotations

COMPLETION_S = {
    "unilateral": {"volunteers": (145.8, 44.7), "surgeon": (56.7, 6.0), "robot": (62.6, 0.7)},
    "bilateral": {"volunteers": (129.7, 56.5), "surgeon": (56.7, 11.2), "robot": (40.4, 0.5)},
    "handover": {"volunteers": (181.8, 61.9), "surgeon": (94.8, 10.0), "robot": (72.5, 1.3)},
}
"""Mean and standard deviation of the completion time of a trial, caption of Fig. 10; the robot calibrated and
optimised."""

COLLISIONS = {"surgeon": 6, "volunteers": 8, "robot": 0}
"""Median collisions per trial on all variants, section V-D.4."""

TABLES = {"unilateral": "Table II", "bilateral": "Table III", "handover": "Table IV"}
