"""Whole trials: what they reach, what they keep, and what their seed decides."""

from functools import partial

import numpy as np
import pytest
import trio
from numpy.testing import assert_array_equal

from trocar.agents import Settings
from trocar.arms import fk
from trocar.cell import Outcome
from trocar.report import summarise
from trocar.scene import Pegboard
from trocar.sim.referee import SAMPLE_TICKS
from trocar.sim.robot import TICK_S
from trocar.sim.session import T_WORLD_BASE
from trocar.tasks import TASKS, PegTransfer
from trocar.trials import Plan, prepare, run_trial, trial_file
from trocar.trials import run as module

PAPERS_TIME_S = 5.7
"""Mean transfer time of the paper's calibrated robot at the same limits."""


@pytest.fixture(scope="module")
def prepared(tmp_path_factory):
    """A calibrated cell and its plan."""
    plan = Plan(seed=2024)
    return plan, *prepare(plan, tmp_path_factory.mktemp("cell"))


@pytest.fixture
def two_transfers(monkeypatch):
    monkeypatch.setattr("trocar.tasks.peg_transfer.THERE", ((1, 7),))


@pytest.fixture(scope="module")
def trial(prepared):
    """One whole trial of twelve transfers, calibrated."""
    return run_trial(*prepared, 0)


def test_the_blocks_go_there_and_back(trial):
    assert trial.finished
    assert len(trial.transfers) == 12
    assert sum(bool(transfer["succeeded"]) for transfer in trial.transfers) >= 11


def test_it_is_no_slower_than_the_papers_robot(trial):
    summary = summarise([trial])
    assert summary["mean_time_s"] <= PAPERS_TIME_S
    assert sum(summary["parts_s"].values()) == pytest.approx(summary["mean_time_s"])
    assert summary["parts_s"]["other"] >= -1e-9


def test_the_log_holds_every_transfer_and_every_computation(trial):
    events = [event for event in trial.events if event["name"] == "transfer"]
    assert [(e["source"], e["target"]) for e in events] == list(PegTransfer().transfers)
    assert {e["outcome"] for e in events} <= {outcome.name for outcome in Outcome}
    spans = sum(span.name in {"perception", "planning"} for span in trial.spans)
    assert spans == len(trial.computations) >= 36


def test_truth_is_sampled_at_20_hz_to_the_end(trial):
    times = trial.arrays["times_s"]
    assert np.allclose(np.diff(times), SAMPLE_TICKS * TICK_S)
    assert 0 <= trial.duration_s - times[-1] < SAMPLE_TICKS * TICK_S
    assert trial.duration_s == pytest.approx(trial.spans[-1].end_s, abs=TICK_S)
    assert trial.arrays["blocks"].shape == (len(times), 6, 4, 4)
    assert len(trial.arrays["qpos"]) == len(trial.arrays["tip_psm1"]) == len(times)


def test_encoders_show_the_command_and_the_tip_is_elsewhere(trial, prepared):
    """The joints that the encoders claim put the tip millimetres beside where it was."""
    commanded, measured = trial.arrays["commanded_psm1"], trial.arrays["measured_psm1"]
    assert_array_equal(commanded[:, :6], measured[:, :6])
    session = prepared[1]
    times = trial.arrays["times_s"]
    row = np.searchsorted(trial.arrays["executed_s_psm1"], times[times > 5.0])
    row = np.minimum(row, len(measured) - 1)
    shown = T_WORLD_BASE["psm1"] @ fk(session.arms["psm1"], measured[row, :6].astype(float))
    beside_m = np.linalg.norm(shown.translation_m - trial.arrays["tip_psm1"][times > 5.0], axis=1)
    assert 1e-3 < np.median(beside_m) < 20e-3


def test_blocks_were_never_where_no_block_can_be(trial):
    blocks = trial.arrays["blocks"][:, :, :3, 3]
    assert np.isfinite(blocks).all()
    assert blocks[..., 2].min() > -0.02
    speed = np.linalg.norm(np.diff(blocks, axis=0), axis=-1) / (SAMPLE_TICKS * TICK_S)
    assert speed.max() < 1.5
    reach = np.abs(blocks[..., :2]).max()
    assert reach < np.abs(Pegboard().pegs_m).max() + 0.05


def test_without_calibration_transfers_fail_for_reasons_with_names(monkeypatch, tmp_path):
    monkeypatch.setattr("trocar.tasks.peg_transfer.THERE", ((1, 7), (0, 6)))
    plan = Plan(method="uncalibrated", seed=2024)
    trial = run_trial(plan, *prepare(plan, tmp_path), 0)
    failures = [transfer["failure"] for transfer in trial.transfers if not transfer["succeeded"]]
    assert failures
    assert set(failures) <= {outcome.name for outcome in Outcome if outcome is not Outcome.DONE}
    assert trial.about["method"] == "uncalibrated"


def test_the_same_seed_writes_the_same_bytes_and_another_does_not(prepared, two_transfers, tmp_path):
    plan, session, models = prepared
    for name, index in (("first", 3), ("again", 3), ("other", 4)):
        (tmp_path / name).mkdir()
        run_trial(plan, session, models, index).save(trial_file(tmp_path / name, 0))
    first, again, other = (trial_file(tmp_path / name, 0).read_bytes() for name in ("first", "again", "other"))
    assert first == again
    assert first != other


class Looker:
    """An agent that does something of its own, then takes one image."""

    images: list = []  # noqa: RUF012 (filled by the test)

    def __init__(self, cell, settings):
        self.cell, self.settings = cell, settings

    async def run(self, transfers):
        await trio.sleep(self.settings.settle_s)
        np.random.default_rng().random(10)
        Looker.images.append(await self.cell.camera.capture())


def test_another_agent_meets_the_same_scene_cables_and_noise(prepared, monkeypatch):
    plan, session, models = prepared
    Looker.images.clear()
    monkeypatch.setitem(module.AGENTS, ("peg-transfer", "unilateral"), Looker)
    starts = []
    for settle_s in (0.05, 0.45):
        monkeypatch.setitem(module.SETTINGS, ("peg-transfer", "unilateral"), partial(Settings, settle_s=settle_s))
        trial = run_trial(plan, session, models, 5)
        starts.append(trial.arrays["qpos"][0])
    assert_array_equal(*starts)
    first, second = Looker.images
    assert first.time_s != second.time_s
    noise = [np.isnan(image.depth_m) for image in (first, second)]
    assert (noise[0] == noise[1]).mean() > 0.999
    both = ~noise[0] & ~noise[1]
    assert np.median(np.abs(first.depth_m - second.depth_m)[both]) < 1e-6


def test_scenes_depend_on_seed_and_number_alone(prepared, two_transfers, monkeypatch):
    plan, session, models = prepared
    monkeypatch.setitem(module.AGENTS, ("peg-transfer", "unilateral"), Looker)
    uncalibrated = Plan(method="uncalibrated", seed=plan.seed)
    other_seed = Plan(seed=plan.seed + 1)

    def blocks(of, index):
        return run_trial(of, session, models, index).arrays["blocks"][0]

    assert_array_equal(blocks(plan, 1), blocks(uncalibrated, 1))
    assert np.abs(blocks(plan, 1) - blocks(plan, 2)).max() > 1e-3
    assert np.abs(blocks(plan, 1) - blocks(other_seed, 1)).max() > 1e-3


def test_a_spent_budget_is_kept_as_an_unfinished_trial(prepared, monkeypatch):
    monkeypatch.setitem(TASKS, "peg-transfer", lambda variant: PegTransfer(variant, budget_s=2.5))
    trial = run_trial(*prepared, 0)
    assert not trial.finished
    assert trial.transfers == []
    assert trial.duration_s == pytest.approx(2.5, abs=0.06)
    assert summarise([trial])["attempted"] == 0


def test_pictures_of_a_trial_have_captions(prepared, monkeypatch, two_transfers):
    monkeypatch.setitem(module.AGENTS, ("peg-transfer", "unilateral"), Looker)
    trial = run_trial(*prepared, 0, pictures=True)
    assert trial.captions[0] == "start"
    assert bytes(trial.arrays["picture_0"][:8]) == b"\x89PNG\r\n\x1a\n"


def test_the_listener_hears_every_event(prepared, two_transfers):
    heard = []
    trial = run_trial(*prepared, 3, listener=heard.append)
    assert heard == trial.events
    assert sum(event["name"] == "transfer" for event in heard) == 2
