"""How scripts run in a simulated laboratory, and how a run ends: in time, too late, by failure, by Ctrl-C."""

import math
import signal
import threading
import time
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
import trio

from simulated import ARM_MODELS, PAPER, STATION, ideal_laboratory, ideal_session, joints_at, standing
from trocar.cell import MotionEnd
from trocar.errors import TrocarError
from trocar.log import Span
from trocar.motion import rest_to_rest
from trocar.robots import TICK_S
from trocar.sim.laboratory import SimLaboratory
from trocar.sim.pace import RealTime
from trocar.sim.spec import Surface
from trocar.sim.world import PhysicsError, TaskWorld
from trocar.trajectory import Trajectory

ARMS = ("psm1", "psm2")
PATIENCE_S = 60.0
"""What waits for longer on the wall's clock waits for ever."""


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """MuJoCo writes its warnings into a file of the working directory."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def lab():
    return ideal_laboratory(standing(0))


def motion_of(cell, arm, stretch=3.0):
    goal = joints_at(arm, {"psm1": (-0.02, 0.0, 0.07), "psm2": (-0.06, 0.0, 0.07)}[arm])
    return rest_to_rest(cell.robot.setpoint(arm).q, goal, PAPER).stretched(stretch)


async def move_both(cell, stretch=1.0):
    await cell.robot.move({arm: motion_of(cell, arm, stretch) for arm in ARMS})


async def sleep(cell):
    await cell.clock.sleep(0.5)


def assert_at_rest_within_limits(lab):
    """Both arms moved, braked within their limits on the cell's clock, and rest where they are told to."""
    asked, times = lab.recorder.joints("commanded"), lab.record().times_s
    assert np.array_equal(times, TICK_S * np.arange(len(times))) and times[-1] == lab.now_s()
    for arm in ARMS:
        at = lab.cell.robot.setpoint(arm)
        assert not at.moving and not at.velocity.any()
        assert np.array_equal(asked[arm][-1, :6], at.q)
        assert max(lab.driver.limit_use(arm)) <= 1.0 + 1e-3
        speed = np.diff(asked[arm][:, :6], axis=0) / TICK_S
        assert (np.abs(speed) <= PAPER.velocity * (1 + 1e-6)).all()
        push = np.diff(speed, axis=0, prepend=np.zeros((1, 6)), append=np.zeros((1, 6))) / TICK_S
        assert (np.abs(push) <= PAPER.acceleration * (1 + 1e-3)).all()
        assert np.abs(asked[arm][-1, :6] - asked[arm][0, :6]).max() > 1e-2, "it never moved"


def assert_holding(lab):
    """Both arms stay where they are, however long one waits."""
    before = {arm: lab.cell.robot.read(arm).q for arm in ARMS}
    assert lab.run(sleep, 5.0)
    for arm, q in before.items():
        assert np.array_equal(lab.cell.robot.read(arm).q, q)
        assert np.abs(lab.world.joints(arm) - q).max() < 1e-3


def test_the_clock_is_the_physics(lab):
    async def script(cell):
        await trio.sleep(0.37)
        assert trio.current_time() == pytest.approx(lab.world.time_s, abs=1e-9)
        assert cell.clock.now_s() == lab.world.time_s

    assert lab.run(script, 5.0)
    assert lab.now_s() == pytest.approx(0.37, abs=0.011)


def test_a_script_that_does_nothing_takes_no_time(lab):
    async def script(cell):
        del cell

    assert lab.run(script, 1.0)
    assert lab.now_s() == 0.0 and len(lab.record().times_s) == 1


def test_the_record_has_no_gap_and_no_repeat_over_several_scripts(lab):
    assert lab.run(sleep, 5.0)
    assert lab.run(sleep, 0.6), "its budget is its own"
    assert lab.now_s() == pytest.approx(1.0, abs=0.021)
    lab.run(move_both, 0.3)
    lab.run(sleep, 5.0)
    record = lab.record()
    assert np.array_equal(record.times_s, TICK_S * np.arange(len(record.times_s)))
    assert record.times_s[-1] == lab.now_s() > 1.8
    rows = {len(rows) for rows in lab.recorder.arrays().values()} | {len(lab.truth().held)}
    assert rows == {len(record.times_s)}


# How a run ends.


async def cancelled(cell):
    with trio.move_on_after(0.4):
        await move_both(cell)


async def soon(function, *args):
    await trio.sleep(0.4)
    function(*args)


def fail(error):
    raise error


def beside_motions(function, *args):
    """Return a script that does something .4 s after its motions have begun; another one that does so by itself."""

    async def script(cell):
        async with trio.open_nursery() as nursery:
            nursery.start_soon(move_both, cell)
            await soon(function, *args)

    async def sibling(cell):
        async with trio.open_nursery() as nursery:
            nursery.start_soon(soon, function, *args)
            await move_both(cell)

    return script, sibling


failing_by_itself, beside_one_that_fails = beside_motions(fail, ZeroDivisionError("of a script"))
interrupted_by_itself, _ = beside_motions(fail, KeyboardInterrupt())
_, interrupted_by_ctrl_c = beside_motions(signal.raise_signal, signal.SIGINT)


async def interrupted_while_it_computes(cell):
    async with trio.open_nursery() as nursery:
        nursery.start_soon(move_both, cell)
        await trio.sleep(0.4)
        await cell.compute("psm1", "planning", lambda: signal.raise_signal(signal.SIGINT), 0.1)


@pytest.mark.parametrize(
    ("script", "budget_s", "raised"),
    [
        (cancelled, 10.0, None),
        (move_both, 0.4, None),
        (beside_one_that_fails, 10.0, ZeroDivisionError),
        (failing_by_itself, 10.0, ZeroDivisionError),
        (interrupted_by_itself, 10.0, KeyboardInterrupt),
        (interrupted_by_ctrl_c, 10.0, KeyboardInterrupt),
        (interrupted_while_it_computes, 10.0, KeyboardInterrupt),
    ],
)
def test_however_a_script_ends_both_arms_come_to_rest_within_their_limits_first(lab, script, budget_s, raised):
    if raised is None:
        assert lab.run(script, budget_s) == (script is cancelled)
    else:
        with pytest.raises(raised, match="of a script" if raised is ZeroDivisionError else None):
            lab.run(script, budget_s)
    assert 0.4 < lab.now_s() < 1.0, "coming to rest takes time on the cell's clock, and not for ever"
    assert_at_rest_within_limits(lab)
    assert_holding(lab)


def test_ctrl_c_in_the_middle_of_a_tick_waits_for_the_tick(lab):
    """Else the physics would stop half-way, and nobody be there to bring the arms to rest."""

    def interrupted(time_s):
        if time_s == pytest.approx(0.4):
            signal.raise_signal(signal.SIGINT)

    lab.task.observe, observe = lambda time_s: (observe(time_s), interrupted(time_s)), lab.task.observe
    with pytest.raises(KeyboardInterrupt):
        lab.run(move_both, 10.0)
    assert 0.4 < lab.now_s() < 1.0
    assert_at_rest_within_limits(lab)


def test_arms_that_a_script_left_moving_come_to_rest_too(lab):
    async def script(cell):
        async with trio.open_nursery() as nursery:
            nursery.start_soon(move_both, cell)
            await trio.sleep(0.4)
            nursery.cancel_scope.cancel()
        lab.start_soon(move_both)
        await trio.sleep(0.4)

    assert lab.run(script, 10.0)
    assert_at_rest_within_limits(lab)


def test_an_interruption_comes_out_as_one_even_beside_another_failure(lab):
    async def raises(error):
        raise error

    async def script(cell):
        del cell
        async with trio.open_nursery() as nursery:
            for error in (ValueError("beside it"), KeyboardInterrupt(), ValueError("beside it")):
                nursery.start_soon(raises, error)

    with pytest.raises(KeyboardInterrupt):
        lab.run(script, 10.0)


# What breaks.


def in_time(function):
    """Return what a function returns or raises, from a thread that may not take for ever."""
    found = []

    def call():
        try:
            found.append(function())
        except BaseException as error:
            found.append(error)

    thread = threading.Thread(target=call, daemon=True)
    thread.start()
    thread.join(PATIENCE_S)
    assert not thread.is_alive(), "somebody waits for ever"
    return found[0]


def explode(lab, how):
    data = lab.world.data
    if how == "force":
        data.qfrc_applied[0] = 1e300
    else:
        getattr(data, how)[0] = np.nan


async def jaws(cell):
    await cell.robot.jaw("psm1", 1.3)


async def rests(cell):
    async with trio.open_nursery() as nursery:
        nursery.start_soon(move_both, cell)
        await trio.sleep(0.05)
        await cell.robot.rest()


async def captures(cell):
    while True:
        await cell.cameras["overhead"].capture()


async def tidies_up(cell):
    try:
        await trio.sleep_forever()
    finally:
        with trio.CancelScope(shield=True):
            assert (await cell.robot.jaw("psm1", 0.2)).ended is MotionEnd.FAULT
            executions = await cell.robot.move({"psm1": motion_of(cell, "psm1")})
            assert executions["psm1"].ended is MotionEnd.FAULT and "unstable" in executions["psm1"].reason
            await cell.clock.sleep(0.3)
            cell.log.event("tidied up")


async def shielded(cell):
    with trio.CancelScope(shield=True):
        async with trio.open_nursery() as nursery:
            nursery.start_soon(cell.robot.jaw, "psm2", 1.3)
            nursery.start_soon(cell.robot.move, {"psm1": motion_of(cell, "psm1")})
            await cell.clock.sleep(1.0)


@pytest.mark.parametrize(
    ("waiting", "how"),
    [(move_both, "force"), (jaws, "qpos"), (sleep, "qvel")]
    + [(waits, "force") for waits in (rests, captures, tidies_up, shielded)],
)
def test_nobody_waits_for_a_physics_that_is_gone(lab, waiting, how):
    async def script(cell):
        async with trio.open_nursery() as nursery:
            nursery.start_soon(waiting, cell)
            await trio.sleep(0.1)
            explode(lab, how)
            await trio.sleep_forever()

    error = in_time(lambda: lab.run(script, 100.0))
    assert isinstance(error, PhysicsError), error
    assert "unstable" in str(error) and "void" in str(error)
    assert not any(lab.cell.robot.setpoint(arm).moving for arm in ARMS)
    assert [event["name"] for event in lab.log.events] == ["tidied up"] * (waiting is tidies_up)


def test_an_arm_that_falls_silent_is_stopped_by_its_guard_and_the_other_goes_on(lab):
    ends = {}

    async def move(cell, arm):
        ends[arm] = (await cell.robot.move({arm: motion_of(cell, arm)}))[arm]

    async def script(cell):
        async with trio.open_nursery() as nursery:
            for arm in ARMS:
                nursery.start_soon(move, cell, arm)
            await trio.sleep(0.4)
            lab.driver.silence("psm1")

    assert lab.run(script, 30.0)
    assert ends["psm1"].ended is MotionEnd.FAULT and "psm1" in ends["psm1"].reason
    assert ends["psm2"].ended is MotionEnd.DONE
    assert ends["psm1"].times_s[-1] < 0.4 + 0.1 + 0.5
    (note,) = [event for event in lab.log.events if event["name"] == "guard"]
    assert note["arm"] == "psm1" and note["time_s"] == pytest.approx(0.5, abs=0.03)
    assert_at_rest_within_limits(lab)


# Time.


def test_a_computation_takes_what_was_declared_for_it_whatever_it_took(lab):
    def slow():
        begin_s = time.process_time()
        while time.process_time() - begin_s < 0.05:
            pass
        return "found"

    async def script(cell):
        assert await cell.compute("psm1", "perception", slow, 0.2) == "found"
        assert await cell.compute("psm1", "planning", lambda: 7, 0.02) == 7

    assert lab.run(script, 5.0)
    first, second = lab.log.computations
    assert (first.name, first.budget_s, second.name, second.budget_s) == ("perception", 0.2, "planning", 0.02)
    assert 0.05 <= first.seconds < 5.0 and second.seconds < 5.0
    assert lab.log.spans == [Span("psm1", "perception", 0.0, 0.2), Span("psm1", "planning", 0.2, 0.22)]


@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_in_real_time_the_cell_really_takes_its_time(lab, speed):
    begin = time.perf_counter()
    assert lab.run(sleep, 5.0, pace=RealTime(speed))
    took_s = time.perf_counter() - begin
    assert 0.9 < took_s * speed / lab.now_s() < 10.0  # a busy machine may fall behind, none may run ahead


@pytest.mark.parametrize("speed", [0.0, -1.0, math.nan, math.inf])
def test_a_clock_without_a_speed_is_refused(speed):
    with pytest.raises(TrocarError, match="speed of a real-time clock"):
        RealTime(speed)


async def busy(cell):
    """A script that uses all of a cell's devices."""
    async with trio.open_nursery() as nursery:
        nursery.start_soon(cell.robot.jaw, "psm2", 0.8)
        await cell.robot.move({"psm1": motion_of(cell, "psm1", 1.0)})
    image = await cell.cameras["overhead"].capture()
    cell.log.event("seen", red=int(image.color[..., 0].sum()))
    await cell.compute("psm2", "planning", lambda: None, 0.1)
    with trio.move_on_after(0.2):
        await cell.robot.move({"psm2": motion_of(cell, "psm2", 1.0)})


def noted(lab):
    """Return all that a run left behind, as bytes and values."""
    arrays = {name: rows.tobytes() for name, rows in lab.recorder.arrays().items()}
    image = lab.cameras["overhead"].taken[0]
    return arrays, lab.log.events, lab.log.spans, image.color.tobytes(), image.depth_m.tobytes(), lab.now_s()


def flawed_lab():
    return SimLaboratory(ideal_session(), None, np.random.default_rng(3))


@pytest.fixture(scope="module")
def run_at_once():
    lab = flawed_lab()
    assert lab.run(busy, 30.0)
    return noted(lab)


@pytest.mark.parametrize("pace", [None, RealTime(50.0)])
def test_the_same_script_leaves_the_same_bytes_at_any_pace(run_at_once, pace):
    lab = flawed_lab()
    assert lab.run(busy, 30.0, pace=pace)
    assert noted(lab) == run_at_once


@pytest.mark.parametrize("step_s", [TICK_S, 0.29])
def test_a_cell_stepped_from_outside_does_what_it_does_by_itself(run_at_once, step_s):
    lab = flawed_lab()
    with lab.stepping(busy, 30.0) as stepped:
        while not stepped.over:
            before_s = lab.now_s()
            stepped.step(step_s)
            assert stepped.over or lab.now_s() - before_s == pytest.approx(step_s)
        after_s = lab.now_s()
        stepped.step(1.0)  # nothing is left to be stepped
        assert lab.now_s() == after_s
    assert noted(lab) == run_at_once


def test_what_is_called_between_two_steps_runs_from_the_next_tick_on(lab):
    with lab.stepping() as stepped:
        stepped.step(0.1)
        stepped.call(lambda cell: cell.robot.jaw("psm1", 0.8))
        stepped.call(lambda cell: cell.robot.move({"psm2": motion_of(cell, "psm2")}))
        assert lab.now_s() == pytest.approx(0.1) and not stepped.cell.robot.setpoint("psm2").moving
        stepped.step(0.5)
        assert stepped.cell.robot.setpoint("psm2").moving
        assert stepped.cell.robot.read("psm1").jaw_rad == pytest.approx(0.8, abs=0.05)
    assert stepped.over


@pytest.mark.parametrize("error", [None, LookupError("outside")])
def test_whoever_leaves_early_leaves_arms_at_rest_and_an_error_is_not_swallowed(lab, error):
    leaves = nullcontext() if error is None else pytest.raises(LookupError, match="outside")
    with leaves, lab.stepping(move_both) as stepped:
        stepped.step(0.4)
        assert all(stepped.cell.robot.setpoint(arm).moving for arm in ARMS)
        if error is not None:
            raise error
    assert stepped.over and 0.4 < lab.now_s() < 1.0
    assert_at_rest_within_limits(lab)
    assert_holding(lab)


def test_an_error_of_a_script_comes_out_of_the_step_in_which_it_happened(lab):
    with lab.stepping(beside_one_that_fails, 30.0) as stepped:
        stepped.step(0.3)
        with pytest.raises(ZeroDivisionError, match="of a script"):
            stepped.step(10.0)
        assert stepped.over
    assert_at_rest_within_limits(lab)


def test_a_physics_that_breaks_ends_the_stepping(lab):
    def steps():
        with lab.stepping(move_both) as stepped:
            stepped.step(0.1)
            explode(lab, "force")
            stepped.step(1.0)

    assert isinstance(in_time(steps), PhysicsError)


def test_a_spent_budget_ends_the_stepping(lab):
    with lab.stepping(move_both, 0.3) as stepped:
        stepped.step(10.0)
        assert stepped.over
    assert 0.3 < lab.now_s() < 0.9
    assert_at_rest_within_limits(lab)


def test_a_script_beside_none_is_refused(lab):
    with pytest.raises(RuntimeError, match="only while the cell runs"):
        lab.start_soon(sleep)


# What a cell consists of.


def test_an_image_shows_the_end_of_its_exposure(lab):
    seen = {}

    async def script(cell):
        async with trio.open_nursery() as nursery:
            nursery.start_soon(move_both, cell)
            begin_s = cell.clock.now_s()
            seen["image"] = await cell.cameras["overhead"].capture()
            seen["took_s"] = cell.clock.now_s() - begin_s
            seen["now_s"] = cell.clock.now_s()

    assert lab.run(script, 30.0)
    exposure_s = lab.session.station.cameras["overhead"].exposure_s
    assert exposure_s <= seen["took_s"] + 1e-9 < exposure_s + TICK_S + 1e-9
    assert seen["image"].time_s == seen["now_s"]


def test_what_a_wrapper_is_asked_for_is_kept_apart_from_what_is_sent(lab):
    off = np.array([0, 0, 0, 0.1, 0, 0])

    class Shifted:
        """Is asked for another roll than it sends."""

        def __init__(self, cell):
            self.inner = cell.robot

        def __getattr__(self, name):
            return getattr(self.inner, name)

        def setpoint(self, arm):
            return replace(at := self.inner.setpoint(arm), q=at.q - off)

        async def move(self, motions):
            sent = {arm: Trajectory.hermite(m.times_s, m.q + off, m(m.times_s, 1)) for arm, m in motions.items()}
            return await self.inner.move(sent)

    worn = lab.wrap_robot(Shifted)
    assert worn is lab.cell and isinstance(lab.cell.robot, Shifted)
    assert lab.run(move_both, 30.0)
    asked, sent = (lab.recorder.joints(kind)["psm1"][1:, :6] for kind in ("desired", "commanded"))
    assert np.ptp(asked, axis=0).max() > 0.05
    assert np.abs(sent - asked - off).max() < 1e-12


def test_whoever_listens_hears_every_event_when_it_happens():
    heard = []
    lab = ideal_laboratory(standing(0), listener=lambda event: heard.append((lab.now_s(), event)))

    async def script(cell):
        cell.log.event("first", number=1)
        await trio.sleep(0.1)
        cell.log.event("second")

    lab.run(script, 5.0)
    assert [event for _, event in heard] == lab.log.events
    assert [(now_s, event["name"]) for now_s, event in heard] == [(0.0, "first"), (lab.now_s(), "second")]


def test_a_laboratory_is_made_of_what_it_was_given_or_of_what_is_usual():
    day, task = ideal_session(replace(STATION, cameras={})), TaskWorld()
    given, usual = SimLaboratory(day, task, surface=Surface(abs_friction=0.2)).world, SimLaboratory(day).world
    assert given.task is task and type(usual.task) is TaskWorld
    for world, friction in ((given, 0.2), (usual, 0.35)):
        assert world.model.actuator("psm1_jaw").forcerange[1] == pytest.approx(0.06)
        assert world.model.geom("psm1_shaft").friction[0] == pytest.approx(friction)


def test_arms_begin_where_their_station_parks_them(lab):
    for name, arm in lab.session.station.arms.items():
        assert np.array_equal(lab.cell.robot.setpoint(name).q, arm.park_q())
        assert lab.cell.arms[name] is ARM_MODELS[name]
        assert np.abs(lab.world.joints(name) - arm.park_q()).max() < 1e-3
        assert lab.world.jaw_rad(name) == pytest.approx(arm.park_jaw_rad, abs=1e-3)


@pytest.mark.parametrize(("moves", "sleep_s", "ended_s"), [(True, 300.0, (0.5, 5.0)), (False, 0.8, (1.289, 1.311))])
def test_a_script_may_clean_up_for_a_second_but_not_outrun_its_budget_nor_count_as_within_it(
    lab, moves, sleep_s, ended_s
):
    """What it awaits of an arm under a shield is simulated, what it sleeps for longer is not."""
    seen = []

    async def shielded(cell):
        try:
            await cell.clock.sleep(0.0 if moves else 30.0)
        finally:
            with trio.CancelScope(shield=True):
                if moves:
                    await move_both(cell)
                await cell.clock.sleep(sleep_s)
            seen.append(cell.clock.now_s())

    assert not lab.run(shielded, 0.5)
    assert len(seen) == 1 and ended_s[0] < seen[0] < ended_s[1]
    if moves:
        assert_at_rest_within_limits(lab)
