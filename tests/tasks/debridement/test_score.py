"""Each of the nine failure modes from the truth, and scripts that lie."""

from dataclasses import asdict, fields, replace

import numpy as np
import pytest

from debridement_story import FIRST, HOME, INSIDE, LYING_M, OVER, SECOND, TABLE_M, Story
from trocar.tasks.debridement.goals import FragmentOutcome, Workspace
from trocar.tasks.debridement.score import SEEN_SHARE, SIGHT_S, FragmentScore, score_fragments
from trocar.tasks.debridement.truth import Sights
from trocar.tasks.debridement.world import POINTS

MODES = [f.name for f in fields(FragmentScore)][-9:]
BESIDE = np.array([-0.0745, 0.075, LYING_M])
OUTSIDE_OVER = np.array([-0.0745, 0.060, TABLE_M + 0.05])


def scores_of(story):
    scores = score_fragments(story.truth(), story.events)
    assert len({score.fragment for score in scores}) == len(scores)
    for score in scores:
        assert score.attempted and 0 <= score.start_s <= score.end_s <= story.now_s + 1e-9
        assert (score.failure == "") == score.succeeded
        assert type(score.succeeded) is bool and type(score.first_attempt) is bool
    return {score.fragment: score for score in scores}


def modes_of(story):
    """Return all failures of a story that are not zero."""
    scores = scores_of(story).values()
    totals = {mode: sum(getattr(score, mode) for score in scores) for mode in MODES}
    return {mode: count for mode, count in totals.items() if count}


def test_a_fragment_that_is_cleared_at_once():
    story = Story().look(FIRST, SECOND).clear(0).look(SECOND)
    scores = scores_of(story)
    assert scores[0].succeeded and scores[0].first_attempt and scores[0].attempts == 1
    assert not scores[1].succeeded and scores[1].failure == "NOT_CLEARED" and scores[1].attempts == 0
    assert scores[1].start_s == scores[1].end_s == pytest.approx(story.now_s), "nobody ever approached it"
    assert modes_of(story) == {}
    assert 0 < scores[0].start_s < scores[0].end_s < story.now_s


def test_what_is_cleared_first_stands_first():
    story = Story().clear(1)
    assert [score.fragment for score in score_fragments(story.truth(), [])] == [1, 0]
    story.clear(0)
    assert [score.fragment for score in score_fragments(story.truth(), [])] == [1, 0]


def test_without_any_event_truth_says_the_same():
    told, untold = Story().clear(0), Story().clear(0)
    untold.events = []
    silent, noisy = scores_of(untold)[0], scores_of(told)[0]
    skip = ("start_s",)
    assert {k: v for k, v in asdict(silent).items() if k not in skip} == {
        k: v for k, v in asdict(noisy).items() if k not in skip
    }


# The nine modes (Kehoe 2014, III-B).


def test_1_a_fragment_that_lies_there_and_is_overlooked():
    story = Story().look(FIRST).clear(0).look().note("stopped", outcome="DONE")
    assert modes_of(story) == {"fragment_false_negatives": 1}, "two looks in a row that miss it count once"
    assert scores_of(story)[1].fragment_false_negatives == 1
    assert scores_of(story)[1].failure == "NOT_FOUND"
    again = Story().look(FIRST).clear(0).look(SECOND).wait(0.1).look().note("stopped", outcome="DONE")
    assert modes_of(again) == {"fragment_false_negatives": 2}


def test_1_a_look_that_nobody_acts_on_overlooks_nothing():
    assert modes_of(Story().look(FIRST).wait(0.1).look(FIRST, SECOND).clear(0)) == {}


@pytest.mark.parametrize("why", ["hidden", "held", "touched", "in the receptacle", "far away"])
def test_1_what_cannot_be_seen_is_not_overlooked(why):
    story = Story()
    if why == "hidden":
        story.hidden = {1}
        story.wait(0.6)
    elif why == "held":
        story.grasp(1)
    elif why == "touched":
        story.touched = {1}
        story.wait(0.1)
    elif why == "in the receptacle":
        story.places[1] = INSIDE.copy()
    else:
        story.places[1] = np.array([0.1, 0.1, LYING_M])
    story.wait(0.1).look(FIRST).note("stopped", outcome="DONE")
    assert "fragment_false_negatives" not in modes_of(story)


@pytest.mark.parametrize(
    ("share", "later_s", "missed"), [(SEEN_SHARE, 0.0, 1), (SEEN_SHARE - 1 / POINTS, 0.0, 0), (0.0, 2 * SIGHT_S, 1)]
)
def test_1_what_is_half_visible_is_overlooked_and_so_is_what_nobody_checked_at_that_time(share, later_s, missed):
    story = Story().look(FIRST).note("stopped", outcome="DONE")
    truth = story.truth()
    sights = Sights(truth.sights.times_s + later_s, np.full_like(truth.sights.seen, share))
    scores = score_fragments(replace(truth, sights=sights), story.events)
    assert sum(score.fragment_false_negatives for score in scores) == missed


LOW, HIGH = np.array(Workspace().region_m)


@pytest.mark.parametrize(("corner", "outwards"), [(LOW, -1), (HIGH, 1)])
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(("outside_m", "missed"), [(0.014, 1), (0.016, 0)])
def test_1_what_was_pushed_a_little_out_of_the_region_can_still_be_overlooked(
    corner, outwards, axis, outside_m, missed
):
    place = np.append(0.5 * (LOW + HIGH), LYING_M)
    place[axis] = corner[axis] + outwards * outside_m
    story = Story(FIRST, place).look(FIRST).note("stopped", outcome="DONE")
    assert scores_of(story)[1].fragment_false_negatives == missed


def test_1_what_is_in_the_air_is_not_overlooked():
    story = Story(FIRST, SECOND + [0, 0, 0.02]).look(FIRST).note("stopped", outcome="DONE")
    assert modes_of(story) == {}


@pytest.mark.parametrize(("acts", "missed"), [("left", 1), ("right", 0)])
def test_1_each_arm_acts_on_its_own_looks(acts, missed):
    """The left arm overlooks one; it then acts, or only the other one does until it has looked again."""
    story, both = Story(arms=("left", "right")).look(FIRST), [FIRST.tolist(), SECOND.tolist()]
    story.wait(0.1).note("detected", arm="right", image_s=story.now_s, fragments=both)
    story.note("allocated", arm=acts, place=FIRST.tolist()).wait(0.1).look(FIRST, SECOND).clear(0)
    assert modes_of(story) == ({"fragment_false_negatives": 1} if missed else {})


def test_2_a_detection_where_no_fragment_is():
    ghost = [-0.03, -0.045, LYING_M]
    story = Story()
    for _ in range(3):
        story.look(FIRST, SECOND, ghost).wait(0.1)
    story.clear(0).look(SECOND)
    assert modes_of(story) == {"fragment_false_positives": 1}
    assert scores_of(story)[0].fragment_false_positives == 1, "the nearest takes the blame"
    assert scores_of(story)[0].succeeded and not scores_of(story)[0].first_attempt
    assert modes_of(story.look(SECOND, ghost)) == {"fragment_false_positives": 2}, "it was gone meanwhile"


def test_2_a_detection_a_little_beside_its_fragment_is_none():
    assert modes_of(Story().look(FIRST + [0.009, 0, 0.003], SECOND).note("stopped", outcome="DONE")) == {}


def test_3_a_fragment_in_the_jaws_that_is_not_seen():
    story = Story().grasp(0).lift().note("pickup", arm="left", holding=False, image_s=0.0)
    story.events[-1]["image_s"] = story.now_s
    story.move([*FIRST[:2], TABLE_M + 0.012]).jaws(1.2).grasp(0).lift().deliver(0)
    assert modes_of(story) == {"pickup_false_negatives": 1}
    assert scores_of(story)[0].succeeded and scores_of(story)[0].attempts == 2


def test_4_empty_jaws_in_which_a_fragment_is_seen():
    story = Story().grasp(0, gripping=[]).lift()
    story.note("pickup", arm="left", holding=True, image_s=story.now_s).move(OVER).jaws(1.2)
    assert modes_of(story) == {"pickup_false_positives": 1, "grasp_failures": 1}


@pytest.mark.parametrize("last", [True, False])
def test_3_and_4_the_last_word_on_a_grip_counts(last):
    story = Story().grasp(0).lift()
    for holding in (not last, last):
        story.note("pickup", arm="left", holding=holding, image_s=story.now_s).wait(0.1)
    story.deliver(0)
    assert modes_of(story) == ({} if last else {"pickup_false_negatives": 1})


def test_4_a_word_on_one_grip_says_nothing_of_the_one_before():
    story = Story().grasp(0, gripping=[]).lift().note("pickup", arm="left", holding=True, image_s=0.0)
    story.events[-1]["image_s"] = story.now_s
    story.jaws(1.2).grasp(0).lift().note("pickup", arm="left", holding=True, image_s=0.0)
    story.events[-1]["image_s"] = story.now_s
    assert modes_of(story.deliver(0)) == {"pickup_false_positives": 1, "grasp_failures": 1}


def test_3_of_two_in_the_jaws_the_one_that_was_meant_was_not_seen():
    story = Story(FIRST, FIRST + [0.01, 0, 0]).grasp(1, gripping=[0, 1]).lift()
    story.note("pickup", arm="left", holding=False, image_s=story.now_s).deliver(0, 1)
    assert [scores_of(story)[k].pickup_false_negatives for k in (0, 1)] == [0, 1]


def test_5_jaws_that_close_on_nothing():
    story = Story().grasp(0, gripping=[]).lift()
    assert modes_of(story) == {"grasp_failures": 1}
    assert scores_of(story)[0].failure == "GRASP_FAILURE" and scores_of(story)[0].recoveries == 0
    story.jaws(1.2).clear(0)
    score = scores_of(story)[0]
    assert score.succeeded and not score.first_attempt
    assert (score.attempts, score.grasp_failures, score.recoveries) == (2, 1, 1)


def test_5_a_fragment_that_squirts_out_while_the_jaws_close_was_never_in_them():
    story = Story().note("allocated", arm="left", place=FIRST.tolist()).above(FIRST)
    story.jaws(0.5, [0], 0.3)
    story.held = set()
    story.jaws(0.0, seconds=0.2).wait(0.3).lift()
    assert modes_of(story) == {"grasp_failures": 1}


def test_5_is_no_matter_of_words():
    story = Story().grasp(0, gripping=[], allocate=False).lift()
    story.events = []
    assert modes_of(story) == {"grasp_failures": 1}


def test_5_jaws_that_close_in_the_air_or_over_the_receptacle_grasp_at_nothing():
    story = Story().jaws(0.0).jaws(1.2).move(OVER - [0, 0, 0.03]).jaws(0.3).jaws(1.2)
    assert modes_of(story) == {}
    assert all(score.attempts == 0 for score in scores_of(story).values())


def test_6_two_fragments_in_the_jaws_at_once():
    story = Story(FIRST, FIRST + [0.01, 0, 0]).grasp(0, gripping=[0, 1]).lift().deliver(0, 1)
    assert modes_of(story) == {"multiple_grasps": 1}
    scores = scores_of(story)
    assert all(score.succeeded for score in scores.values())
    assert scores[0].multiple_grasps == 1 and not scores[0].first_attempt
    assert scores[0].recoveries == 0, "it has not been fetched again"


def test_7_a_fragment_that_is_lost_while_the_jaws_rise():
    story = Story().grasp(0).move([*FIRST[:2], TABLE_M + 0.03]).lose(0, FIRST).lift()
    assert modes_of(story) == {"pickup_failures": 1}
    assert scores_of(story)[0].failure == "PICKUP_FAILURE"


def test_8_a_fragment_that_falls_on_the_way():
    story = Story().grasp(0).lift().move([-0.06, -0.04, TABLE_M + 0.06]).lose(0, [-0.06, -0.04, LYING_M]).move(OVER)
    assert modes_of(story) == {"drops_en_route": 1}
    assert scores_of(story)[0].failure == "DROPPED_EN_ROUTE"


def test_8_jaws_that_shut_when_they_lose_a_fragment_did_not_close_there():
    story = Story().grasp(0).lift().move([-0.06, -0.04, TABLE_M + 0.06]).lose(0, [-0.06, -0.04, LYING_M])
    story.jaws(0.0, seconds=0.1).wait(0.3).move(OVER).jaws(1.2)
    assert modes_of(story) == {"drops_en_route": 1}
    assert scores_of(story)[0].attempts == 1


def test_8_a_grip_that_flickers_was_not_lost():
    story = Story().grasp(0).lift()
    story.held = set()
    story.wait(0.03)
    story.held = {0}
    assert modes_of(story.deliver(0)) == {}


@pytest.mark.parametrize("over", [OVER, OUTSIDE_OVER], ids=["bounced", "missed"])
def test_9_a_fragment_that_is_let_go_and_lands_outside(over):
    story = Story().grasp(0).lift().deliver(0, to_m=BESIDE, over_m=over)
    assert modes_of(story) == {"dropoff_failures": 1}
    assert scores_of(story)[0].failure == "DROPOFF_FAILURE"


@pytest.mark.parametrize(("to_m", "failures"), [(INSIDE, 0), (BESIDE, 1)])
def test_9_a_fragment_that_slips_out_of_closed_jaws_over_the_receptacle_was_let_go_there(to_m, failures):
    story = Story().grasp(0).lift().move(OVER).lose(0, to_m).wait(0.8).move(HOME)
    assert modes_of(story) == ({"dropoff_failures": 1} if failures else {})
    assert scores_of(story)[0].succeeded == (not failures)


def test_9_a_release_far_from_the_receptacle_is_one_if_the_script_thought_to_be_there():
    far = np.array([-0.06, -0.09, TABLE_M + 0.06])
    story = Story().grasp(0).lift().deliver(0, to_m=[*far[:2], LYING_M], over_m=far)
    assert modes_of(story) == {"dropoff_failures": 1}
    story.events = [event for event in story.events if event["name"] != "releasing"]
    assert modes_of(story) == {}, "without a word it was put back, to be grasped anew"


def test_9_a_fragment_that_clings_to_a_finger_and_never_falls():
    story = Story().grasp(0).lift().move(OVER)
    story.touched = {0}
    story.jaws(1.2).wait(1.0).move(HOME)
    assert modes_of(story) == {"dropoff_failures": 1}
    assert scores_of(story)[0].failure == "STUCK_IN_JAWS"


def test_9_a_fragment_that_clings_and_falls_inside_in_the_end():
    story = Story().grasp(0).lift().move(OVER)
    story.touched = {0}
    story.jaws(1.2).wait(0.5)
    story.touched = set()
    story.places[0] = INSIDE.copy()
    assert modes_of(story.wait(1.0)) == {}
    assert scores_of(story)[0].succeeded


# Lies and odd ends.


@pytest.mark.parametrize("outcome", ["DONE", "GRASP_FAILURE"])
def test_lies_change_nothing(outcome):
    story = Story().grasp(0).lift().deliver(0, to_m=BESIDE)
    story.note("fragment", arm="left", outcome=outcome, reason="so there").note("stopped", outcome="DONE")
    score = scores_of(story)[0]
    assert not score.succeeded and score.failure == "DROPOFF_FAILURE"
    good = Story().clear(0).note("fragment", arm="left", outcome="GRASP_FAILURE", reason="I failed")
    assert scores_of(good)[0].succeeded and modes_of(good) == {}


def test_a_script_s_own_word_explains_what_truth_leaves_open():
    story = Story().note("stopped", outcome="CAMERA_FROZEN", reason="no new image for 5 s")
    assert {(s.failure, s.reason) for s in scores_of(story).values()} == {("CAMERA_FROZEN", "no new image for 5 s")}


@pytest.mark.parametrize(
    ("arm", "outcome", "reason"),
    [
        ("left", "GRASP_FAILURE", "nothing between the jaws"),
        ("left", "BLOCKED", FragmentOutcome.GRASP_FAILURE.value),
        ("right", "GRASP_FAILURE", FragmentOutcome.GRASP_FAILURE.value),
    ],
)
def test_a_reason_is_the_script_s_own_where_the_arm_that_was_there_names_what_happened(arm, outcome, reason):
    story = Story(arms=("left", "right")).grasp(0, gripping=[])
    story.note("fragment", arm=arm, outcome=outcome, reason="nothing between the jaws")
    noted_s = story.now_s
    score = scores_of(story.lift())[0]
    assert (score.failure, score.reason) == ("GRASP_FAILURE", reason)
    assert score.end_s == pytest.approx(noted_s if arm == "left" else story.now_s)


def test_what_happened_to_a_fragment_last_is_its_failure():
    away = np.array([-0.06, -0.04, TABLE_M + 0.06])
    story = Story().grasp(0, gripping=[]).lift().jaws(1.2).grasp(0).lift().move(away).lose(0, [*away[:2], LYING_M])
    assert modes_of(story) == {"grasp_failures": 1, "drops_en_route": 1}
    assert scores_of(story)[0].failure == "DROPPED_EN_ROUTE"


def test_a_closing_was_meant_for_the_fragment_that_its_arm_was_given_last():
    """Between both, nearer to the first; what is given to the other arm, or later on, says nothing."""
    story = Story(FIRST, FIRST - [0.03, 0, 0], arms=("left", "right"))
    for arm, place in (("left", FIRST), ("left", FIRST - [0.03, 0, 0]), ("right", FIRST)):
        story.note("allocated", arm=arm, place=place.tolist()).wait(0.1)
    story.above(FIRST - [0.01, 0, 0]).jaws(0.0).wait(0.3).lift()
    story.note("allocated", arm="left", place=FIRST.tolist())
    assert [scores_of(story)[k].grasp_failures for k in (0, 1)] == [0, 1]
    story.events = []
    assert [scores_of(story)[k].grasp_failures for k in (0, 1)] == [1, 0], "without a word, for the nearest"


def test_of_what_a_script_noted_its_last_word_counts():
    story = Story()
    for reason in ("missed", "missed again"):
        story.grasp(0, gripping=[]).note("fragment", arm="left", outcome="GRASP_FAILURE", reason=reason)
        story.lift().jaws(1.2)
    assert scores_of(story)[0].reason == "missed again"
    assert scores_of(story.grasp(0, gripping=[]))[0].reason == FragmentOutcome.GRASP_FAILURE.value, "of earlier ones"


def test_a_closing_was_not_meant_for_a_fragment_that_lies_far_from_where_one_was_said_to_be():
    story = Story().note("allocated", arm="left", place=(SECOND - [0.02, 0, 0]).tolist())
    story.above(FIRST + [0.012, 0, 0]).jaws(0.0).wait(0.3).lift()
    assert [scores_of(story)[k].grasp_failures for k in (0, 1)] == [1, 0]


def test_jaws_that_grip_another_fragment_have_tried_that_one():
    story = Story(FIRST, FIRST - [0.014, 0, 0]).note("allocated", arm="left", place=(FIRST - [0.014, 0, 0]).tolist())
    story.grasp(0, allocate=False).lift().deliver(0)
    assert [scores_of(story)[k].attempts for k in (0, 1)] == [1, 0]


def test_what_was_not_cleared_stands_behind_what_was():
    story = Story().grasp(0, gripping=[]).note("fragment", arm="left", outcome="GRASP_FAILURE", reason="")
    story.lift().jaws(1.2).clear(1)
    assert [score.fragment for score in score_fragments(story.truth(), story.events)] == [1, 0]


def test_9_an_announcement_is_of_the_release_that_follows_it():
    far = np.array([-0.06, -0.09, TABLE_M + 0.06])
    story = Story().clear(0).grasp(1).lift().move(far)
    story.places[1] = np.array([*far[:2], LYING_M])
    assert modes_of(story.jaws(1.2).wait(0.8)) == {}, "put back"


def test_what_is_still_held_at_the_end_is_not_cleared():
    assert not scores_of(Story().grasp(0).lift().move(INSIDE))[0].succeeded


def test_what_is_still_falling_at_the_end_does_not_rest():
    story = Story().clear(0)
    story.places[0] = INSIDE + [0, 0, 0.004]
    story._tick()
    assert not scores_of(story)[0].succeeded


def test_what_a_person_carries_over_counts_as_cleared():
    story = Story()
    story.places[1] = INSIDE.copy()
    assert scores_of(story.wait(1.0))[1].succeeded


def test_a_second_arm_that_stands_by_changes_nothing():
    assert modes_of(Story(arms=("left", "right")).clear(0)) == {}
