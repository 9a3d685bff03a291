"""What a task must bring along, what it has by default, its budget, and how a script explains a failure."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from trocar.calibration.excitation import PSM1_BOX
from trocar.errors import InvalidInput, TrocarError
from trocar.eval import TASKS, Method, Score, Task, agent_explanation, option, stopped
from trocar.eval.staged import draw_world
from trocar.eval.task import check_budget
from trocar.lab import load_station


class Knitter:
    """An agent."""


@dataclass(frozen=True)
class Knitting(Task):
    """A task of the tester's own, that says nothing of what there is to do."""

    budget_s: float = option(60.0, "When it is stopped.", flag="budget", metavar="S")

    name = "knitting"
    about = "rows of stitches"
    goal_noun = "row"
    station = "peg-transfer"
    methods: ClassVar = {"by-hand": Method("slowly", Knitter)}


@dataclass(frozen=True)
class Nameless(Knitting):
    name = ""
    methods: ClassVar = {}


@dataclass(frozen=True)
class Endless(Task):
    name = "endless"
    about = "rows of stitches"
    goal_noun = "row"
    station = "peg-transfer"
    methods: ClassVar = Knitting.methods


class Whole(Knitting):
    def goals(self): ...

    def scene(self, rng, station): ...

    def world(self, scene): ...

    def score(self, truth, events): ...

    @staticmethod
    def nominal(): ...


@pytest.mark.parametrize(
    ("task", "words"),
    [
        (Knitter, "task 'x' is .*; register a frozen dataclass derived from"),
        (Knitting(), "task 'x' is .*; register a frozen dataclass derived from"),
        (type("Bare", (Task,), {}), "task 'x' is .*; register a frozen dataclass derived from"),
        (Nameless, "task Nameless has no name, methods; give its class these attributes"),
        (Endless, "task Endless has no budget_s; give its class these attributes"),
        (Knitting, r"task Knitting has no goals\(\), scene\(\), world\(\), score\(\); give its class these methods"),
    ],
)
def test_a_task_that_lacks_something_is_refused_when_it_is_registered(registries, task, words):
    with pytest.raises(InvalidInput, match=words):
        TASKS.register("x", task)


class Blind(Whole):
    def scene(self, rng): ...


class Deaf(Whole):
    @staticmethod
    def score(truth): ...


class Rooted(Whole):
    def at(self): ...


class Settled(Whole):
    goals = (0, 1)  # type: ignore[assignment]


@pytest.mark.parametrize(
    ("task", "words"),
    [
        (Blind, r"scene of task Blind cannot be called as scene\(rng, station\); give it these parameters"),
        (Deaf, r"score of task Deaf cannot be called as score\(truth, events\); give it"),
        (Rooted, r"at of task Rooted cannot be called as at\(station\); give it"),
        (Settled, r"goals of task Settled cannot be called as goals\(\); give it"),
    ],
)
def test_a_method_that_takes_something_else_is_refused_when_its_task_is_registered(registries, task, words):
    with pytest.raises(InvalidInput, match=words):
        TASKS.register("x", task)


@pytest.mark.parametrize("world", [None, {"bodies": []}])
def test_a_world_that_is_none_is_told(monkeypatch, world):
    monkeypatch.setattr(Whole, "world", lambda self, scene: world)
    with pytest.raises(
        InvalidInput, match=r"task 'knitting' returns .* from world\(scene\); return a trocar.sim.world"
    ):
        draw_world(Whole(), np.random.default_rng(0), load_station("peg-transfer"))


def test_a_task_that_lacks_nothing_can_be_registered(registries):
    TASKS.register("x", Whole)
    assert TASKS.pick("x") is Whole


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda task: task.goals(), r"task 'knitting' has no goals; give its class a method goals\(\)"),
        (lambda task: task.scene(np.random.default_rng(0), None), r"has no scene; .* scene\(rng, station\)"),
        (lambda task: task.world(None), r"has no world; .* world\(scene\)"),
        (lambda task: task.score(None, []), r"has no score; .* score\(truth, events\)"),
    ],
)
def test_what_a_task_must_bring_along_is_said_where_it_is_missing(call, words):
    with pytest.raises(TrocarError, match=words):
        call(Knitting())


def test_by_default_the_first_arm_works_where_the_station_is_and_as_it_says():
    task, station = Knitting(), load_station("peg-transfer")
    assert task.at(station) is station and task.nominal() is None
    assert task.working_arms(station) == ("psm1",)
    assert task.calibration(station, "psm1") is PSM1_BOX
    with pytest.raises(
        TrocarError, match="does not define where arm 'left' moves during calibration; add 'calibration'"
    ):
        task.calibration(load_station("raven-pair"), "left")


def test_a_budget_is_any_time_above_none():
    check_budget(1e-3)
    for none in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(InvalidInput, match="give a finite time above 0 with --budget"):
            check_budget(none)


def test_the_last_word_on_why_a_script_was_given_up_stands():
    assert stopped([]) == ("", "")
    events = [
        {"name": "stopped", "outcome": "A", "reason": "first"},
        {"name": "x"},
        {"name": "stopped", "outcome": "B"},
    ]
    assert stopped(events) == ("B", "")
    assert stopped(events[:2]) == ("A", "first")


def test_a_script_explains_a_goal_by_its_own_word_or_by_why_it_was_given_up():
    given_up = [{"name": "stopped", "outcome": "FAULT", "reason": "silence"}]
    assert agent_explanation(None, given_up) == ("FAULT", "silence")
    assert agent_explanation({"outcome": "DROPPED", "reason": "slick"}, given_up) == ("DROPPED", "slick")
    for nothing in ({"outcome": "DONE"}, {}):  # it said that all went well: the truth has to tell
        assert agent_explanation(nothing, given_up) is None
    assert agent_explanation(None, []) is None


GOOD = {"attempted": True, "succeeded": False, "failure": "MISSED", "reason": "", "start_s": 0, "end_s": 1.5}


@dataclass(frozen=True)
class RowScore(Score):
    """A row of stitches as the referee saw it."""

    stitches: int
    at_m: tuple[float, ...] | None = None


def test_numbers_of_numpy_in_a_score_become_pythons():
    score = RowScore(np.True_, np.False_, np.str_("MISSED"), "", np.int64(0), np.float32(1.5), stitches=np.int8(3))
    assert score == RowScore(**GOOD, stitches=3)
    assert [type(value) for value in vars(score).values()][:-1] == [bool, bool, str, str, int, float, int]
    assert RowScore(**GOOD, stitches=3, at_m=np.array([1.0, 2.0])).at_m == [1.0, 2.0]  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("attempted", 1, "attempted of a RowScore is 1; give True or False"),
        ("succeeded", None, "succeeded of a RowScore is None; give True or False"),
        ("succeeded", np.array([True, False]), r"succeeded of a RowScore is \[True, False\]; give True or False"),
        ("failure", None, "failure of a RowScore is None; give a text, which may be empty"),
        ("reason", 3, "reason of a RowScore is 3; give a text"),
        ("start_s", True, "start_s of a RowScore is True; give a finite number of seconds"),
        ("end_s", "soon", "end_s of a RowScore is 'soon'; give a finite number of seconds"),
        ("end_s", np.float32("nan"), "end_s of a RowScore is nan; give a finite number of seconds"),
    ],
)
def test_a_score_of_other_kinds_is_refused_by_its_field(field, value, words):
    with pytest.raises(InvalidInput, match=words):
        RowScore(**GOOD | {field: value}, stitches=3)
