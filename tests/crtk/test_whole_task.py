"""A block goes from peg to peg over the network: the agent in one process, the cell and its referee in another."""

import signal

import pytest

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from crtk_partners import patient, trocar
from trocar.eval.trial import Trial

pytestmark = pytest.mark.realtime
TRIAL = "session_00/trial_000.npz"


def said(process, limit_s=120.0):
    text, _ = process.communicate(timeout=limit_s)
    assert process.returncode == 0, text
    return text


@pytest.fixture
def served(tmp_path):
    """Return a served cell whose station is written, and that hears; it is ended whatever happens."""
    words = ("--task", "peg-transfer", "--option", "transfers=1", "--seed", 1, "--out", tmp_path / "served")
    process = trocar("crtk", "serve", "peg-transfer", *words)
    for line in process.stdout:
        if "a client's station" in line:
            break
    patient(tmp_path / "served" / "station.toml")
    yield process
    process.kill()
    process.wait()


def test_an_agent_in_another_process_moves_a_block_and_the_referee_sees_it(served, tmp_path):
    once = ("peg-transfer", "--transfers", 1, "--seed", 1)
    said(trocar("run", *once, "--calibration", "joints", "--out", tmp_path / "embedded"))
    cables = f"psm1={tmp_path / 'embedded/session_00/cables_psm1.npz'}"
    robot = ("--robot", f"crtk:{tmp_path / 'served/station.toml'}", "--cables", cables)
    text = said(trocar("run", *once, *robot, "--enable-motion", "--yes", "--out", tmp_path / "robot"))
    assert "1 of 1 transfer" in text and "the script says so, nobody counted" in text
    served.send_signal(signal.SIGTERM)
    assert "1 of 1 transfer" in said(served)
    truth, told, embedded = (Trial.load(tmp_path / name / TRIAL) for name in ("served", "robot", "embedded"))
    assert [score["succeeded"] for score in truth.scores] == [score["succeeded"] for score in told.scores] == [True]
    assert told.on_robot and not truth.on_robot
    assert not any(name.startswith(("true_", "body_")) for name in told.arrays), "nobody knows the truth on a robot"
    for trial in (truth, told):
        assert max(map(max, trial.command_limit_use.values())) <= 1.001
    assert told.duration_s < 2 * embedded.duration_s
