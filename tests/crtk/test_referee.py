"""The referee of a served cell: it scores what is done to the blocks, whoever does it, and keeps the trial."""

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from trocar.crtk.referee import Referee
from trocar.errors import BadFile
from trocar.eval.config import RunConfig
from trocar.eval.folder import load_trials, still_to_do
from trocar.eval.prepare import prepare
from trocar.eval.staged import End, StagedTrial
from trocar.report.run_page import command_of
from trocar.tasks.peg_transfer.task import PegTransfer

IMAGES = ({}, {"overhead": []})


def referee(folder, **place):
    return Referee(PegTransfer(transfers=2), "peg-transfer", 1, **{"session": 0, "trial": 0, **place}, out=folder)


def test_nothing_moved_scores_nothing_of_all_goals_and_the_trial_is_kept(tmp_path):
    found = referee(tmp_path)
    for _ in range(50):
        found.staged.laboratory.tick()
    found.save(End(), IMAGES)
    (trial,), strange = load_trials(tmp_path)
    assert not strange and trial.about["method"] == "client" and trial.about["model"] is None
    assert [(score["attempted"], score["succeeded"]) for score in trial.scores] == [(True, False)] * 2
    assert {score["failure"] for score in trial.scores} == {"NOT_MOVED"}
    words = "trocar crtk serve peg-transfer --task peg-transfer --option transfers=2 --seed 1 --session 0 --trial 0"
    assert command_of(trial.about, 1, 1) == words


def test_a_later_session_alone_lacks_nothing(tmp_path):
    """Each trial is asked for by itself: those before it are not missing."""
    referee(tmp_path, session=3, trial=2).save(End(), IMAGES)
    trials, _ = load_trials(tmp_path)
    assert len(trials) == 1 and still_to_do(tmp_path, len(trials)) == []


def test_a_block_that_anybody_puts_on_its_target_counts_without_a_word_of_the_client(tmp_path):
    found = referee(tmp_path)
    world = found.staged.laboratory.world
    for _ in range(50):
        found.staged.laboratory.tick()
    task = found.staged.laboratory.task
    record = found.staged.laboratory.record()
    truth, goal = task.truth(record), PegTransfer().goals()[0]
    block = int(np.flatnonzero(truth.pegs[-1] == goal.source)[0])
    shift = truth.board.pegs_m[goal.target] - truth.board.pegs_m[goal.source]
    joint = next(
        world.model.joint(j)
        for j in range(world.model.njnt)
        if world.model.body(world.model.joint(j).bodyid[0]).name == world.free_bodies[block]
    )
    T_world_board = world.free_pose(world.free_bodies[block]) @ truth.T_board_blocks[-1, block].inverse()
    world.data.qpos[joint.qposadr[0] : joint.qposadr[0] + 3] += T_world_board.rotation.apply(shift)
    for _ in range(100):
        found.staged.laboratory.tick()
    found.save(End(), IMAGES)
    (trial,), _ = load_trials(tmp_path)
    assert [score["succeeded"] for score in trial.scores] == [True, False]


def test_sessions_and_scenes_are_those_of_a_run_of_the_same_seed(tmp_path):
    config = RunConfig(PegTransfer(transfers=2), method="uncalibrated", seed=1, sessions=2, trials=2)
    ours = StagedTrial(config, prepare(config, 1, tmp_path / "run"), 1).laboratory
    served = referee(tmp_path / "served", session=1, trial=1).staged.laboratory
    assert np.array_equal(ours.world.data.qpos, served.world.data.qpos)
    for name, T in ours.session.T_world_base_registered.items():
        assert np.array_equal(T.matrix, served.session.T_world_base_registered[name].matrix)


def test_a_trial_that_is_there_is_not_played_again(tmp_path):
    referee(tmp_path).save(End(), IMAGES)
    with pytest.raises(BadFile, match="is there already"):
        referee(tmp_path)
    referee(tmp_path, trial=1)
