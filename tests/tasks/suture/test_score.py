"""How sutures are scored, on made-up truths, whatever the script says."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trocar.geometry import SE3, SO3
from trocar.tasks.suture.outcomes import SutureOutcome
from trocar.tasks.suture.planning import DIRECTIONS
from trocar.tasks.suture.planning.primitive import Suture, needle_poses, steps, tip_poses
from trocar.tasks.suture.score import (
    FLICKER_S,
    MEANT_M,
    ON_TARGET_M,
    SETTLED_S,
    SLIP_M,
    SLIP_RAD,
    NeedleTruth,
    at_surface,
    crossings,
    grips_of,
    loadings_of,
    path_distance_m,
)
from trocar.tasks.suture.task import CircleSutures

TASK = CircleSutures()
SUTURES = TASK.goals()
SETUP = TASK.setup
TICK_S, PER_STEP = 0.01, 100
END_RAD = SETUP.insertion.rotation_rad + SETUP.insertion.pushes * SETUP.insertion.regrasp_rad
LOADED_S, APPROACHED_S = 0.5, 1.5
"""When a person lets go of the first needle, and when it goes in."""
LATE = np.clip(np.linspace(-0.6, 1.0, PER_STEP), 0.0, 1.0)
"""What happens in a step only after its jaws have settled."""
NOTHING = SE3.identity((PER_STEP,))


class Film:
    """What happened, suture by suture at 100 Hz: needle, jaws, whether they press, and whether a person holds it."""

    def __init__(self):
        self.needles, self.tips, self.gripped, self.in_hand = [], [], [], []

    @property
    def now_s(self):
        return TICK_S * sum(map(len, self.needles))

    def show(self, needle, tip, gripped, in_hand=False):
        rows = len(needle.matrix)
        self.needles.append(needle.matrix)
        self.tips.append(tip.matrix)
        self.gripped.append(np.full(rows, gripped))
        self.in_hand.append(np.full(rows, in_hand))
        return self

    def load(self, seconds=LOADED_S):
        """Let a person hold the needle high up between open jaws."""
        aside = SE3.from_parts(translation_m=np.tile([0.0, 0.0, 0.05], (round(seconds / TICK_S), 1)))
        return self.show(aside, aside, gripped=False, in_hand=True)

    def drive(self, suture=SUTURES[0], shift_m=(0.0, 0.0, 0.0), slip=None, until=None, in_hand=False):
        """Drive a needle along a suture, 1 s a step, from an approach to a withdrawal.

        Args:
            suture: which.
            shift_m: of needle and jaws.
            slip: (name of a step, needle's motion (n,) in its own frame in that step), kept from then on.
            until: stop before this step.
            in_hand: whether a person drives it, not the jaws.
        """
        insertion, T_shift = SETUP.insertion, SE3.from_parts(translation_m=shift_m)
        straight, still = insertion.straight_m, np.zeros(2)
        ways = [("approach", np.array([-5e-3, -1e-4]), still, still, True)]
        ways += [(s.name, s.advance_m, s.jaws_rad, s.needle_rad, s.holds) for s in steps(SETUP)]
        ways += [("withdraw", still + straight, still + insertion.rotation_rad, still + END_RAD, False)]
        kept = SE3.identity()
        for name, advance, jaws, turn, holds in ways:
            if name == until:
                break
            advance, jaws, turn = (np.linspace(*values, PER_STEP) for values in (advance, jaws, turn))  # noqa: PLW2901
            moved = kept @ slip[1] if slip and slip[0] == name else kept @ NOTHING
            kept = moved[-1]
            needle = T_shift @ suture.turned(needle_poses(SETUP, advance, turn)) @ moved
            tip = T_shift @ suture.turned(tip_poses(SETUP, advance, jaws))
            self.show(needle, tip, holds and not in_hand, in_hand)
        return self

    def truth(self, by_two_arms=False):
        count = sum(map(len, self.needles))
        return NeedleTruth(
            TICK_S * np.arange(count),
            SE3(np.concatenate(self.needles)),
            SE3(np.concatenate(self.tips)),
            np.concatenate(self.gripped),
            np.concatenate(self.in_hand),
            np.array([0.0, -SETUP.needle.radius_m, 0.0]),
            by_two_arms,
        )

    def score(self, *events):
        return TASK.score(self.truth(), list(events))


def note(outcome, suture=0, start_s=0.0, end_s=9.0, **values):
    return {"name": "suture", "suture": suture, "start_s": start_s, "time_s": end_s, "outcome": outcome, **values}


def slid(distance_m):
    """Return a needle's slide along its axis, once the jaws have settled."""
    return SE3.from_parts(translation_m=LATE[:, None] * [0.0, 0.0, distance_m])


def spun(angle_rad, name):
    """Return a needle's turn about the point between the jaws in a step, once they have settled."""
    step = next(step for step in steps(SETUP) if step.name == name)
    needle, jaws = (
        needle_poses(SETUP, step.advance_m[:1], step.needle_rad[:1]),
        tip_poses(SETUP, step.advance_m[:1], step.jaws_rad[:1]),
    )
    T_needle_tip = SE3(needle.matrix[0, 0]).inverse() @ SE3(jaws.matrix[0, 0])
    return T_needle_tip @ SE3.from_parts(SO3.axis("z", LATE * angle_rad)) @ T_needle_tip.inverse()


def failures(scores):
    return [score.failure for score in scores]


# What counts.


def test_a_suture_as_planned_succeeds_without_errors():
    found, *others = Film().load().drive().score()
    assert found.succeeded and found.failure == "" and found.reason == ""
    assert found.entry_error_m < 2e-5 and found.exit_error_m < 2e-5
    assert found.tip_max_m < 2e-6
    assert found.slip_m < 1e-9 and found.slip_rad < 1e-6
    assert failures(others) == ["NOT_DRIVEN"] * 3
    # from when it goes in until the last push has ended
    assert found.driven_s == (pytest.approx(APPROACHED_S, abs=0.011), pytest.approx(APPROACHED_S + 5.99))
    assert found.driven_s == (found.start_s, found.end_s)


def test_who_does_nothing_has_tried_all_and_done_none():
    for film in (
        Film().load(5.0),
        Film().load().show(NOTHING @ SE3.from_parts(translation_m=[0, 0, 0.05]), NOTHING, False),
    ):
        scores = film.score()
        assert [round(math.radians(s.theta_deg), 6) for s in scores] == [round(s.theta_rad, 6) for s in SUTURES]
        assert [s.direction for s in scores] == [s.direction for s in SUTURES]
        assert all(s.attempted and not s.succeeded for s in scores)
        assert failures(scores) == ["NOT_DRIVEN"] * 4
        for s in scores:
            assert s.entry_error_m is s.exit_error_m is s.tip_rms_m is s.tip_max_m is s.driven_s is None
            assert (s.slip_m, s.slip_rad) == (0.0, 0.0)


@settings(max_examples=40, deadline=None)
@given(st.floats(0.0, 3e-3), st.floats(0.0, 2 * math.pi))
def test_a_shift_on_the_surface_is_measured_and_judged(size, angle):
    (found, *_) = Film().load().drive(shift_m=[size * math.cos(angle), size * math.sin(angle), 0.0]).score()
    assert found.entry_error_m == pytest.approx(size, abs=3e-5)
    assert found.exit_error_m == pytest.approx(size, abs=3e-5)
    assert found.tip_rms_m <= found.tip_max_m <= size + 2e-6
    if abs(size - ON_TARGET_M) > 5e-5:
        assert found.succeeded == (size < ON_TARGET_M)
        assert found.failure == ("" if found.succeeded else SutureOutcome.OFF_TARGET.name)


@pytest.mark.parametrize(
    ("how", "goes_in", "failure"),
    [
        ({"shift_m": [0.0, 0.0, 0.02]}, False, "NOT_DRIVEN"),
        ({"until": "push 1"}, True, "OFF_TARGET"),
        ({"in_hand": True}, False, "NOT_DRIVEN"),
    ],
)
def test_a_needle_that_never_goes_in_or_by_hand_was_not_driven_and_one_that_stays_in_is_off(how, goes_in, failure):
    (found, *_) = Film().load().drive(**how).load().score()
    assert (found.entry_error_m is not None, found.exit_error_m, found.failure) == (goes_in, None, failure)
    assert not goes_in or found.entry_error_m < 2e-5


@pytest.mark.parametrize(("entry", "exit_"), [(1.5, 0.0), (0.0, 1.5)])
def test_the_entry_alone_or_the_exit_alone_can_miss_its_point(entry, exit_):
    """The needle is shifted sideways, and shifted again while the jaws are open."""
    side = needle_poses(SETUP, [0.0], [0.0]).matrix[DIRECTIONS.index(SUTURES[0].direction), 0, :3, 2]
    first_m, again_m = entry * ON_TARGET_M, (exit_ - entry) * ON_TARGET_M
    shift_m = SO3.axis("z", SUTURES[0].theta_rad).apply(first_m * side)
    (found, *_) = Film().load().drive(shift_m=shift_m, slip=("regrasp 1", slid(again_m))).score()
    errors = found.entry_error_m, found.exit_error_m
    assert errors == pytest.approx((entry * ON_TARGET_M, exit_ * ON_TARGET_M), abs=3e-5)
    assert found.failure == SutureOutcome.OFF_TARGET.name and found.slip_m < 1e-9


def test_a_needle_is_driven_until_the_trial_ends_in_the_middle_of_it():
    film = Film().load().drive(until="regrasp 1")
    (found, *_) = film.score()
    assert found.driven_s[1] == pytest.approx(film.now_s - TICK_S)


def test_a_plan_whose_needle_stays_inside_asks_for_no_exit():
    short = replace(SETUP, insertion=replace(SETUP.insertion, rotation_rad=0.5 * SETUP.exit_turn_rad, pushes=0))
    assert Suture(short, 0.0, 1).exit_m is None
    task = CircleSutures(sutures=1)
    object.__setattr__(task, "goals", lambda: (Suture(short, SUTURES[0].theta_rad, SUTURES[0].direction),))
    (found,) = task.score(Film().load().drive(until="regrasp 1").truth(), [])
    assert found.succeeded and found.exit_error_m is None


# Slips.


@pytest.mark.parametrize("step", ["penetrate", "rotate", "push 2"])
@pytest.mark.parametrize(("share", "slips"), [(0.8, False), (1.2, True)])
@pytest.mark.parametrize("how", ["slid", "spun"])
def test_a_needle_that_moves_in_closed_jaws_has_slipped(step, share, slips, how):
    moved = slid(share * SLIP_M) if how == "slid" else spun(share * SLIP_RAD, step)
    (found, *_) = Film().load().drive(slip=(step, moved)).score()
    assert (found.slip_m, found.slip_rad) == (
        (pytest.approx(share * SLIP_M, rel=1e-6), pytest.approx(0.0, abs=1e-6))
        if how == "slid"
        else (pytest.approx(0.0, abs=1e-9), pytest.approx(share * SLIP_RAD, rel=1e-6))
    )
    assert found.entry_error_m < ON_TARGET_M
    slipped_only = found.exit_error_m < ON_TARGET_M
    assert not found.succeeded if slips else found.succeeded == slipped_only
    if slips:
        assert found.failure == SutureOutcome.NEEDLE_SLIPPED.name


@pytest.mark.parametrize(("step", "failure"), [("regrasp 1", "OFF_TARGET"), ("regrasp 2", "")])
def test_a_needle_that_moves_between_open_jaws_has_not_slipped(step, failure):
    """Before the second regrasp it is out already."""
    (found, *_) = Film().load().drive(slip=(step, slid(2e-3))).score()
    assert found.slip_m < 1e-9 and found.failure == failure


def test_jaws_that_close_may_centre_the_needle():
    early = np.clip(np.linspace(0.0, 1.0, PER_STEP) / (0.9 * SETTLED_S), 0.0, 1.0)
    centred = SE3.from_parts(translation_m=early[:, None] * [0.0, 0.0, 1.5 * SLIP_M])
    for step in ("approach", "push 1"):
        (found, *_) = Film().load().drive(slip=(step, centred)).score()
        assert found.slip_m < 1e-9, step
    late = np.clip((TICK_S * np.arange(PER_STEP) - SETTLED_S) / 0.1, 0.0, 1.0)
    slipped = SE3.from_parts(translation_m=late[:, None] * [0.0, 0.0, 1.2 * SLIP_M])
    (found, *_) = Film().load().drive(slip=("push 1", slipped)).score()
    assert found.slip_m == pytest.approx(1.2 * SLIP_M), "what begins when they have settled is slip"


@pytest.mark.parametrize(("seconds", "one"), [(FLICKER_S - 0.02, True), (FLICKER_S + 0.03, False)])
def test_fingers_that_press_less_for_a_moment_have_not_let_go(seconds, one):
    film = Film().load().drive(slip=("rotate", slid(1.2 * SLIP_M)))
    rotate = 3  # after loading, approach and penetrate; the needle moves in the second half
    film.gripped[rotate][60 : 60 + round(seconds / TICK_S)] = False
    truth = film.truth()
    (loading,) = loadings_of(truth, truth.p_circle_needle_tip_m)
    grips = grips_of(truth, loading)
    assert len(grips) == (3 if one else 4)
    spans = [(truth.times_s[first], truth.times_s[last]) for first, last in grips[-2:]]
    assert spans == [pytest.approx(span) for span in ((4.5, 5.49), (6.5, 7.49))], "in each push"
    (found, *_) = film.score()
    assert (found.failure == SutureOutcome.NEEDLE_SLIPPED.name) == one


def test_a_needle_that_nobody_grips_is_driven_by_whatever_means():
    """A hand behind the needle, say: what counts is where it goes in and out."""
    film = Film().load().drive()
    film.gripped = [np.zeros_like(rows) for rows in film.gripped]
    (found, *_) = film.score()
    assert found.succeeded and found.driven_s is None and found.tip_rms_m is None


# Whose suture it is.


def test_each_needle_is_matched_to_the_entry_that_it_was_meant_for_in_any_order():
    film = Film()
    for number in (2, 0, 3):
        film.load().drive(SUTURES[number])
    scores = film.score()
    assert failures(scores) == ["", "NOT_DRIVEN", "", ""]
    assert scores[2].start_s < scores[0].start_s < scores[3].start_s


def test_a_needle_far_from_every_entry_was_meant_for_none():
    for far_m, failure in ((0.95 * MEANT_M, "OFF_TARGET"), (1.05 * MEANT_M, "NOT_DRIVEN")):
        outwards = SUTURES[0].entry_m / np.linalg.norm(SUTURES[0].entry_m)
        (found, *_) = Film().load().drive(shift_m=far_m * outwards).score()
        assert found.failure == failure


@pytest.mark.parametrize("good_last", [True, False])
def test_of_several_needles_for_one_suture_the_last_counts(good_last):
    shifts = [(2e-3, 0.0, 0.0), (0.0, 0.0, 0.0)]
    film = Film()
    for shift_m in shifts if good_last else reversed(shifts):
        film.load().drive(shift_m=shift_m)
    (found, *_) = film.score()
    assert found.succeeded == good_last
    assert found.driven_s[0] > 8.0


def test_a_needle_is_taken_apart_where_a_person_holds_it():
    film = Film().load().drive(SUTURES[1]).load(0.2).drive(SUTURES[2], until="regrasp 1").load(0.3)
    truth = film.truth()
    first, second = loadings_of(truth, truth.p_circle_needle_tip_m)
    assert (first.first, first.last) == (50, 50 + 8 * PER_STEP - 1)
    assert (second.first, second.last) == (first.last + 21, first.last + 20 + 3 * PER_STEP)
    assert second.exit is None and second.first < second.entry < second.last
    assert first.entry < first.exit < first.last
    on_entry = at_surface(truth.p_circle_needle_tip_m, second.entry)
    assert np.abs(on_entry - SUTURES[2].entry_m).max() < 2e-5


# What events are for.


def test_a_failure_is_explained_by_the_scripts_own_word():
    film = Film().load().drive(until="regrasp 1")
    found, *_ = film.score(note("JOINT_LIMIT", reason="suture 1, regrasp 1: joint 'roll' ..."))
    assert (found.failure, found.succeeded) == ("JOINT_LIMIT", False)
    assert "roll" in found.reason and found.exit_error_m is None
    assert (found.start_s, found.end_s) == (0.0, 9.0)
    nothing, *_ = Film().load().score(note("NEEDLE_MISSED"))
    assert nothing.failure == "NEEDLE_MISSED" and nothing.tip_rms_m is None


@pytest.mark.parametrize(
    ("shift_m", "notes", "expected"),
    [
        (None, (("NEEDLE_MISSED", 1), ("JOINT_LIMIT", 1), ("DONE", 2)), ["NOT_DRIVEN", "JOINT_LIMIT"]),
        (0.0, (("NEEDLE_MISSED", 0),), ["", "NOT_DRIVEN"]),
        (2e-3, (("DONE", 0),), ["OFF_TARGET", "NOT_DRIVEN"]),
        (2e-3, (("", 0),), ["OFF_TARGET", "NOT_DRIVEN"]),
    ],
)
def test_the_last_word_explains_a_failure_of_its_own_suture_and_decides_nothing(shift_m, notes, expected):
    film = Film().load() if shift_m is None else Film().load().drive(shift_m=[shift_m, 0.0, 0.0])
    scores = film.score(*(note(*words, reason="said") for words in notes))
    assert failures(scores) == [*expected, "NOT_DRIVEN", "NOT_DRIVEN"]
    assert [score.reason == "said" for score in scores] == [score.failure == "JOINT_LIMIT" for score in scores]


def test_a_script_that_was_stopped_explains_what_it_did_not_come_to():
    stop = {"name": "stopped", "time_s": 5.0, "outcome": "OUT_OF_TIME", "reason": "not done after 5 s"}
    scores = Film().load().drive().score(note("DONE"), note("NEEDLE_MISSED", 1), stop)
    assert failures(scores) == ["", "NEEDLE_MISSED", "OUT_OF_TIME", "OUT_OF_TIME"]
    assert scores[3].reason == "not done after 5 s"
    (believed, *_) = Film().load().drive(shift_m=[2e-3, 0.0, 0.0]).score(note("DONE"), stop)
    assert believed.failure == "OFF_TARGET"


@pytest.mark.parametrize("key", ["suture", "start_s", "outcome"])
def test_a_note_that_says_less_spoils_nothing(key):
    short = {name: value for name, value in note("NEEDLE_MISSED", 1, end_s=5.0).items() if name != key}
    scores = Film().load().drive().score(short)
    assert scores[0].succeeded
    assert all(score.start_s <= score.end_s for score in scores)
    assert scores[1].failure == ("NEEDLE_MISSED" if key == "start_s" else "NOT_DRIVEN")


NOTES = st.lists(
    st.one_of(
        st.builds(
            note,
            outcome=st.sampled_from([outcome.name for outcome in SutureOutcome] + ["", "SUCCEEDED"]),
            suture=st.integers(-1, 4),
            start_s=st.floats(0, 9),
            end_s=st.floats(0, 9),
        ),
        st.builds(lambda name: {"name": "stopped", "time_s": 1.0, "outcome": name}, st.sampled_from(["", "DONE", "X"])),
        st.builds(lambda step: {"name": "step", "suture": 0, "step": step, "time_s": 1.0}, st.text(max_size=3)),
    ),
    max_size=8,
)
DRIVEN = st.lists(
    st.tuples(
        st.integers(0, 3),
        st.sampled_from([0.0, 0.5e-3, 2e-3]),
        st.sampled_from([None, "rotate", "regrasp 1", "withdraw"]),
        st.sampled_from([0.0, 0.3e-3, 0.7e-3]),
        st.booleans(),
    ),
    max_size=3,
)


@settings(max_examples=40, deadline=None)
@given(DRIVEN, NOTES)
def test_nothing_that_a_script_notes_changes_what_was_done(driven, notes):
    film = Film().load()
    for number, shift_m, until, slip_m, in_hand in driven:
        slip = ("penetrate", slid(slip_m))
        film.drive(SUTURES[number], [shift_m, 0.0, 0.0], slip, until, in_hand).load(0.2)
    plain, told = film.score(), film.score(*notes)
    assert len(plain) == len(told) == len(SUTURES)
    for first, second in zip(plain, told, strict=True):
        assert first.attempted and second.attempted
        assert second.succeeded == (second.failure == "")
        for name in ("succeeded", "entry_error_m", "exit_error_m", "tip_rms_m", "tip_max_m", "slip_m", "driven_s"):
            assert getattr(first, name) == getattr(second, name), name


# Paths.


@given(st.floats(-2e-3, 2e-3), st.floats(0.0, 1.0))
def test_the_distance_from_a_path_is_that_from_its_nearest_piece(off, share):
    path = np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.01, 0.01, 0.0]])
    assert path_distance_m(np.array([[0.01 * share, 0.0, off]]), path)[0] == pytest.approx(abs(off))
    assert path_distance_m(np.array([[-3e-3, 4e-3, 0.0]]), path)[0] == pytest.approx(5e-3)


def test_crossings_are_the_first_way_in_and_the_next_way_out():
    x = np.linspace(0.0, 10.0, 1001)
    tips = np.column_stack([x, 0 * x, np.cos(x)])
    entry, exit_ = crossings(tips)
    np.testing.assert_allclose(at_surface(tips, entry), [np.pi / 2, 0.0, 0.0], atol=1e-4)
    np.testing.assert_allclose(at_surface(tips, exit_), [3 * np.pi / 2, 0.0, 0.0], atol=1e-4)
    assert crossings(tips[:100]) == (None, None)
    assert crossings(tips[:300])[1] is None


def test_a_tip_that_trembles_on_the_surface_has_not_gone_in_and_out():
    height = np.concatenate([np.linspace(5e-3, 0.0, 50), 5e-5 * np.sin(np.arange(40)), np.linspace(0, -4e-3, 50)])
    tips = np.column_stack([1e-4 * np.arange(len(height)), 0 * height, height])
    entry, exit_ = crossings(tips)
    assert at_surface(tips, entry)[0] == pytest.approx(1e-4 * 90, abs=6e-4) and exit_ is None
    assert crossings(tips[:90]) == (None, None)


@pytest.mark.parametrize(
    ("heights_mm", "rows"),
    [
        ((1.0, -0.6, 1.0), (0, 1)),
        ((1.0, -0.2, -0.6), (0, None)),
        ((1.0, -0.4, -0.2), (None, None)),
        ((1.0, -0.4, 1.0, -0.6, 1.0, -2.0), (2, 3)),
    ],
)
def test_a_tip_has_gone_in_once_it_was_half_a_millimetre_deep_be_it_in_one_row(heights_mm, rows):
    assert crossings(1e-3 * np.array(heights_mm)[:, None] * [0.0, 0.0, 1.0]) == rows


def test_two_arms_have_done_a_suture_only_when_the_second_holds_the_needle_out_of_the_tissue():
    left = Film().load().drive()
    (score, *_) = TASK.score(left.truth(by_two_arms=True), [])
    assert (score.succeeded, score.failure) == (False, "NOT_PULLED")
    assert TASK.score(left.truth(), [])[0].succeeded
    (score, *_) = TASK.score(left.load().truth(by_two_arms=True), [])
    assert score.succeeded


def test_what_the_script_says_of_a_pull_that_failed_comes_before_what_the_referee_saw():
    said = note("NEEDLE_DROPPED", reason="the second arm lost the needle")
    (score, *_) = TASK.score(Film().load().drive().truth(by_two_arms=True), [said])
    assert (score.failure, score.reason) == ("NEEDLE_DROPPED", "the second arm lost the needle")
