"""When a transfer counts, on made-up truths, whatever the script says."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulated import standing
from trocar.geometry import SE3, SO3
from trocar.tasks.peg_transfer.goals import BACK, THERE, TransferOutcome
from trocar.tasks.peg_transfer.shapes import Block, Pegboard
from trocar.tasks.peg_transfer.task import PegTransfer
from trocar.tasks.peg_transfer.truth import RETREAT_M, PegTruth, pegs_under, score_transfers, stays_of

TASK = PegTransfer()
GOALS = TASK.goals()
(SOURCE, TARGET), (SECOND_SOURCE, SECOND_TARGET) = GOALS[:2]
WRONG = 8
TICK_S = 0.01
FAR_M = np.array([0.085, 0.045, 0.080])
"""Where an arm rests: away from every peg."""
ALOFT_M = 0.03
BLOCKS = range(6)


class Film:
    """What happened, scene by scene at 100 Hz: poses of the blocks, which are held, and where the tip was."""

    def __init__(self, *T_board_blocks):
        self.poses = [T.matrix for T in (T_board_blocks or [standing(peg) for peg in BLOCKS])]
        self.rows, self.held, self.tips = [], [], []

    @property
    def now_s(self):
        return TICK_S * len(self.rows)

    def show(self, seconds, moves=None, held=(), near=None, near_m=0.5 * RETREAT_M):
        """Go on for so long with some blocks moved to new poses; ``near``: of which block the tip is close."""
        for block, T in (moves or {}).items():
            self.poses[block] = T.matrix
        tip = FAR_M if near is None else self.poses[near][:3, 3] + [0.0, 0.0, near_m]
        for _ in range(round(seconds / TICK_S)):
            self.rows.append(np.stack(self.poses))
            self.held.append([block in held for block in range(len(self.poses))])
            self.tips.append(tip)
        return self

    def carry(self, block, source, target, offset_m=(1.5e-3, -1e-3), yaw_rad=2.0):
        """Grasp a block, carry it over the target and lower it there, still held."""
        self.show(0.3, near=block).show(0.2, held=[block], near=block)
        for peg in (source, target):
            self.show(0.3, {block: standing(peg, height_m=ALOFT_M)}, held=[block], near=block)
        return self.show(0.2, {block: standing(target, offset_m, yaw_rad)}, held=[block], near=block)

    def move(self, block, source, target):
        """Carry a block, let go, and leave."""
        return self.carry(block, source, target).show(0.4, near=block).show(0.5)

    def truth(self):
        times = TICK_S * np.arange(len(self.rows))
        held_by, tips = {"psm1": np.array(self.held)}, {"psm1": np.array(self.tips)}
        poses, board, block = SE3(np.array(self.rows)), Pegboard(), Block()
        return PegTruth(times, poses, pegs_under(poses, board, block), held_by, tips, board, block)

    def score(self, *events):
        return TASK.score(self.truth(), list(events))


def note(outcome, source=SOURCE, target=TARGET, start_s=1.0, end_s=4.0, **values):
    return {
        "name": "transfer",
        "time_s": end_s,
        "start_s": start_s,
        "source": source,
        "target": target,
        "outcome": outcome,
        **values,
    }


def done(scores):
    return [(score.source, score.target) for score in scores if score.succeeded]


# What counts.


def test_who_does_nothing_has_tried_twelve_and_done_none():
    scores = Film().show(5.0).score()
    assert [(score.source, score.target) for score in scores] == list(GOALS)
    assert all(score.attempted for score in scores) and done(scores) == []
    assert [score.failure for score in scores] == ["NOT_MOVED"] * 6 + ["NO_BLOCK"] * 6
    assert [score.available for score in scores] == [True] * 6 + [False] * 6
    assert all(score.reason for score in scores)


def test_a_hand_that_says_nothing_is_scored_by_what_it_did():
    film = Film().show(1.0)
    before_s = film.now_s
    scores = film.move(SOURCE, SOURCE, TARGET).score()
    assert done(scores) == [(SOURCE, TARGET)]
    assert scores[0].failure == "" and scores[0].reason == ""
    assert (scores[0].start_s, scores[0].end_s) == (pytest.approx(before_s + 0.49), pytest.approx(before_s + 1.1))


def test_there_and_back_are_twelve_transfers():
    film = Film()
    for source, target in THERE:
        film.move(source, source, target)
    there = film.score()
    assert done(there) == list(THERE)
    assert [s.failure for s in there[6:]] == ["NOT_MOVED"] * 6 and all(s.available for s in there)
    for target, source in BACK:
        film.move(source, target, source)
    scores = film.score()
    assert done(scores) == list(GOALS)
    assert [s.end_s for s in scores] == sorted(s.end_s for s in scores)


def test_scores_come_in_the_order_of_the_goals_whatever_the_order_of_the_deeds():
    film = Film().move(SECOND_SOURCE, SECOND_SOURCE, SECOND_TARGET).move(SOURCE, SOURCE, TARGET)
    scores = film.score()
    assert [(s.source, s.target) for s in scores] == list(GOALS)
    assert done(scores) == [(SOURCE, TARGET), (SECOND_SOURCE, SECOND_TARGET)]
    assert scores[0].start_s > scores[1].end_s


def test_a_goal_that_is_set_twice_must_be_done_twice():
    goals = (GOALS[0], BACK[0], GOALS[0])
    film = Film().move(SOURCE, SOURCE, TARGET).move(SOURCE, TARGET, SOURCE)
    assert [score.succeeded for score in score_transfers(goals, film.truth(), [])] == [True, True, False]
    film.move(SOURCE, SOURCE, TARGET)
    assert [score.succeeded for score in score_transfers(goals, film.truth(), [])] == [True, True, True]


def test_two_blocks_on_their_way_at_once_both_count():
    film, two = Film().show(0.2), (SOURCE, SECOND_SOURCE)
    for height_m, held in ((ALOFT_M, two), (0.0, two), (0.0, ())):
        places = {
            SOURCE: standing(TARGET, height_m=height_m),
            SECOND_SOURCE: standing(SECOND_TARGET, height_m=height_m),
        }
        film.show(0.4, places, held)
    assert done(film.score()) == [(SOURCE, TARGET), (SECOND_SOURCE, SECOND_TARGET)]


@pytest.mark.parametrize(
    ("lie", "goes_to", "failure"),
    [((SOURCE, TARGET), WRONG, "NOT_PLACED"), ((WRONG,), TARGET, "NO_BLOCK")],
    ids=["another block on the target", "a block from elsewhere"],
)
def test_a_block_on_the_target_that_did_not_come_from_the_source_is_no_transfer(lie, goes_to, failure):
    film = Film(*map(standing, lie)).show(1.0)
    for height_m in (ALOFT_M, 0.0):
        film.show(0.5, {0: standing(goes_to, height_m=height_m)})
    (score, *_) = film.score()
    assert (score.succeeded, score.available, score.failure) == (False, SOURCE in lie, failure)


def turned_over(peg):
    return standing(peg) @ SE3.from_parts(SO3.axis("x", np.pi), [0.0, 0.0, Block().height_m])


def tilted(peg):
    return standing(peg) @ SE3.from_parts(SO3.axis("x", np.radians(15.0)))


@pytest.mark.parametrize(
    "after",
    [
        standing(WRONG),
        standing(TARGET, (6e-3, 0.0)),
        standing(TARGET, height_m=9e-3),
        tilted(TARGET),
        turned_over(TARGET),
    ],
    ids=["wrong peg", "beside its peg", "hung on the top", "tilted", "upside down"],
)
@pytest.mark.parametrize(
    ("events", "failure"), [([], "NOT_PLACED"), ([note("DONE")], "NOT_PLACED"), ([note("DROPPED")], "DROPPED")]
)
def test_a_block_that_does_not_stand_upright_round_its_target_is_not_placed(after, events, failure):
    film = Film().show(0.5, near=SOURCE).show(0.5, {SOURCE: standing(TARGET, height_m=ALOFT_M)}, held=[SOURCE])
    score = film.show(1.0, {SOURCE: after}).score(*events)[0]
    assert score.attempted and score.available and not score.succeeded
    assert score.failure == failure


def test_a_block_that_was_put_back_has_not_moved():
    film = Film().show(0.5).show(0.5, {SOURCE: standing(SOURCE, height_m=ALOFT_M)}, held=[SOURCE])
    score = film.show(1.0, {SOURCE: standing(SOURCE)}).score()[0]
    assert (score.succeeded, score.failure) == (False, "NOT_MOVED")


def test_a_block_by_way_of_a_wrong_peg_has_not_gone_to_its_target():
    score = Film().move(SOURCE, SOURCE, WRONG).move(SOURCE, WRONG, TARGET).score()[0]
    assert (score.succeeded, score.failure) == (False, "NOT_PLACED")
    assert score.reason == "the block left its source and never stood on its target"


# When it is judged.


def test_a_block_that_is_still_held_at_the_end_is_not_placed():
    score = Film().carry(SOURCE, SOURCE, TARGET).show(2.0, held=[SOURCE], near=SOURCE).score()[0]
    assert (score.succeeded, score.failure) == (False, "NOT_PLACED")
    assert "did not stay" in score.reason


@pytest.mark.parametrize(("stood_s", "placed"), [(0.25, False), (0.35, True)])
def test_a_block_is_judged_when_it_had_time_to_fall(stood_s, placed):
    """With the jaws away at once; what happens later is another matter."""
    film = Film().carry(SOURCE, SOURCE, TARGET).show(stood_s).show(1.0, {SOURCE: tilted(TARGET)})
    score = film.score()[0]
    assert score.succeeded == placed
    assert score.failure == ("" if placed else "NOT_PLACED")


@pytest.mark.parametrize("near_m", [0.0, 0.9 * RETREAT_M])
def test_a_block_that_the_jaws_take_along_when_they_leave_is_not_placed(near_m):
    film = Film().carry(SOURCE, SOURCE, TARGET).show(2.0, near=SOURCE, near_m=near_m)
    film.show(0.3, {SOURCE: standing(TARGET, height_m=ALOFT_M)}, near=SOURCE, near_m=near_m)
    score = film.show(1.0, {SOURCE: tilted(TARGET)}).score()[0]
    assert (score.succeeded, score.failure) == (False, "NOT_PLACED")


def test_a_block_that_falls_when_the_jaws_have_long_gone_was_placed():
    film = Film().move(SOURCE, SOURCE, TARGET).show(1.0, {SOURCE: tilted(TARGET)}).show(1.0)
    assert film.score()[0].succeeded


def test_the_jaws_of_every_arm_must_have_gone():
    film = Film().carry(SOURCE, SOURCE, TARGET).show(0.6).show(1.0, {SOURCE: tilted(TARGET)})
    truth = film.truth()
    other = np.tile(FAR_M, (len(truth.times_s), 1))
    truth.p_board_tips["psm2"] = other
    assert TASK.score(truth, [])[0].succeeded
    other[:] = standing(TARGET).translation_m
    assert not TASK.score(truth, [])[0].succeeded


@pytest.mark.parametrize("seconds", [0.05, 1.0])
def test_a_block_that_stands_when_the_film_ends_with_the_jaws_still_near_is_placed(seconds):
    film = Film().carry(SOURCE, SOURCE, TARGET).show(seconds, near=SOURCE)
    assert film.score()[0].succeeded


def test_a_second_try_counts():
    """The block falls back round its source, and is carried once more."""
    film = Film().carry(SOURCE, SOURCE, SOURCE).show(0.5).move(SOURCE, SOURCE, TARGET)
    assert film.score()[0].succeeded


def test_fingers_that_lose_touch_for_a_moment_have_not_let_go():
    """The true release comes later: judged when the jaws have gone, the block was taken along."""
    film = Film().carry(SOURCE, SOURCE, TARGET)
    film.show(TICK_S, near=SOURCE).show(0.6, held=[SOURCE], near=SOURCE)
    film.show(0.5, {SOURCE: standing(TARGET, height_m=ALOFT_M)}, held=[SOURCE], near=SOURCE).show(0.5)
    assert not film.score()[0].succeeded


@pytest.mark.parametrize(("seconds", "one"), [(0.21, True), (0.29, False)])
def test_a_block_that_leaves_its_peg_for_a_moment_has_not_left_it(seconds, one):
    film = Film().show(0.5).show(seconds, {SOURCE: standing(SOURCE, height_m=ALOFT_M)})
    film.show(0.5, {SOURCE: standing(SOURCE)})
    stays = stays_of(film.truth(), SOURCE)
    assert len(stays) == (1 if one else 2)
    assert (stays[0].first, stays[-1].last, {stay.peg for stay in stays}) == (0, len(film.rows) - 1, {SOURCE})


def test_a_flicker_on_the_target_takes_nothing_away_and_a_leap_does():
    for seconds, placed in ((0.21, True), (0.29, False)):
        film = Film().carry(SOURCE, SOURCE, TARGET).show(0.1, near=SOURCE)
        film.show(seconds, {SOURCE: standing(TARGET, height_m=ALOFT_M)}, near=SOURCE)
        assert film.show(1.0, {SOURCE: standing(TARGET)}).score()[0].succeeded == placed


def test_a_moment_on_another_peg_is_no_flicker_of_the_first():
    film = Film().show(0.5).show(0.05, {SOURCE: standing(WRONG)}).show(0.5, {SOURCE: standing(SOURCE)})
    assert [stay.peg for stay in stays_of(film.truth(), SOURCE)] == [SOURCE, WRONG, SOURCE]


# What events are for.


def test_a_success_that_the_script_does_not_believe_in_is_one():
    score = Film().move(SOURCE, SOURCE, TARGET).score(note("DROPPED", reason="lost"))[0]
    assert (score.succeeded, score.failure, score.reason) == (True, "", "")
    assert (score.start_s, score.end_s) == (1.0, 4.0)


def test_a_failure_is_explained_by_the_scripts_own_word():
    (score, *_) = Film().show(5.0).score(note("NOT_GRASPED", reason="the jaws closed on nothing"))
    assert (score.failure, score.reason) == ("NOT_GRASPED", "the jaws closed on nothing")
    assert (score.start_s, score.end_s) == (1.0, 4.0)


def test_a_word_is_for_its_own_transfer_alone():
    scores = Film().show(5.0).score(note("NOT_GRASPED", SECOND_SOURCE, SECOND_TARGET))
    assert [score.failure for score in scores[:3]] == ["NOT_MOVED", "NOT_GRASPED", "NOT_MOVED"]


def test_of_several_words_the_last_stands():
    scores = Film().show(9.0).score(note("DROPPED"), note("OUT_OF_REACH", start_s=5.0, end_s=8.0))
    assert (scores[0].failure, scores[0].start_s, scores[0].end_s) == ("OUT_OF_REACH", 5.0, 8.0)


def test_a_script_that_was_stopped_explains_what_it_did_not_come_to():
    stop = {"name": "stopped", "time_s": 5.0, "outcome": "OUT_OF_TIME", "reason": "not done after 5 s"}
    film = Film().move(SOURCE, SOURCE, TARGET).show(2.0)
    scores = film.score(note("DONE"), note("DROPPED", SECOND_SOURCE, SECOND_TARGET), stop)
    assert scores[0].succeeded
    assert scores[1].failure == "DROPPED"
    assert {(score.failure, score.reason) for score in scores[2:]} == {("OUT_OF_TIME", "not done after 5 s")}
    assert all(score.attempted for score in scores)


def test_what_a_stopped_script_had_come_to_is_told_as_it_was():
    stop = {"name": "stopped", "time_s": 5.0, "outcome": "OUT_OF_TIME", "reason": "not done after 5 s"}
    (score, *_) = Film().show(5.0).score(note("DONE"), stop)
    assert score.failure == "NOT_MOVED"


@pytest.mark.parametrize(
    "keys", [("source",), ("target",), ("start_s",), ("outcome",), ("source", "start_s", "outcome")]
)
def test_a_note_that_says_less_spoils_nothing(keys):
    """An agent from elsewhere may call its events as it likes."""
    short = {key: value for key, value in note("DROPPED").items() if key not in keys}
    scores = Film().move(SECOND_SOURCE, SECOND_SOURCE, SECOND_TARGET).score(short)
    assert done(scores) == [(SECOND_SOURCE, SECOND_TARGET)]
    assert scores[0].failure == ("DROPPED" if not {"source", "target", "outcome"} & set(keys) else "NOT_MOVED")


# Properties.

PEGS = st.integers(0, 11)
NOTES = st.lists(
    st.one_of(
        st.builds(
            note,
            outcome=st.sampled_from([outcome.name for outcome in TransferOutcome] + ["", "SUCCEEDED"]),
            source=PEGS,
            target=PEGS,
            start_s=st.floats(0, 9),
            end_s=st.floats(0, 9),
        ),
        st.builds(
            lambda outcome: {"name": "stopped", "time_s": 1.0, "outcome": outcome}, st.sampled_from(["", "DONE"])
        ),
    ),
    max_size=12,
)
STEPS = st.lists(
    st.tuples(st.integers(0, 1), PEGS, st.sampled_from(["clean", "aloft", "beside", "held"])), min_size=1, max_size=6
)


def filmed(steps):
    """Return a film in which two blocks are moved by a hand that does all kinds of things."""
    at = [SOURCE, SECOND_SOURCE]
    film = Film(*map(standing, at)).show(0.3)
    for block, peg, how in steps:
        if how == "clean":
            film.move(block, at[block], peg)
        elif how == "aloft":
            film.show(0.3, {block: standing(peg, height_m=ALOFT_M)}, held=[block], near=block)
        elif how == "beside":
            film.show(0.3, {block: standing(peg, (6e-3, 0.0))}, near=block)
        else:
            film.show(0.4, {block: standing(peg)}, held=[block], near=block)
        at[block] = peg
    return film


@settings(max_examples=60, deadline=None)
@given(STEPS, NOTES)
def test_nothing_that_a_script_notes_changes_what_was_done(steps, notes):
    film = filmed(steps)
    plain, told = film.score(), film.score(*notes)
    assert len(plain) == len(told) == len(GOALS)
    for first, second in zip(plain, told, strict=True):
        assert first.attempted and second.attempted
        assert (first.succeeded, first.available) == (second.succeeded, second.available)
        assert second.succeeded == (second.failure == "")


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 5), PEGS), max_size=10))
def test_clean_moves_are_counted_as_one_would_by_hand(moves):
    film, at, way = Film().show(0.1), dict.fromkeys(BLOCKS), set()
    at = {block: block for block in BLOCKS}
    for block, peg in moves:
        if peg == at[block]:
            continue
        film.move(block, at[block], peg)
        way.add((at[block], peg))
        at[block] = peg
    assert done(film.score()) == [goal for goal in GOALS if tuple(goal) in way]


# Handovers.


def handed(film, *arms):
    """Return the truth of a film in which the first block was in these arms' jaws, one after the other."""
    truth = film.truth()
    rows = np.flatnonzero(truth.held[:, SOURCE])
    held_by = {name: np.zeros_like(truth.held) for name in ("psm1", "psm2")}
    for name, part in zip(arms, np.array_split(rows, len(arms)), strict=True):
        held_by[name][part, SOURCE] = True
    return replace(truth, held_by=held_by)


def test_a_block_must_have_been_in_the_jaws_of_both_arms_where_it_is_to_be_handed_over():
    film = Film().show(1.0).move(SOURCE, SOURCE, TARGET)
    alone, both = handed(film, "psm1"), handed(film, "psm2", "psm1")
    says_done = [note("DONE")]
    (refused, *_), (done_so, *_) = (score_transfers(GOALS, truth, says_done, handover=True) for truth in (alone, both))
    assert (refused.succeeded, refused.failure) == (False, TransferOutcome.NOT_HANDED_OVER.name)
    assert "one arm alone" in refused.reason
    assert done_so.succeeded
    assert score_transfers(GOALS, alone, says_done)[0].succeeded, "elsewhere one arm will do"


def test_to_be_touched_by_the_other_arm_on_the_way_is_no_handover():
    truth = handed(Film().show(1.0).move(SOURCE, SOURCE, TARGET), "psm1")
    rows = np.flatnonzero(truth.held[:, SOURCE])
    truth.held_by["psm2"][rows[len(rows) // 2], SOURCE] = True
    assert score_transfers(GOALS, truth, [], handover=True)[0].failure == TransferOutcome.NOT_HANDED_OVER.name
    truth.held_by["psm1"][rows[len(rows) // 2 :], SOURCE] = False
    truth.held_by["psm2"][rows[len(rows) // 2 :], SOURCE] = True
    assert score_transfers(GOALS, truth, [], handover=True)[0].succeeded


def test_to_be_touched_by_the_other_arm_before_or_after_is_no_handover():
    film = Film().show(1.0).move(SOURCE, SOURCE, TARGET)
    truth = handed(film, "psm1")
    truth.held_by["psm2"][:50, SOURCE] = True
    truth.held_by["psm2"][-50:, SOURCE] = True
    assert score_transfers(GOALS, truth, [], handover=True)[0].failure == TransferOutcome.NOT_HANDED_OVER.name
