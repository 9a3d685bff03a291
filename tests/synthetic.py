"""Trials that nobody played, for tests of files, summaries and commands."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from trocar.tasks import PegTransfer
from trocar.trials import Computation, Plan, Span, Trial, versions

TRANSFER_S = 5.0
PARTS_S = {"capture": 0.2, "perception": 0.1, "planning": 0.2, "motion": 3.0, "jaw": 0.5, "settling": 0.25}
"""Of each transfer; .75 s are left to nothing in particular."""


def synthetic_trial(plan: Plan, index: int = 0, failures: dict[int, str] | None = None) -> Trial:
    """Return a trial of twelve transfers of 5 s, of which those in ``failures`` ended as named there."""
    failures = failures or {}
    transfers, spans, computations, events = [], [], [], []
    for number, (source, target) in enumerate(PegTransfer().transfers):
        start = number * TRANSFER_S
        failure = failures.get(number, "")
        transfers.append(
            {
                "source": source,
                "target": target,
                "attempted": failure != "NO_BLOCK",
                "succeeded": not failure,
                "failure": failure,
                "start_s": start,
                "end_s": start + TRANSFER_S,
            }
        )
        at = start
        for name, length in PARTS_S.items():
            spans.append(Span("psm1", name, round(at, 6), round(at + length, 6)))
            at += length
        computations += [Computation("perception", 0.03, 0.098), Computation("planning", 0.2, 0.103)]
        events.append({"name": "transfer", "time_s": start + TRANSFER_S, "outcome": failure or "DONE"})
    times = np.arange(0.0, 12 * TRANSFER_S + 1e-9, 0.05)
    rng = np.random.default_rng(index)
    return Trial(
        about={
            **asdict(plan),
            "trials": None,
            "index": index,
            "settings": {},
            "cables": {"psm1": "none", "psm2": "none"},
            "versions": versions(),
        },
        transfers=transfers,
        spans=spans,
        events=events,
        collisions=[{"time_s": 3.0, "arm": "psm1", "what": "arm", "against": "peg 4", "force_n": 2.0}] * (index + 1),
        finished=True,
        duration_s=12 * TRANSFER_S,
        arrays={"times_s": times, "tip_psm1": rng.normal(0.0, 0.02, (len(times), 3)).astype(np.float32)},
        computations=computations,
        wall_s=10.0,
    )
