"""A task that does what it must passes; one that breaks a promise is refused in a sentence that names it."""

import importlib
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import pytest

from trocar.cli.learn import DEMONSTRATIONS
from trocar.cli.run import RUN, STUDY
from trocar.cli.task_group import OF_RUN
from trocar.errors import InvalidInput
from trocar.eval import TASKS, option
from trocar.eval.task import flag_of
from trocar.registry import PLUGIN_MODULE, load_plugin
from trocar.tasks.peg_transfer.task import PegTransfer
from trocar.testing import CheckFailed, check_task
from trocar.testing.task import (
    RESERVED,
    check_description,
    check_methods,
    check_scene,
    check_score,
    check_station_of,
    check_trial,
    check_world,
)

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def example():
    """The smallest task of the documentation, a module."""
    digest = load_plugin(EXAMPLES / "three_dots.py")
    yield importlib.import_module(f"{PLUGIN_MODULE}three_dots_{digest[:8]}")
    TASKS.forget("dots")


@pytest.fixture
def dots(example):
    return example.Dots


def test_the_task_of_the_documentation_passes_by_its_name_and_leaves_no_method_behind(dots):
    from trocar.eval import methods_of

    check_task("dots")
    assert set(methods_of(dots)) == {"drawing"} and dots.name in TASKS


def test_a_task_that_is_not_registered_can_be_checked_and_is_not_registered_then(dots):
    unregistered = type("Unregistered", (dots,), {"name": "unregistered"})
    check_trial(dataclass(frozen=True)(unregistered))
    assert "unregistered" not in TASKS


def test_what_it_says_of_itself(dots):
    for changes, words in (
        ({"name": "Dots!"}, "have a name of lower-case letters"),
        ({"about": "Three dots."}, "in one line without a full stop"),
        ({"options": lambda task: {}}, "tell all its options"),
    ):
        with pytest.raises(CheckFailed, match=words):
            check_description(type("Broken", (dots,), changes))

    @dataclass(frozen=True)
    class Taken(dots):
        seed: int = option(3, "Taken.")

    with pytest.raises(CheckFailed, match=r"options of its own, not \['seed'\]"):
        check_description(Taken)

    @dataclass(frozen=True)
    class Spelt(dots):
        pen_speed: float = option(1.0, "Taken on the command line.", flag="speed")

    with pytest.raises(CheckFailed, match=r"options of its own, not \['speed'\]"):
        check_description(Spelt)

    @dataclass(frozen=True)
    class Among(dots):
        shape: str = option("oval", "Shape.", choices=("round", "square"))

    with pytest.raises(CheckFailed, match="default for shape that is among its choices"):
        check_description(Among)


def test_every_option_of_a_run_is_known_to_be_taken(dots):
    for group, task in ((RUN, dots), (DEMONSTRATIONS, dots), (STUDY, PegTransfer)):
        own = {flag_of(field) for field in (*fields(task), *OF_RUN.values())} | {f"--{group.varied(task)}s"}
        taken = {word.removeprefix("--") for one in group.command(task).params for word in one.opts if word not in own}
        assert taken <= RESERVED


def test_its_methods_name_planners_that_exist(dots):
    method = replace(dots.methods["drawing"], planner="straightest")
    with pytest.raises(CheckFailed, match="planner for 'drawing' that exists, not 'straightest'"):
        check_methods(type("Broken", (dots,), {"methods": {"drawing": method}}))


def test_its_arms_are_of_its_station(dots):
    broken = type("Broken", (dots,), {"working_arms": lambda task, station: ("psm1", "psm9")})
    with pytest.raises(CheckFailed, match=r"arms of its station, not \('psm1', 'psm9'\)"):
        check_station_of(broken)

    def nowhere(task, station, arm):
        raise InvalidInput("this task", "is not calibrated", "choose another")

    check_station_of(type("Uncalibrated", (dots,), {"calibration": nowhere}))


def test_its_scene_comes_from_the_generator_alone(dots):
    changing = np.random.default_rng(0)
    broken = type("Broken", (dots,), {"scene": lambda task, rng, station: changing.uniform(size=(3, 3))})
    with pytest.raises(CheckFailed, match="draw its scene from the generator alone"):
        check_scene(broken)
    with pytest.raises(CheckFailed, match="at least one"):
        check_scene(type("Broken", (dots,), {"goals": lambda task: ()}))


def test_its_bodies_rest(dots, example):
    class Falling(example.DotWorld):
        def add(self, spec):
            spec.worldbody.add_body(name="ball", pos=[0.0, 0.1, 0.5]).add_freejoint()
            super().add(spec)
            body = next(body for body in spec.bodies if body.name == "ball")
            body.add_geom(size=(0.005, 0, 0), mass=0.01)

    with pytest.raises(CheckFailed, match="let its bodies rest; 'ball' moves by"):
        check_world(type("Broken", (dots,), {"world": lambda task, scene: Falling(scene)}))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda scores, events: scores[:2], "one score for each goal, not 2 for 3"),
        (lambda scores, events: [replace(s, attempted=False) for s in scores], "count every goal as attempted"),
        (lambda scores, events: [replace(s, failure="") for s in scores], "as failed, by a name"),
        (lambda scores, events: [replace(s, succeeded=len(events) == 1) for s in scores], "as failed, by a name"),
    ],
)
def test_its_score_believes_nobody(dots, change, words):
    def score(task, truth, events):
        return change(dots.score(task, truth, events), events)

    with pytest.raises(CheckFailed, match=words):
        check_score(type("Broken", (dots,), {"score": score}))


def test_times_of_scores_lie_within_the_trial(dots):
    def late(task, truth, events):
        return [replace(score, end_s=99.0) for score in dots.score(task, truth, events)]

    with pytest.raises(CheckFailed, match="times within the trial"):
        check_trial(type("Broken", (dots,), {"score": late}))
