"""What a person at a console may do to a cell, without a page."""

from dataclasses import replace

import numpy as np
import pytest
import trio

from driven import ARM, HOME, PAPER, PlainArms
from trocar.arms import fk
from trocar.cell import SEAT, Cell, GoalOffer
from trocar.console import Console
from trocar.console.hand import CLOSED_RAD
from trocar.errors import EmergencyStop, TooNear
from trocar.geometry import SE3, SO3
from trocar.log import CellLog
from trocar.motion import rest_to_rest
from trocar.robots import ArmGuard, Guarded
from trocar.robots.concurrency import cause_of
from trocar.robots.supervised import Vetoed
from trocar.sim.laboratory import SimClock
from trocar.view.wishes import Held, Level, Said, Wish

GOAL = HOME + np.array([0.4, 0.3, -0.05, 0.8, 0.5, -0.6])
MOTION = rest_to_rest(HOME, GOAL, PAPER).stretched(2.0)
LIMITS = {"a": PAPER}


class Desk:
    """Plain arms with a console, whose person says things at times of the cell's clock."""

    def __init__(self, plan=(), level=Level.AUTONOMOUS, stopped=False):
        self.arms, self.plan = PlainArms(), sorted(plan, key=lambda one: one[0])
        guard = Guarded(self.arms.driver, {"a": ArmGuard(ARM, PAPER)})
        self.log = CellLog(self.arms.now_s)
        base = {"a": SE3.identity()}
        self.cell = Cell(guard, {}, {"a": ARM}, LIMITS, base, {}, {}, SimClock(self.arms.now_s), self.log)
        self.console = Console(level, noun="goal", hear=self._said, stopped=stopped)
        self.robot = self.arms.robot = self.console.supervise(self.cell)
        self.arms.each_tick += [guard.check, self.console._listen]

    def monotonic(self):
        return self.arms.now_s()

    def _said(self):
        due = [said for at, said in self.plan if at <= self.arms.now_s()]
        self.plan = self.plan[len(due) :]
        return [said() if callable(said) else said for said in due]

    def run(self, script):
        async def both():
            async with trio.open_nursery() as nursery:
                nursery.start_soon(self.console.serve, self.cell)
                result = await script()
                nursery.cancel_scope.cancel()
                return result

        try:
            return self.arms.run(both)
        except BaseExceptionGroup as group:
            raise cause_of(group) from None

    def move(self):
        return self.run(lambda: self.robot.move({"a": MOTION}))

    def work(self):
        """Let the person do the whole task; return how far (3,) the tip was moved."""
        before_m = self.tip().translation_m
        self.run(lambda: self.console.work(self.cell, ["a"]))
        return self.tip().translation_m - before_m

    def each_tick(self, what):
        """Return the list of what is so at each tick from now on."""
        seen = []
        self.arms.each_tick.append(lambda: seen.append(what()))
        return seen

    def told(self):
        return self.each_tick(lambda: self.console.standing)

    def tip(self):
        return fk(ARM, self.arms.driver.setpoint("a").q)

    def events(self, name):
        return [event for event in self.log.events if event["name"] == name]


def at(T, *more):
    return Said(Wish.HOLD, "a", Held(T.translation_m, T.rotation.as_quaternion()), *more)


def test_a_stopped_arm_goes_on_when_the_person_says_so():
    desk = Desk([(0.5, Said(Wish.STOP)), (3.0, Said(Wish.GO_ON))])
    assert desk.move()["a"].done
    np.testing.assert_allclose(desk.arms.sent["a"][-1], GOAL, atol=1e-9)
    assert desk.arms.now_s() > 3.0 and [event["wish"] for event in desk.events("person")] == ["STOP", "GO_ON"]


@pytest.mark.parametrize("seed", range(100))
def test_an_emergency_stop_at_any_time_brakes_within_limits_and_ends_the_trial(seed):
    rng = np.random.default_rng(seed)
    stop_s = rng.uniform(0, MOTION.duration_s)
    desk = Desk([(stop_s, Said(Wish.EMERGENCY))])
    with pytest.raises(EmergencyStop, match="emergency stop"):
        desk.move()
    velocity, acceleration = desk.arms.use("a")
    assert velocity <= 1.001 and acceleration <= 1.001
    still = np.flatnonzero(np.abs(np.diff(np.array(desk.arms.sent["a"]), axis=0)).max(1) > 1e-12).max(initial=0)
    braking_s = np.max(PAPER.velocity / PAPER.acceleration)
    assert still * 0.002 <= stop_s + 0.1 + braking_s


def test_a_motion_waits_for_a_yes():
    desk = Desk([(1.0, Said(Wish.YES))], Level.MOTIONS)
    assert desk.move()["a"].done
    assert desk.arms.now_s() == pytest.approx(1.0 + MOTION.duration_s, abs=0.05)


def test_a_yes_counts_for_the_motion_that_was_shown_and_for_no_later_one():
    second_s = 1.0 + MOTION.duration_s + 0.5  # the next motion waits by then
    plan = [(1.0, Said(Wish.YES, value=1)), (second_s, Said(Wish.YES, value=1)), (9.0, Said(Wish.YES, value=2))]
    desk = Desk(plan, Level.MOTIONS)

    async def script():
        await desk.robot.move({"a": MOTION})
        await desk.robot.move({"a": rest_to_rest(GOAL, HOME, PAPER)})

    desk.run(script)
    assert second_s < 8.0 and desk.arms.now_s() > 9.0


def test_a_motion_to_which_the_person_says_no_does_not_begin_and_its_script_may_try_another():
    plan = [(0.5, Said(Wish.NO, value=7)), (1.0, Said(Wish.NO, value=1)), (2.0, Said(Wish.YES, value=2))]
    desk = Desk(plan, Level.MOTIONS)
    refused = []

    async def script():
        try:
            await desk.robot.move({"a": MOTION})
        except Vetoed as error:
            refused.append((error.arm, desk.arms.now_s(), desk.robot.running, desk.robot.setpoint("a").q))
        return await desk.robot.move({"a": MOTION})

    assert desk.run(script)["a"].done
    (arm, at_s, running, q), *more = refused
    assert not more and arm == "a" and at_s == pytest.approx(1.0, abs=0.01) and not running
    np.testing.assert_array_equal(q, HOME)
    assert [event["wish"] for event in desk.events("person")] == ["NO", "YES"]


def test_what_is_left_of_a_stopped_motion_can_only_be_let_go_on():
    plan = [(0.5, Said(Wish.YES)), (1.0, Said(Wish.STOP)), (2.0, Said(Wish.GO_ON)), (3.0, Said(Wish.NO))]
    desk = Desk([*plan, (4.0, Said(Wish.YES))], Level.MOTIONS)
    standing = desk.told()
    assert desk.move()["a"].done and desk.arms.now_s() > 4.0
    assert {now.may_refuse for now in standing if now.asks and now.question == 2} == {False}
    assert {now.may_refuse for now in standing if now.asks and now.question == 1} == {True}


def test_arms_that_were_stopped_in_one_trial_stay_stopped_in_the_next():
    desk = Desk([(2.0, Said(Wish.GO_ON))], stopped=True)
    assert desk.move()["a"].done
    assert desk.arms.now_s() == pytest.approx(2.0 + MOTION.duration_s, abs=0.05)


def test_a_goal_waits_for_one_yes():
    desk = Desk([(1.0, Said(Wish.YES)), (9.0, Said(Wish.YES))], Level.GOALS)
    back = rest_to_rest(GOAL, HOME, PAPER)

    async def script():
        await desk.robot.move({"a": MOTION})
        await desk.robot.move({"a": back})
        after_first_s = desk.arms.now_s()
        desk.console.note({"name": "goal"})
        await desk.robot.move({"a": rest_to_rest(HOME, GOAL, PAPER)})
        return after_first_s

    after_first_s = desk.run(script)
    assert after_first_s < 1.1 + MOTION.duration_s + back.duration_s and desk.arms.now_s() > 9.0


GOALS = [GoalOffer("a", f"takes block {k}", np.full((3, 3), 0.01 * k)) for k in range(3)]


class Choosing(Desk):
    """A script that chooses a goal, moves there and back, and so on; it notes what was shown and chosen."""

    def __init__(self, plan, level=Level.GOALS, goals=1):
        super().__init__(plan, level)
        self.cell = replace(self.cell, assistants={SEAT: self.console})
        self.shown, self.chosen, self.at_s = [], [], []
        self.count = goals

    def play(self):
        self.arms.each_tick.append(lambda: self.shown.append(self.console.standing))
        return self.run(self._script)

    async def _script(self):
        for _ in range(self.count):
            self.chosen.append(await self.cell.choose(GOALS))
            self.at_s.append(self.arms.now_s())
            await self.robot.move({"a": MOTION})
            await self.robot.move({"a": rest_to_rest(GOAL, HOME, PAPER)})
            self.console.note({"name": "goal"})


def test_a_person_turns_over_the_goals_and_says_yes_to_one():
    plan = [(at_s, Said(Wish.ANOTHER)) for at_s in (0.5, 1.0, 1.5, 2.0)]  # once round, and one further
    desk = Choosing([*plan, (2.5, Said(Wish.YES)), (9.0, Said(Wish.YES))], goals=2)
    desk.play()
    assert desk.chosen == [1, 0] and desk.at_s == pytest.approx([2.5, 9.0], abs=0.05)
    asked = [now for now in desk.shown if now.asks]
    words = list(dict.fromkeys(now.words for now in asked))
    assert words == [f"Waits for your yes: a takes block {k} ({k + 1} of 3)" for k in range(3)]
    assert {now.choices for now in asked} == {3}
    for now in asked:
        number = int(now.words.split("block ")[1][0])
        np.testing.assert_allclose(now.ghosts["a"].path_m, GOALS[number].path_world_m)
        np.testing.assert_allclose(now.ghosts["a"].q, desk.arms.sent["a"][0], atol=1e-9)
    assert [event["wish"] for event in desk.events("person")] == ["ANOTHER"] * 4 + ["YES"] * 2


def test_a_yes_to_a_goal_that_is_no_longer_shown_does_not_count():
    plan = [(0.5, Said(Wish.ANOTHER, value=1)), (0.6, Said(Wish.YES, value=1)), (0.7, Said(Wish.ANOTHER, value=1))]
    desk = Choosing([*plan, (3.0, Said(Wish.YES, value=2))])
    desk.play()
    assert desk.chosen == [1] and desk.at_s == pytest.approx([3.0], abs=0.05)


def test_a_goal_that_was_chosen_is_not_asked_about_again_unless_each_motion_is():
    desk = Choosing([(1.0, Said(Wish.YES))])
    desk.play()
    assert not any(now.asks for now in desk.shown[round(1.05 / 0.002) :])
    each = Choosing([(1.0, Said(Wish.YES)), (3.0, Said(Wish.YES)), (9.0, Said(Wish.YES))], Level.MOTIONS)
    each.play()
    assert each.arms.now_s() > 9.0 and {now.choices for now in each.shown if now.asks} == {3, 1}


def test_a_script_that_is_trusted_takes_its_own_first_goal():
    desk = Choosing([], Level.AUTONOMOUS)
    desk.play()
    assert desk.chosen == [0] and not any(now.asks for now in desk.shown)


def test_the_goal_that_is_shown_counts_once_the_script_is_trusted_and_goes_on_waiting_until_then():
    plan = [
        (0.5, Said(Wish.ANOTHER)),
        (1.0, Said(Wish.LEVEL, value=Level.GOALS)),
        (3.0, Said(Wish.LEVEL, value=Level.AUTONOMOUS)),
    ]
    desk = Choosing(plan, Level.MOTIONS)
    desk.play()
    assert desk.chosen == [1] and desk.at_s == pytest.approx([3.0], abs=0.05)


def test_a_wish_for_another_goal_changes_nothing_where_there_is_no_choice():
    desk = Desk([(0.5, Said(Wish.ANOTHER, value=1)), (1.0, Said(Wish.YES, value=1))], Level.MOTIONS)
    told = desk.told()
    assert desk.move()["a"].done
    assert {now.choices for now in told} == {1} and desk.arms.now_s() < 1.2 + MOTION.duration_s


def test_a_script_that_is_cancelled_asks_no_more():
    desk = Desk([], Level.MOTIONS)

    async def script():
        with trio.move_on_after(0.3):
            await desk.robot.move({"a": MOTION})
        return desk.console.standing, desk.console._stands

    standing, stands = desk.run(script)
    assert not standing.asks and not stands, "the clock would stand for ever"


def test_nothing_is_asked_any_more_once_the_script_is_trusted():
    desk = Desk([(1.0, Said(Wish.LEVEL, value=Level.AUTONOMOUS))], Level.MOTIONS)
    assert desk.move()["a"].done


SHIFT = SE3.from_parts(translation_m=[0.004, -0.003, 0.002])


def test_an_arm_that_is_taken_over_follows_the_hand_and_comes_back():
    seen = {}
    handle = SE3.from_parts(translation_m=[1.0, 2.0, 3.0])  # wherever the input is: only its motion counts

    def note(name):
        def say():
            seen[name] = desk.tip()
            return Said(Wish.JAW, "nobody")

        return say

    plan = [
        (0.3, Said(Wish.TAKE, "a")),
        (2.0, note("taken")),
        (2.0, at(handle)),
        (2.1, note("clutched")),
        (2.2, at(SHIFT @ handle)),
        (3.2, note("moved")),
        (3.3, Said(Wish.RELEASE, "a")),
        (3.6, at(SE3.identity())),
        (3.8, note("clutched again")),
        (3.9, Said(Wish.RELEASE, "a")),
        (4.0, Said(Wish.RETURN, "a")),
    ]
    desk = Desk(plan)
    assert desk.move()["a"].done
    np.testing.assert_allclose(desk.arms.sent["a"][-1], GOAL, atol=1e-9)
    for before, after in (("taken", "clutched"), ("moved", "clutched again")):
        np.testing.assert_allclose(seen[before].matrix, seen[after].matrix, atol=1e-9)
    moved = seen["moved"].translation_m - seen["taken"].translation_m
    np.testing.assert_allclose(moved, SHIFT.translation_m, atol=1e-6)
    assert max(desk.arms.use("a")) <= 1.001
    assert len(desk.events("handed back")) == 1 and len(desk.console.latencies_s) == 3


def test_while_an_arm_is_lent_its_last_motion_tells_nothing_and_afterwards_all_that_it_told_before():
    desk = Desk(
        [(3.0, Said(Wish.TAKE, "a")), (4.0, at(SE3.identity())), (4.1, at(SHIFT)), (6.0, Said(Wish.RETURN, "a"))]
    )
    seen = desk.each_tick(lambda: desk.robot.setpoint("a"))

    async def script():
        await desk.robot.move({"a": MOTION})
        before = desk.robot.setpoint("a")
        await trio.sleep(8.0)
        return before, desk.robot.setpoint("a")

    before, after = desk.run(script)
    away = [one for one in seen if 4.5 < one.time_s < 6.0]
    assert away and not any(one.on_path for one in away) and {one.path_s for one in away} == {before.path_s}
    np.testing.assert_allclose(after.q, before.q, atol=1e-9)
    assert (after.path_s, after.on_path, after.moving) == (before.path_s, before.on_path, False)
    assert len(desk.events("handed back")) == 1


def test_an_arm_that_is_taken_again_while_its_jaws_return_comes_into_the_persons_hands_again():
    desk = Desk([(1.0, Said(Wish.TAKE, "a")), (2.0, Said(Wish.JAW, "a", 1.0)), (4.0, Said(Wish.RETURN, "a"))])
    again = []

    def take_again():
        if desk.console._lending._returned and not again:
            again.append(desk.arms.now_s())
            desk.plan = [(again[0], Said(Wish.TAKE, "a")), (again[0] + 2.0, Said(Wish.RETURN, "a"))]

    desk.arms.each_tick.append(take_again)

    async def script():
        await desk.robot.jaw("a", 0.1)
        await desk.robot.move({"a": MOTION})

    desk.run(script)
    taken, back = desk.events("taken over"), desk.events("handed back")
    assert len(taken) == len(back) == 2 and again[0] < taken[1]["time_s"] < back[1]["time_s"] - 1.5
    np.testing.assert_allclose(desk.arms.sent["a"][-1], GOAL, atol=1e-9)


def test_an_arm_that_is_stopped_on_its_way_back_stays_in_the_persons_hands():
    plan = [
        (0.1, Said(Wish.TAKE, "a")),
        (1.0, at(SE3.identity())),
        (1.1, at(SE3.from_parts(translation_m=[0.02, 0.0, 0.0]))),
        (3.0, Said(Wish.RETURN, "a")),
        (3.2, Said(Wish.STOP)),
        (4.0, Said(Wish.RETURN, "a")),
        (5.0, Said(Wish.GO_ON)),
        (6.0, Said(Wish.RETURN, "a")),
    ]
    desk = Desk(plan)
    still = desk.each_tick(lambda: (desk.arms.now_s(), desk.tip().translation_m))
    assert desk.move()["a"].done
    (back,) = desk.events("handed back")
    assert back["time_s"] > 6.0 and max(desk.arms.use("a")) <= 1.001
    stopped = np.array([p for now_s, p in still if 3.8 < now_s < 5.9])
    np.testing.assert_allclose(stopped, np.tile(stopped[0], (len(stopped), 1)), atol=1e-12)
    np.testing.assert_allclose(desk.arms.sent["a"][-1], GOAL, atol=1e-9)
    home_m = still[5][1]
    away = [np.linalg.norm(p - home_m) for now_s, p in still if 6.0 < now_s < back["time_s"]]
    assert max(np.diff(away)) < 1e-6, "it goes back, and not out again first"


def test_an_arm_that_is_stopped_as_it_is_handed_back_does_not_move():
    plan = [
        (0.1, Said(Wish.TAKE, "a")),
        (1.0, at(SE3.identity())),
        (1.1, at(SHIFT)),
        (3.0, Said(Wish.RETURN, "a")),
        (3.0, Said(Wish.STOP)),
        (5.0, Said(Wish.GO_ON)),
        (6.0, Said(Wish.RETURN, "a")),
    ]
    desk = Desk(plan)
    tips = desk.each_tick(lambda: (desk.arms.now_s(), desk.tip().translation_m))
    assert desk.move()["a"].done
    stopped = np.array([p for now_s, p in tips if 3.1 < now_s < 5.9])
    np.testing.assert_allclose(stopped, np.tile(stopped[0], (len(stopped), 1)), atol=1e-12)
    (back,) = desk.events("handed back")
    assert back["time_s"] > 6.0


def test_a_way_back_that_is_refused_leaves_the_arm_in_the_persons_hands(monkeypatch):
    plan = [
        (0.1, Said(Wish.TAKE, "a")),
        (1.0, at(SE3.identity())),
        (1.1, at(SHIFT)),
        (2.0, Said(Wish.RETURN, "a")),
        (4.0, Said(Wish.RETURN, "a")),
    ]
    desk = Desk(plan)
    guard, refusals = desk.cell.robot, ["the other arm is in the way"]
    move = guard.move

    async def refusing(motions):
        if refusals and desk.events("taken over"):
            raise TooNear(refusals.pop(), first="a", second="b", distance_m=0.0, required_m=0.001, arms=("a", "b"))
        return await move(motions)

    monkeypatch.setattr(guard, "move", refusing)
    told = desk.told()
    assert desk.move()["a"].done
    assert any("the way back is refused" in now.words for now in told)
    assert desk.events("handed back")[0]["time_s"] > 4.0


def test_where_the_wrist_cannot_turn_any_further_the_tip_follows_in_place():
    turned = SE3.from_parts(SO3.exp(np.array([0.0, 2.5, 0.0])), SHIFT.translation_m)
    desk = Desk([(0.1, at(SE3.identity())), (0.2, at(turned)), (1.8, Said(Wish.RELEASE, "a")), (2.0, Said(Wish.DONE))])
    told = desk.told()
    np.testing.assert_allclose(desk.work(), SHIFT.translation_m, atol=1e-5)
    assert any("turns no further" in now.words for now in told)
    assert "turns no further" not in told[-2].words, "once it was let go"


def test_a_hand_far_outside_the_workspace_moves_nothing_and_is_told():
    far = SE3.from_parts(translation_m=[1e6, 0.0, 0.0])
    desk = Desk([(0.1, at(SE3.identity())), (0.2, at(far)), (0.6, Said(Wish.DONE))])
    start, told = desk.tip(), desk.told()
    desk.work()
    assert any("reach" in now.words or "outside" in now.words for now in told)
    np.testing.assert_allclose(desk.tip().matrix, start.matrix, atol=1e-6)


def test_a_hand_that_asks_too_much_is_slowed_to_the_limits():
    far = SE3.from_parts(translation_m=[0.03, 0.0, 0.0])
    plan = [(0.1, Said(Wish.TAKE, "a")), (1.0, at(SE3.identity())), (1.1, at(far)), (4.0, Said(Wish.EMERGENCY))]
    desk = Desk(plan)
    with pytest.raises(EmergencyStop):
        desk.move()
    assert max(desk.arms.use("a")) <= 1.001


def test_a_page_that_is_gone_lets_go_and_stops_what_it_supervised():
    desk = Desk([(0.1, Said(Wish.TAKE, "a")), (1.0, at(SE3.identity())), (1.2, Said(Wish.LEFT))])

    async def script():
        with trio.move_on_after(3.0):
            await desk.robot.move({"a": MOTION})
        return desk.console.standing

    standing = desk.run(script)
    assert standing.stopped


def test_a_page_that_only_watched_may_go():
    desk = Desk([(0.1, Said(Wish.LEFT))])
    assert desk.move()["a"].done and desk.arms.now_s() < MOTION.duration_s + 0.1
    assert not desk.log.events, "nothing is noted of it"


def test_jaws_close_at_once_and_open_after_a_while():
    plan = [
        (0.1, Said(Wish.TAKE, "a")),
        (1.0, Said(Wish.JAW, "a", 1.0)),
        (1.1, Said(Wish.JAW, "a", 0.0)),
        (2.0, Said(Wish.JAW, "a", 1.0)),
        (3.0, Said(Wish.EMERGENCY)),
    ]
    desk = Desk(plan)
    jaws = desk.each_tick(lambda: (desk.arms.now_s(), desk.arms.driver.jaw_command_rad("a")))
    with pytest.raises(EmergencyStop):
        desk.move()
    times, opening = np.array(jaws).T
    assert opening[times < 1.05].max() <= 0.1 + 1e-9, "a slip opened them"
    assert opening[(times > 1.5) & (times < 2.0)].max() < 0.0, "they did not close"
    assert opening[(times > 2.0) & (times < 2.15)].max() < 0.0 and opening[-1] > 0.5


def test_jaws_that_were_stopped_go_on_to_where_they_were_going():
    plan = [(0.1, Said(Wish.TAKE, "a")), (1.0, Said(Wish.JAW, "a", 1.0)), (1.25, Said(Wish.STOP))]
    desk = Desk([*plan, (2.0, Said(Wish.GO_ON)), (3.0, Said(Wish.EMERGENCY))])
    jaws = desk.each_tick(lambda: (desk.arms.now_s(), desk.arms.driver.jaw_command_rad("a")))
    with pytest.raises(EmergencyStop):
        desk.move()
    times, opening = np.array(jaws).T
    stopped = opening[(times > 1.3) & (times < 2.0)]
    assert 0.1 < stopped.min() == stopped.max() < ARM.jaw.upper - 0.1
    assert opening[-1] == pytest.approx(ARM.jaw.upper)


def test_jaws_close_though_the_script_had_begun_to_close_them():
    desk = Desk([(0.13, Said(Wish.TAKE, "a")), (1.0, Said(Wish.JAW, "a", 0.0)), (2.0, Said(Wish.EMERGENCY))])
    jaws = desk.each_tick(lambda: (desk.arms.now_s(), desk.arms.driver.jaw_command_rad("a")))
    closed_rad = max(ARM.jaw.lower, CLOSED_RAD)

    async def script():
        await trio.sleep(0.1)
        await desk.robot.jaw("a", closed_rad)

    with pytest.raises(EmergencyStop):
        desk.run(script)
    times, opening = np.array(jaws).T
    assert opening[(times > 0.5) & (times < 0.9)].min() > closed_rad + 0.05, "taking over stopped them"
    assert opening[-1] == pytest.approx(closed_rad)


def test_an_arm_is_handed_back_with_its_jaws_where_the_script_had_them_though_it_was_stopped_meanwhile():
    plan = [(0.3, Said(Wish.TAKE, "a")), (1.0, Said(Wish.JAW, "a", 1.0)), (2.0, Said(Wish.RETURN, "a"))]
    desk = Desk([*plan, (2.05, Said(Wish.STOP)), (3.0, Said(Wish.GO_ON))])
    jaws = desk.each_tick(lambda: (desk.arms.now_s(), desk.arms.driver.jaw_command_rad("a")))

    async def script():
        await desk.robot.jaw("a", 0.0)
        return await desk.robot.move({"a": MOTION})

    assert desk.run(script)["a"].done
    times, opening = np.array(jaws).T
    assert opening[(times > 2.2) & (times < 2.9)].min() > 0.1, "not while it was stopped"
    (back,) = desk.events("handed back")
    assert back["time_s"] > 3.0 and opening[times >= back["time_s"]][0] == pytest.approx(0.0)


@pytest.mark.parametrize("asked_s", [1.9, 2.1])
def test_jaws_do_not_open_once_the_arms_are_stopped(asked_s):
    plan = [(0.1, Said(Wish.TAKE, "a")), (asked_s, Said(Wish.JAW, "a", 1.0)), (2.0, Said(Wish.STOP))]
    desk = Desk([*plan, (4.0, Said(Wish.EMERGENCY))])
    with pytest.raises(EmergencyStop):
        desk.move()
    assert desk.arms.driver.jaw_command_rad("a") == pytest.approx(0.1)


def test_jaws_open_though_their_input_trembles_and_a_device_fills_no_log():
    rng = np.random.default_rng(0)
    trembling = [
        (at_s, Said(Wish.JAW, "a", 0.6 + rng.normal(0, 0.01), source="pad")) for at_s in np.arange(1.0, 3.0, 0.02)
    ]
    desk = Desk([(0.1, Said(Wish.TAKE, "a")), *trembling, (3.0, Said(Wish.EMERGENCY))])
    with pytest.raises(EmergencyStop):
        desk.move()
    wide_rad = ARM.jaw.upper
    assert desk.arms.driver.jaw_command_rad("a") == pytest.approx(0.6 * wide_rad, abs=0.04 * wide_rad)
    assert [event["wish"] for event in desk.events("person")] == ["TAKE", "EMERGENCY"]


def test_a_task_that_has_not_begun_cannot_be_done():
    desk = Desk([(1.0, Said(Wish.DONE))])
    desk.console._take_in(Said(Wish.DONE))
    desk.work()
    assert desk.arms.now_s() >= 1.0


def test_the_person_does_the_whole_task():
    desk = Desk([(0.2, at(SE3.identity())), (0.3, at(SHIFT)), (2.0, Said(Wish.DONE))])
    np.testing.assert_allclose(desk.work(), SHIFT.translation_m, atol=1e-6)


def test_what_stands_tells_what_waits():
    desk = Desk([], Level.MOTIONS)
    told = desk.told()

    async def script():
        with trio.move_on_after(0.5):
            await desk.robot.move({"a": MOTION})

    desk.run(script)
    assert told[10].asks and "a moves" in told[10].words
    ghost = told[10].ghosts["a"]
    np.testing.assert_allclose(ghost.path_m[-1], fk(ARM, GOAL).translation_m, atol=1e-9)
    np.testing.assert_allclose(ghost.q, GOAL, atol=1e-9)


def test_the_path_of_a_running_motion_is_shown_and_of_a_stopped_one_its_remainder():
    desk = Desk([(0.5, Said(Wish.STOP)), (2.0, Said(Wish.GO_ON))])
    told = desk.each_tick(lambda: (desk.arms.now_s(), desk.console.standing.paths))

    async def script():
        await desk.robot.move({"a": MOTION})
        await trio.sleep(0.1)

    desk.run(script)
    first, left = (next(paths["a"] for now_s, paths in told if paths and now_s > after_s) for after_s in (0.0, 2.0))
    wanted = [fk(ARM, HOME).translation_m, fk(ARM, GOAL).translation_m]
    np.testing.assert_allclose(first[[0, -1]], wanted, atol=1e-9)
    np.testing.assert_allclose(left[-1], wanted[-1], atol=1e-9)
    assert np.linalg.norm(left[0] - first[0]) > 1e-3
    assert not told[-1][1] and not any(paths for now_s, paths in told if 1.5 < now_s < 1.9)


def test_what_is_shown_as_asked_is_asked():
    desk = Desk([(0.3, Said(Wish.TAKE, "a")), (1.0, Said(Wish.RETURN, "a")), (2.0, Said(Wish.YES))], Level.MOTIONS)
    same = desk.each_tick(lambda: desk.console.standing.asks is desk.console.asks)
    assert desk.move()["a"].done and all(same)


def test_the_log_says_what_the_person_chose():
    desk = Desk([(0.1, Said(Wish.LEVEL, value=Level.MOTIONS)), (1.0, Said(Wish.YES))])

    async def script():
        await trio.sleep(0.5)
        await desk.robot.move({"a": MOTION})

    desk.run(script)
    chosen, yes = desk.events("person")
    assert chosen["level"] == Level.MOTIONS.value and "a moves" in yes["words"]


def test_a_device_that_falls_silent_lets_go(monkeypatch):
    said = [(at_s, at(T, at_s, "pad")) for at_s, T in ((0.1, SE3.identity()), (0.2, SHIFT))]
    desk = Desk([*said, (3.0, Said(Wish.DONE))])
    monkeypatch.setattr("trocar.console.hand.time", desk)  # its machine's clock is the cell's
    held = desk.each_tick(lambda: any(hand.held for hand in desk.console.hands.values()))
    desk.work()
    assert held[30] and not held[60], "an arm is let go .3 s after its device's last word"


def test_of_two_inputs_the_one_that_holds_an_arm_is_followed():
    plan = [
        (0.1, at(SE3.identity())),
        (0.2, at(SE3.from_parts(translation_m=[1.0, 1.0, 1.0]), 0.0, "pad")),
        (0.3, at(SHIFT)),
        (2.0, Said(Wish.DONE)),
    ]
    np.testing.assert_allclose(Desk(plan).work(), SHIFT.translation_m, atol=1e-6)


def test_another_scale_or_orientation_within_one_hold_moves_nothing():
    turned = SO3.exp(np.array([0.0, 0.3, 0.9])).as_quaternion()
    then = Held(SHIFT.translation_m, SO3.exp(np.zeros(3)).as_quaternion(), turns=False)
    holds = [then._replace(position_m=np.zeros(3)), then, then._replace(scale=3.0, turns=True, wxyz=turned)]
    desk = Desk(
        [(0.1 + 0.7 * k, Said(Wish.HOLD, "a", held)) for k, held in enumerate(holds)] + [(3.0, Said(Wish.DONE))]
    )
    start = desk.tip()
    np.testing.assert_allclose(desk.work(), SHIFT.translation_m, atol=1e-6)
    np.testing.assert_allclose(desk.tip().rotation.matrix, start.rotation.matrix, atol=1e-6)


def test_a_scaled_hand_moves_the_tip_less_and_a_locked_one_does_not_turn_it():
    turned = SE3.from_parts(SO3.exp(np.array([0.0, 0.0, 0.2])), SHIFT.translation_m)
    holds = [Held(T.translation_m, T.rotation.as_quaternion(), 0.5, turns=False) for T in (SE3.identity(), turned)]
    desk = Desk(
        [(0.1 + 0.1 * k, Said(Wish.HOLD, "a", held)) for k, held in enumerate(holds)] + [(2.0, Said(Wish.DONE))]
    )
    start = desk.tip()
    np.testing.assert_allclose(desk.work(), 0.5 * SHIFT.translation_m, atol=1e-6)
    np.testing.assert_allclose(desk.tip().rotation.matrix, start.rotation.matrix, atol=1e-6)
