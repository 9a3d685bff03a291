"""The parts of tasks: options, methods and perceptions by name, the actions of a script."""

import sys
from dataclasses import dataclass, fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

from simulated import ideal_laboratory, standing
from trocar.arms import ARMS
from trocar.calibration.excitation import EXERCISE_RAD
from trocar.cli.task_group import TaskGroup
from trocar.errors import InvalidInput, TrocarError, UnknownName
from trocar.eval import (
    METHODS,
    PERCEPTIONS,
    Method,
    Task,
    listed_settings,
    methods_of,
    option,
    perceptions_of,
    pick_method,
    pick_perception,
)
from trocar.registry import Lazy, load_plugin
from trocar.robots.arm_script import ArmScript


@dataclass(frozen=True)
class Settings:
    """How knitting is done."""

    speed_m_s: float = 0.01


class Knitter:
    """An agent that keeps its context."""

    def __init__(self, context):
        self.context = context

    async def run(self):
        """Do nothing."""


class Eyes:
    """A perception."""


HERE = Settings.__module__
BY_HAND = Method("slowly", Knitter, Settings)
WITH_A_MACHINE = Method("fast", Lazy(f"{HERE}:Knitter"), Lazy(f"{HERE}:Settings"), perception="eyes")


@dataclass(frozen=True)
class Knitting(Task):
    """A task of the tester's own."""

    rows: int | None = option(None, "How many rows (default: all).", metavar="N")
    pattern: str = option("plain", "What it looks like.", choices=("plain", "purl"))
    needle: Path | None = option(None, "A file of needles.", flag="needle-file", metavar="FILE")
    tight: bool = option(False, "Pull at the wool.")
    budget_s: float = option(60.0, "When it is stopped.", flag="budget", metavar="S")

    name = "knitting"
    about = "rows of stitches"
    goal_noun = "row"
    station = "peg-transfer"
    methods: ClassVar = {"by-hand": BY_HAND, "machine": WITH_A_MACHINE}
    perceptions: ClassVar = {"eyes": Eyes, "far": Lazy(f"{HERE}:Eyes")}


@pytest.fixture(autouse=True)
def findable(registries, monkeypatch):
    """Let what is lazy here be imported by its name, as pytest's own imports are not."""
    monkeypatch.setitem(sys.modules, HERE, sys.modules.get(HERE) or SimpleNamespace())
    for thing in (Knitter, Settings, Eyes):
        monkeypatch.setattr(sys.modules[HERE], thing.__name__, thing, raising=False)


# Options.


def test_options_are_fields_with_what_a_command_line_needs():
    found = {field.name: field for field in fields(Knitting)}
    assert list(found) == ["rows", "pattern", "needle", "tight", "budget_s"]
    assert found["needle"].metadata == {
        "help": "A file of needles.",
        "flag": "needle-file",
        "metavar": "FILE",
        "choices": (),
        "shown": "",
    }
    assert found["pattern"].metadata["choices"] == ("plain", "purl") and found["pattern"].default == "plain"
    assert Knitting(rows=3).options() == {
        "rows": 3,
        "pattern": "plain",
        "needle": None,
        "tight": False,
        "budget_s": 60.0,
    }


def run_command(task, *args):
    """Return what the body of a task's command was called with."""
    seen = {}

    class Group(TaskGroup):
        does, example, of_run = "Plays it.", "trocar run {task}", ("seed", "flaws", "new_session")

        @staticmethod
        def body(*, task, options, run):
            seen.update(task=task, options=options, run=run)

    Group("run", "", {}).command(task).main(list(args), standalone_mode=False)
    return seen


def test_a_command_line_makes_a_task_of_them_with_their_types():
    line = "--rows 7 --pattern purl --needle-file n.toml --tight --budget 5 --seed 3 --flaw jaw=1deg --flaw wear=2"
    seen = run_command(Knitting, *line.split())
    assert seen["task"] is Knitting
    assert seen["run"] == {"seed": 3, "flaws": ("jaw=1deg", "wear=2"), "new_session": False}
    options = {"rows": 7, "pattern": "purl", "needle": Path("n.toml"), "tight": True, "budget_s": 5.0}
    assert seen["options"] == options and Knitting(**seen["options"]) == Knitting(**options)
    assert Knitting(**run_command(Knitting)["options"]) == Knitting()


def test_the_help_of_a_task_is_made_of_its_options_and_methods(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    run_command(Knitting, "--help")
    text = " ".join(capsys.readouterr().out.split())
    for words in ("Rows of stitches.", "by-hand: slowly; machine: fast", "One of plain, purl.", "--needle-file FILE"):
        assert words in text


def test_an_option_that_every_run_has_is_refused():
    @dataclass(frozen=True)
    class Seeded(Knitting):
        seed: int = option(0, "Mine.")

    @dataclass(frozen=True)
    class Fast(Knitting):
        stitches_per_s: float = option(1.0, "Mine too.", flag="seed")

    for kind, name in ((Seeded, "seed"), (Fast, "stitches_per_s")):
        with pytest.raises(
            TrocarError, match=f"option '{name}' of task 'knitting' is already an option of this command"
        ):
            run_command(kind)


# Methods and perceptions.


def test_a_tasks_own_methods_come_first_and_the_first_is_the_default():
    assert methods_of(Knitting) == ("by-hand", "machine")
    assert pick_method(Knitting, "") is BY_HAND
    assert pick_method(Knitting, "machine") is WITH_A_MACHINE


def test_what_is_lazy_is_loaded_when_it_is_needed():
    context = SimpleNamespace()
    agent = WITH_A_MACHINE.make_agent(context)
    assert type(agent) is Knitter and agent.context is context
    assert WITH_A_MACHINE.make_settings() == Settings()
    never = Method("broken", Lazy("no.such.module:Agent"), Lazy("no.such.module:Settings"))
    with pytest.raises(ModuleNotFoundError, match="no"):
        never.make_agent(context)


def test_a_method_that_is_lazy_itself_is_loaded_when_it_is_picked(monkeypatch):
    monkeypatch.setattr(sys.modules[HERE], "BY_HAND", BY_HAND, raising=False)
    monkeypatch.setattr(Knitting, "methods", {"later": Lazy(f"{HERE}:BY_HAND")})
    assert methods_of(Knitting) == ("later",)
    assert pick_method(Knitting, "later") is BY_HAND


def test_methods_from_outside_are_their_tasks_alone():
    mine = METHODS.register("knitting/mine", Method("mine", Knitter, Settings))
    METHODS.register("weaving/mine", Method("of another task", Knitter, Settings))
    METHODS.register("knitting-fast/other", Method("of yet another", Knitter, Settings))
    assert methods_of(Knitting) == ("by-hand", "machine", "mine")
    assert pick_method(Knitting, "mine") is mine
    assert pick_method(Knitting, "") is BY_HAND


def test_a_method_of_a_misspelt_task_is_named_when_it_is_missed():
    METHODS.register("kniting/mine", BY_HAND)  # before its task, which may yet come
    assert methods_of(Knitting) == ("by-hand", "machine")
    words = "method 'kniting/mine' is of a task that is not registered, 'kniting'; register it as 'knitting/mine'"
    with pytest.raises(InvalidInput, match=words):
        pick_method(Knitting, "mine")
    with pytest.raises(UnknownName):
        pick_method(Knitting, "yours")


def test_perceptions_are_made_anew_whenever_they_are_picked():
    class Fingers:
        pass

    PERCEPTIONS.register("knitting/fingers", Fingers)
    PERCEPTIONS.register("weaving/ears", Fingers)
    assert perceptions_of(Knitting) == ("eyes", "far", "fingers")
    for name, kind in (("eyes", Eyes), ("far", Eyes), ("fingers", Fingers)):
        assert type(pick_perception(Knitting, name)) is kind
        assert pick_perception(Knitting, name) is not pick_perception(Knitting, name)


@pytest.mark.parametrize(
    ("pick", "name", "words"),
    [
        (pick_method, "magic", "knitting method 'magic' is unknown; choose one of by-hand, machine$"),
        (pick_perception, "nose", "knitting perception 'nose' is unknown; choose one of eyes, far$"),
        (pick_perception, "", "knitting perception '' is unknown; choose one of eyes, far$"),
    ],
)
def test_what_there_is_not_is_said_with_what_there_is(pick, name, words):
    with pytest.raises(TrocarError, match=words):
        pick(Knitting, name)


@dataclass(frozen=True)
class Motion:
    """Settings inside others."""

    limit_share: float = 0.5


@dataclass(frozen=True)
class ManySettings:
    """One of each kind."""

    wait_s: float = 0.1
    looks: int = 2
    sure: bool = False
    word: str = "plain"
    offset_m: tuple = (0.0, 0.0)
    motion: Motion = Motion()


MANY = Method("many settings", Knitter, ManySettings)


def test_settings_are_listed_and_set_in_the_type_of_their_defaults():
    names = ["wait_s", "looks", "sure", "word", "offset_m", "motion.limit_share"]
    assert [name for name, _ in listed_settings(MANY.make_settings())] == names
    changes = ("wait_s=.2", "looks=5", "sure=true", "word=a=b", "offset_m=1, 2e-3", "motion.limit_share=1")
    assert MANY.make_settings(changes) == ManySettings(0.2, 5, True, "a=b", (1.0, 0.002), Motion(1.0))
    assert MANY.make_settings() == ManySettings()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("wait_s", "has no value; give NAME=VALUE"),
        ("wait=.2", r"setting 'wait' is unknown; did you mean 'wait_s'\? choose one of wait_s, looks, "),
        ("motion.share=1", "setting 'motion.share' is unknown"),
        ("wait_s.more=1", "setting 'wait_s.more' is unknown"),
        ("wait_s=soon", "setting 'wait_s' is 'soon'; give a number"),
        ("wait_s=inf", "is 'inf'; give a number"),
        ("looks=1.5", "is '1.5'; give a whole number"),
        ("sure=yes", "give true or false"),
        ("offset_m=1", "give 2 numbers with commas"),
        ("motion=1", "setting 'motion' is Motion; it cannot be set"),
    ],
)
def test_a_setting_that_cannot_be_is_refused(change, words):
    with pytest.raises(InvalidInput, match=words):
        MANY.make_settings([change])


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (lambda: Method("by hand", None), "the agent of method 'by hand' is None; give a class or a Lazy"),
        (lambda: Method("by hand", Knitter, 3), "the settings of method 'by hand' is 3"),
        (lambda: Method("by hand", Knitter, calibrated=True, learns=True), "is both calibrated and learns"),
        (lambda: METHODS.register("knitting/x", Knitter), r"method 'knitting/x' is .*; register a trocar.eval.Method"),
        (lambda: METHODS.register("x", BY_HAND), "method 'x' names no task; register it as TASK/x"),
        (lambda: METHODS.register("knitting/", BY_HAND), "method 'knitting/' names no task; register it as TASK/"),
        (lambda: PERCEPTIONS.register("/x", Eyes), "perception '/x' names no task; register it as TASK/x"),
        (lambda: PERCEPTIONS.register("knitting/x", 3), "perception 'knitting/x' is 3; register a class"),
    ],
)
def test_what_cannot_be_used_is_refused_when_it_is_registered(made, words):
    with pytest.raises(InvalidInput, match=words):
        made()


def test_a_task_without_perceptions_says_none():
    class Blind(Knitting):
        perceptions: ClassVar = {}

    with pytest.raises(TrocarError, match=r"knitting perception 'eyes' is unknown; there are none$"):
        pick_perception(Blind, "eyes")


def test_a_file_of_ones_own_adds_methods_and_perceptions(tmp_path):
    plugin = tmp_path / "looms.py"
    plugin.write_text(
        "from trocar.eval import METHODS, PERCEPTIONS, Method\n"
        "class Loom:\n    def __init__(self, context): self.context = context\n"
        "METHODS.register('knitting/loom', Method('with a loom', Loom, dict, perception='touch'))\n"
        "class Touch: pass\n"
        "PERCEPTIONS.register('knitting/touch', Touch)\n"
    )
    digest = load_plugin(plugin)
    assert load_plugin(plugin) == digest  # a second time changes nothing
    method = pick_method(Knitting, "loom")
    assert method.about == "with a loom" and type(method.make_agent(SimpleNamespace())).__name__ == "Loom"
    assert type(pick_perception(Knitting, method.perception)).__name__ == "Touch"


# One arm as a script uses it.


def test_a_script_waits_moves_and_computes_and_all_of_it_is_noted():
    lab = ideal_laboratory(standing(0))
    seen = {}

    async def script(cell):
        hand = ArmScript(cell, "psm1", settle_s=0.07)
        home = hand.q
        assert np.array_equal(home, cell.robot.setpoint("psm1").q) and hand.model is cell.arms["psm1"]
        execution = await hand.go(home + 0.05)
        seen["went"] = np.abs(hand.q - home - 0.05).max(), execution.done
        await hand.jaw(0.5)
        seen["jaw"] = hand.jaw_rad
        await hand.settle()
        seen["found"] = await hand.compute("planning", 0.1, lambda: 42)

    assert lab.run(script, 30.0)
    assert seen["went"][0] < 1e-9 and seen["went"][1]
    assert seen["jaw"] == pytest.approx(0.5, abs=0.02) and seen["found"] == 42
    assert [(span.arm, span.name) for span in lab.log.spans] == [
        ("psm1", name) for name in ("motion", "jaw", "settling", "planning")
    ]
    lengths = [span.end_s - span.start_s for span in lab.log.spans]
    assert lengths[2:] == [pytest.approx(0.07, abs=0.011), pytest.approx(0.1, abs=0.011)]
    assert lab.log.computations[0].name == "planning"
    assert max(lab.driver.limit_use("psm1")) <= 1.0 + 1e-3


def test_waking_swings_the_wrist_both_ways_and_ends_where_it_began():
    lab = ideal_laboratory(standing(0))

    async def script(cell):
        await ArmScript(cell, "psm1", settle_s=0.0).exercise_wrist()

    assert lab.run(script, 30.0)
    q = lab.recorder.joints("commanded")["psm1"][:, :6]
    assert np.abs(q[-1] - q[0]).max() < 1e-9
    assert np.abs(q[:, :3] - q[0, :3]).max() < 1e-12
    for joint, swing in zip((3, 4, 5), EXERCISE_RAD, strict=True):
        off = q[:, joint] - q[0, joint]
        assert (off.max(), off.min()) == (pytest.approx(swing, abs=1e-3), pytest.approx(-swing, abs=1e-3))


@pytest.mark.parametrize("off_rad", [1e-9, 0.02, 0.03, 0.07, 0.12, 0.2])
def test_a_wrist_that_was_left_near_the_ends_of_its_range_swings_as_far_within_it(off_rad):
    lab, model = ideal_laboratory(standing(0)), ARMS["psm-classic"]
    left = np.concatenate([model.middle[:3], model.upper[3:5] - off_rad, model.lower[5:] + off_rad])

    async def script(cell):
        arm = ArmScript(cell, "psm1", settle_s=0.0)
        await arm.go(left)
        await arm.exercise_wrist()

    assert lab.run(script, 30.0)
    q = lab.recorder.joints("commanded")["psm1"][:, :6]
    assert np.abs(q[-1] - left).max() < 2e-6
    arrived = int(np.flatnonzero(np.abs(q - left).max(axis=1) < 1e-6)[0])
    assert np.ptp(q[arrived:, 3:], axis=0) == pytest.approx(2.0 * np.array(EXERCISE_RAD), abs=1e-3)


class OffRobot:
    """A robot whose jaws' encoders are off, and may be stuck at an opening."""

    def __init__(self, inner, off_rad, stuck_rad=None):
        self.inner, self.off_rad, self.stuck_rad = inner, off_rad, stuck_rad

    def __getattr__(self, name):
        return getattr(self.inner, name)

    def read(self, arm):
        reading = self.inner.read(arm)
        return replace(reading, jaw_rad=reading.jaw_rad + self.off_rad)

    async def jaw(self, arm, angle_rad):
        return await self.inner.jaw(arm, (angle_rad if self.stuck_rad is None else self.stuck_rad) - self.off_rad)


@pytest.mark.parametrize(
    ("off_rad", "stuck_rad", "zero_rad"), [(0.06, None, 0.06), (-0.04, None, -0.04), (0.0, 0.4, 0.0)]
)
def test_jaws_are_counted_from_where_they_are_closed(off_rad, stuck_rad, zero_rad):
    lab, seen = ideal_laboratory(standing(0)), {}

    async def script(cell):
        robot = OffRobot(cell.robot, off_rad, stuck_rad)
        hand = ArmScript(replace(cell, robot=robot), "psm1", settle_s=0.0)
        await hand.zero_jaw(-0.17)
        seen["zero"] = hand.jaw_zero_rad
        robot.stuck_rad = None
        await hand.jaw(0.5)
        seen["told"], seen["true"] = hand.jaw_rad, lab.world.jaw_rad("psm1")

    assert lab.run(script, 30.0)
    assert seen["zero"] == pytest.approx(zero_rad, abs=1e-3), "jaws that are held open have no zero"
    assert seen["told"] == pytest.approx(0.5, abs=0.02) and seen["true"] == pytest.approx(0.5, abs=0.02)


def test_a_script_for_an_arm_that_is_not_there_is_refused():
    lab = ideal_laboratory(standing(0))
    with pytest.raises(TrocarError, match=r"arm 'psm9' is unknown; .*choose one of psm1, psm2"):
        ArmScript(lab.cell, "psm9", 0.0)
