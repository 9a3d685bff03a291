"""Values that somebody careless or hostile gives."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import strategies as st

NUMBERS = (
    *("0", "1", "2", "3", "5", "0.5", "-1", "-0.5", "30", "200", "360"),
    *("1e-9", "1e6", "-1e6", "1e300", "1e308", "-1e308"),
    *("nan", "inf", "-inf", "1e400", "1e-320", str(2**31), str(2**63), str(10**9), str(10**30), "9" * 5000),
    *("1_000", "0x10", " 7", "1,5", "½", "٣"),
)
"""As they are typed."""

WORDS = (
    *("x", "a b", ",", "1,2", ":", "10:40", "=", "nan=nan", "default", "none", "fleet", "all", "-", "--", "%s", "{}"),
    *("long" * 75, "ä", "日本語", "\u202e", "\ud800", "\n", "tab\there", "[bold]x[/bold]", "[/]", "*", "..", "/", "~"),
)

KNOWN = (
    *("play", "offset", "ridge", "spline", "sqp", "optimal", "psm-classic", "raven2-left", "paper"),
    *("peg-transfer", "suture", "raven-pair", "debridement", "calibrated", "uncalibrated", "adaptive", "best", "blind"),
    *("images", "joints", "mild", "harsh", "registration=1.0mm", "registration=nan", "registration=1e308mm", "mm", "m"),
    *("circle", "port", "circle_radius_mm=25:35", "circle_radius_mm=nan:35", "circle_radius_mm=25:1e308", "10:1e308"),
    *("paper-demo", "handover", "bilateral", "psm1", "psm2", "processes", "dask", "q1,q2,q3,q4,q5,q6", "synthetic"),
)
"""Words that mean something somewhere."""

LITERALS: tuple[Any, ...] = (
    *(None, True, False, 0, 1, -1, 0.5, 1e308, -1e308, 10**30, 2**63, float("nan"), float("inf"), -float("inf")),
    *("", "x", "nan", "1", "x" * 300, [], {}, [[]], [1], [None], {"a": 1}, [1e308] * 6, ["a"] * 6, [[0.0] * 4] * 4),
)
"""What a header, a plan or a record may hold in the place of anything."""

ARRAYS: tuple[Any, ...] = (
    *(np.zeros(0), np.zeros(6), np.zeros((3, 3)), np.eye(4), np.zeros((2, 6)), np.zeros((1, 0, 6)), np.zeros(())),
    *(np.full(6, np.nan), np.full(6, 1e308), np.full((4, 4), np.inf), np.array(["a"]), np.array([1, 2], dtype=bool)),
    *(np.zeros((4, 6), dtype=np.complex128), np.zeros(6, dtype=np.int8), np.full((4, 6), 1e300), np.zeros((1,) * 32)),
    *(np.linspace(0.0, 1.0, 6), np.array([0.0, 0.0, 1.0]), np.random.default_rng(0).normal(size=(40, 6))),
)

typed_numbers = st.sampled_from(NUMBERS)
typed_words = st.sampled_from((*WORDS, *KNOWN))
typed = typed_numbers | typed_words
literals = st.sampled_from(LITERALS)
