"""A cable model that does what it must passes; one that breaks a promise is refused in a sentence."""

from dataclasses import replace

import numpy as np
import pytest

from trocar.calibration.models import MODELS, OffsetModel, PlayModel
from trocar.testing import CheckFailed, check_cable_model


@pytest.mark.parametrize("name", [name for name in MODELS if name != "lstm"])
def test_every_model_that_is_quick_to_fit_passes(name):
    check_cable_model(name)


class Drifts(OffsetModel):
    name = "drifts"

    def step(self, state, q_cmd):
        joints, state = super().step(state, q_cmd)
        return joints + 1e-6, state


class ClaimsToDependOnRate(OffsetModel):
    name, rate_independent = "claims", False


class ReadsInvalidRows(OffsetModel):
    name = "reads"

    @classmethod
    def fit(cls, recording, rng):
        return super().fit(replace(recording, valid=np.ones(len(recording), bool)), rng)


class IsNotFitted(OffsetModel):
    name = "unfitted"

    @classmethod
    def fit(cls, recording, rng):
        return replace(super().fit(recording, rng), offset=np.zeros(6))


class ShiftsNothing(OffsetModel):
    name = "shiftless"

    def shifted(self, offset):
        return self


class LosesItsOffset(OffsetModel):
    name = "loses"

    @classmethod
    def from_arrays(cls, arrays, training):
        return replace(super().from_arrays(arrays, training), offset=np.zeros(6))


class Remembers(PlayModel):
    """Its state is changed by a step."""

    name = "remembers"

    def start(self, q_cmd):
        return {"state": super().start(q_cmd)}

    def step(self, state, q_cmd):
        joints, state["state"] = super().step(state["state"], q_cmd)
        return joints, state


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (Drifts, "say step by step what it says of the whole history, not 1e-06 off"),
        (ClaimsToDependOnRate, "have rate_independent = True"),
        (ReadsInvalidRows, "leave aside in a fit the rows that are marked as invalid"),
        (IsNotFitted, "be fitted to the rows of its recording"),
        (ShiftsNothing, "add to every prediction what it is shifted by"),
        (LosesItsOffset, "come back from its file as it was"),
        (Remembers, "leave a state as it was"),
    ],
)
def test_a_broken_promise_is_named(kind, words):
    with pytest.raises(CheckFailed, match=words):
        check_cable_model(kind)
    assert kind.name not in MODELS
