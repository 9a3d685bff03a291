"""What a page has shown in the last seconds is kept, in few entries even if the clock is slow or stands."""

from collections import deque

import numpy as np

from trocar.view.recent import APART_S, add_recent


def added(times_s, kept_s=2.0):
    recent = deque()
    for time_s in times_s:
        add_recent(recent, time_s, f"at {time_s}", kept_s)
        assert recent[-1] == (time_s, f"at {time_s}"), "the present is always there"
    return np.array([time_s for time_s, _ in recent])


def test_in_slow_motion_few_entries_cover_the_last_seconds():
    kept = added(np.arange(0.0, 6.0, 0.0033))
    assert (np.diff(kept)[:-1] >= APART_S).all() and (np.diff(kept)[:-1] < APART_S + 0.0034).all()
    assert 2.0 - 2 * APART_S < kept[-1] - kept[0] <= 2.0


def test_at_real_time_each_entry_is_kept_until_it_is_old():
    times_s = np.arange(0.0, 6.0, 0.033)
    assert added(times_s).tolist() == times_s[times_s >= times_s[-1] - 2.0].tolist()


def test_while_the_clock_stands_nothing_is_added():
    assert len(added([0.0, 1.0, *[1.5] * 100])) == 4


def test_two_entries_are_left_whatever_their_age():
    assert added([0.0, 10.0, 20.0]).tolist() == [10.0, 20.0]
