"""Some of what ``benchmarks/bench_crtk_disturbances.py`` does to a task over CRTK, once each."""

import os
import sys

import pytest

pytest.importorskip("cyclonedds", reason="the extra 'crtk' is not installed")

from bench_crtk_disturbances import MOST_RATIO, Bench

from crtk_partners import DOMAIN

pytestmark = pytest.mark.realtime


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """Return a bench whose robot is kept while it is well, so that one test begins where another has stopped."""
    domain = os.environ.get("ROS_DOMAIN_ID")
    os.environ["ROS_DOMAIN_ID"] = str(DOMAIN)
    made = Bench(tmp_path_factory.mktemp("disturbed"), 0, [], sys.executable)
    yield made
    made.end()
    os.environ.pop("ROS_DOMAIN_ID")
    if domain is not None:
        os.environ["ROS_DOMAIN_ID"] = domain


def test_a_killed_script_leaves_arms_at_rest_and_the_same_command_goes_on(bench):
    for number in (0, 10, 20):  # on a busy machine a fault may have ended the trial before: then there is none to redo
        found = bench.attempt(number, "script killed")
        assert not found.wrong and found.acceleration <= MOST_RATIO
        if not found.ended:
            break
    after = bench.attempt(1, "loop killed")
    assert not after.wrong and after.faults and after.ended == "FAULT"


def test_a_loop_that_hears_nothing_stops_its_arms_and_names_it(bench):
    found = bench.attempt(2, "loop's sockets")
    assert not found.wrong and found.ended == "FAULT"
    assert set(found.faults) & {"stale", "lost", "following"}
