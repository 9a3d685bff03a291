"""Statistics of features as LeRobot keeps them, by which policies normalise their inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

QUANTILES = {f"q{q:02d}": q / 100 for q in (1, 10, 50, 90, 99)}

Statistics = Mapping[str, Any]
"""``min``, ``max``, ``mean``, ``std``, quantiles: lists of a feature's shape; ``count``: [frames]."""


def statistics(values: NDArray[Any]) -> dict[str, Any]:
    """Return the statistics of a feature's values (n, k)."""
    numbers = values.astype(np.float64)
    found = {"min": numbers.min(0), "max": numbers.max(0), "mean": numbers.mean(0), "std": numbers.std(0)}
    found |= dict(zip(QUANTILES, np.quantile(numbers, list(QUANTILES.values()), axis=0), strict=True))
    return {**{name: value.tolist() for name, value in found.items()}, "count": [len(values)]}


def together(parts: Sequence[Statistics]) -> dict[str, Any]:
    """Return the merged statistics of several parts; quantiles are averaged, as LeRobot does."""
    counts = np.array([part["count"][0] for part in parts], dtype=np.float64)

    def of(name: str) -> NDArray[np.float64]:
        return np.array([part[name] for part in parts], dtype=np.float64)

    def averaged(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.average(values, axis=0, weights=counts)

    mean = averaged(of("mean"))
    found = {"min": of("min").min(0), "max": of("max").max(0), "mean": mean}
    found["std"] = np.sqrt(averaged(of("std") ** 2 + (of("mean") - mean) ** 2))
    found |= {name: averaged(of(name)) for name in QUANTILES}
    return {**{name: value.tolist() for name, value in found.items()}, "count": [int(counts.sum())]}
