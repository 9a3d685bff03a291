"""Between two trials: what a person sets there holds for the next one."""

import pytest

from trocar.console import Watch
from trocar.console.lobby import Lobby
from trocar.view.wishes import Level, Said, Wish


def lobby(**how):
    return Lobby("Trial 1 with a: 2 of 3 goals", ("a", "b"), Level.MOTIONS, 1.0, **{"paced": True} | how)


def test_a_trial_begins_with_a_method_that_there_is():
    here = lobby()
    here.take_in(Said(Wish.BEGIN, value="c"))
    assert not here.chosen and here.standing.methods == ("a", "b")
    assert here.standing.words == "Trial 1 with a: 2 of 3 goals. Choose a method and begin a trial"
    here.take_in(Said(Wish.BEGIN, value="b"))
    assert here.chosen == "b" and here.standing.words == "Sets up a trial with b"
    assert here.standing.methods == () and here.standing.idle


def test_what_is_set_between_trials_is_shown_and_kept():
    here = lobby()
    for wish, value in ((Wish.LEVEL, Level.GOALS), (Wish.SPEED, 4.0), (Wish.PAUSE, True), (Wish.STOP, None)):
        here.take_in(Said(wish, value=value))
    assert (here.level, here.speed, here.paused, here.stopped) == (Level.GOALS, 4.0, True, True)
    now = here.standing
    assert (now.level, now.speed, now.stopped) == (Level.GOALS, 4.0, True)
    assert "until you press Go on" in now.words and "its clock is paused" in now.words
    here.take_in(Said(Wish.GO_ON))
    assert not here.stopped and not here.chosen


def test_real_arms_have_no_speed():
    here = lobby(paced=False)
    here.take_in(Said(Wish.SPEED, value=4.0))
    here.take_in(Said(Wish.PAUSE, value=True))
    assert (here.speed, here.paused, here.standing.speed) == (1.0, False, None)


@pytest.mark.parametrize("wish", [Wish.YES, Wish.TAKE, Wish.DONE, Wish.HOLD, Wish.LEFT])
def test_wishes_about_a_trial_count_for_nothing(wish):
    here = lobby()
    before = vars(here).copy()
    here.take_in(Said(wish, "psm1", 1))
    assert vars(here) == before


def test_after_an_emergency_stop_the_arms_wait_for_the_person():
    here = lobby()
    here.take_in(Said(Wish.EMERGENCY))
    here.take_in(Said(Wish.BEGIN, value="a"))
    assert here.stopped and here.chosen == "a" and "until you press Go on" in here.standing.words


class Queue(Watch):
    """A console without a page, whose person says these things one after the other."""

    def __init__(self, *said):
        super().__init__(port=None)
        self.plan = list(said)

    def _hear(self):
        heard, self._left_over = [*self._left_over, *self.plan[:1]], []
        self.plan = self.plan[1:]
        return heard


@pytest.mark.parametrize("wish", [Wish.STOP, Wish.EMERGENCY])
def test_a_stop_while_a_trial_is_set_up_counts_though_the_trial_failed(wish):
    watch = Queue(Said(wish), Said(Wish.BEGIN, value="a"))
    assert watch.next_method("No trial with a", ["a"]) == "a"
    assert watch.console.stopped


def test_a_second_click_while_a_trial_is_set_up_begins_no_other_one():
    watch = Queue(Said(Wish.BEGIN, value="b"), Said(Wish.BEGIN, value="a"))
    assert watch.next_method("No trial with b", ["a", "b"]) == "a"


def test_what_an_arm_reports_while_a_trial_is_set_up_is_no_error():
    watch = Queue(Said(Wish.STOP), Said(Wish.BEGIN, value="a"))
    watch.next_method("Trial 1 with a", ["a"])
    watch.heard({"name": "fault", "fault": "stale"})
