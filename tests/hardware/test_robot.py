"""Real arms in a process of their own: scripts that compute, freeze or die do not make them late or fast."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import trio

import echo_arms
from driven import HOME, PAPER
from trocar.arms import MotionLimits
from trocar.cell import MotionEnd
from trocar.errors import InvalidInput, StartMismatch, TrocarError, UnknownName
from trocar.hardware import HardwareLaboratory
from trocar.hardware.arm import ArmFault, Fault, LoopSettings
from trocar.hardware.robot import HardwareRobot
from trocar.lab import load_station
from trocar.motion import move_to, rest_to_rest
from trocar.testing import CheckFailed, check_hardware, check_robot
from trocar.testing.hardware import faulty

pytestmark = pytest.mark.realtime
GOAL = HOME + np.array([0.2, 0.15, -0.03, 0.9, 0.5, -0.6])
ARM = "psm1"
RELAXED = LoopSettings(max_late=10_000, max_stall_s=60.0, watchdog_s=60.0)
"""A machine that runs other tests beside this one may be late; what is late is tested tick by tick."""

SLOW = MotionLimits(PAPER.velocity / 4, PAPER.acceleration / 8)
"""Half of a motion takes longer than this machine may be busy otherwise."""


def there():
    return rest_to_rest(HOME, GOAL, PAPER)


def rows(log):
    """Return what the arm was sent: times (n,), joints (n, 6)."""
    table = np.loadtxt(log)
    return table[:, 0], table[:, 1:7]


def use(log):
    """Return the largest shares of velocity and acceleration limits, a tick being a tick however late it was."""
    q = rows(log)[1]
    velocity, acceleration = np.diff(q, axis=0) / 0.01, np.diff(q, 2, axis=0) / 1e-4
    return np.abs(velocity / PAPER.velocity).max(), np.abs(acceleration / PAPER.acceleration).max()


@pytest.fixture(scope="module")
def station():
    return load_station("peg-transfer")


@pytest.fixture
def laboratory(station, tmp_path):
    with HardwareLaboratory(station, partial(echo_arms.connect, log=tmp_path / "sent"), RELAXED) as laboratory:
        yield laboratory


def test_echoing_arms_keep_the_promises_of_a_robot_and_a_busy_script_makes_nothing_faster(laboratory, tmp_path):
    async def script(cell):
        await check_robot(cell, ARM, limits=SLOW)
        done = {}

        async def move():
            done.update(await cell.robot.move({ARM: there()}))

        async with trio.open_nursery() as nursery:
            nursery.start_soon(move)
            await trio.sleep(0.2)
            end_s = time.monotonic() + 0.4
            while time.monotonic() < end_s:  # Python work that lets nobody else run
                sum(range(1000))
        return done

    async def all_of_it(cell):
        assert (await script(cell))[ARM].done

    assert laboratory.run(all_of_it, 60.0)
    assert max(use(tmp_path / "sent")) <= 1.001


def test_jaws_that_a_network_tells_late_have_closed_when_the_call_returns(station):
    read_rad = []

    async def script(cell):
        async with trio.open_nursery() as nursery:
            nursery.start_soon(stall)
            for goal_rad in (-0.17, 0.3, 0.3):
                await cell.robot.jaw(ARM, goal_rad)
                read_rad.append(cell.robot.read(ARM).jaw_rad)
            nursery.cancel_scope.cancel()

    async def stall():
        while True:  # this process hears late of what the loop has read
            await trio.sleep(0.01)
            time.sleep(0.07)

    with HardwareLaboratory(station, echo_arms.with_delayed_jaws, RELAXED) as laboratory:
        assert laboratory.run(script, 20.0)
    assert read_rad == pytest.approx([-0.17, 0.3, 0.3], abs=1e-6)


def test_motions_that_replace_each_other_again_and_again_stay_within_the_limits(laboratory, tmp_path):
    """On a busy machine one may come too late: then the one before it goes on, and may reach its goal."""
    ends = {}

    async def go(cell, motion, key):
        try:
            ends[key] = (await cell.robot.replace({ARM: motion}))[ARM].ended
        except StartMismatch:
            ends[key] = None

    async def script(cell):
        async with trio.open_nursery() as nursery:
            nursery.start_soon(go, cell, there(), 0)
            for key, goal in enumerate(goals[1:], 1):
                await trio.sleep(0.15)
                now = cell.robot.setpoint(ARM)
                nursery.start_soon(go, cell, move_to(now.q, now.velocity, goal, PAPER), key)
        assert not cell.robot.setpoint(ARM).moving

    goals = [GOAL, HOME, GOAL, HOME, GOAL, HOME]
    assert laboratory.run(script, 60.0)
    accepted = [key for key in range(len(goals)) if ends[key] is not None]
    assert {ends[key] for key in accepted} == {MotionEnd.DONE, MotionEnd.REPLACED}
    assert [ends[key] for key in accepted].count(MotionEnd.REPLACED) >= 2
    assert ends[accepted[-1]] is MotionEnd.DONE
    np.testing.assert_allclose(rows(tmp_path / "sent")[1][-1], goals[accepted[-1]], atol=1e-6)
    assert max(use(tmp_path / "sent")) <= 1.001


def test_a_motion_that_was_cancelled_brakes_also_after_a_refused_one(laboratory, tmp_path):
    """The one that was to take over is noted until the loop refuses it; then the first goes on, and must be stopped."""
    slow = rest_to_rest(HOME, GOAL, PAPER).stretched(8.0)

    async def script(cell):
        async with trio.open_nursery() as nursery:
            nursery.start_soon(cell.robot.move, {ARM: slow})
            await trio.sleep(0.5)
            with pytest.raises(StartMismatch):
                await cell.robot.replace({ARM: rest_to_rest(GOAL, HOME, PAPER)})
            motion, _ = laboratory.robot.remaining(ARM)
            told.append(np.array_equal(motion.times_s, slow.times_s))
            nursery.cancel_scope.cancel()
        told.append(cell.robot.setpoint(ARM).q)

    told = []
    assert laboratory.run(script, 60.0)
    assert told[0], "what the arm executes is the first motion"
    assert np.abs(told[1] - GOAL).max() > 0.1, "it brakes at once"
    assert not np.loadtxt(tmp_path / "sent")[-1, 7:13].any()


def test_a_stream_faster_than_the_lead_follows_every_set_point(laboratory, tmp_path):
    """Each motion starts from the one that was sent last, though that one has not begun."""
    ends, refused = [], []

    async def go(cell, goal):
        now = cell.robot.setpoint(ARM)
        try:
            ends.append((await cell.robot.replace({ARM: move_to(now.q, now.velocity, goal, PAPER)}))[ARM].ended)
        except StartMismatch as error:  # a busy machine
            refused.append(error)

    async def script(cell):
        async with trio.open_nursery() as nursery:
            for step in range(100):
                nursery.start_soon(go, cell, HOME + (GOAL - HOME) * min(1.0, step / 80))
                await trio.sleep(0.012)  # the lead is 30 ms

    assert laboratory.run(script, 60.0)
    assert len(refused) < 20, refused  # twice as many, if nothing was known of those that are to begin
    assert MotionEnd.DONE in ends
    assert max(use(tmp_path / "sent")) <= 1.001
    np.testing.assert_allclose(rows(tmp_path / "sent")[1][-1], GOAL, atol=1e-6)


def test_a_fault_ends_the_motion_and_is_noted_and_the_arm_stays_where_it_is(station):
    async def script(cell):
        result = (await cell.robot.move({ARM: there()}))[ARM]
        assert result.ended is MotionEnd.FAULT and result.cause.fault is Fault.INVALID
        assert not cell.robot.setpoint(ARM).moving
        again = await cell.robot.move({ARM: rest_to_rest(cell.robot.setpoint(ARM).q, HOME, PAPER)})
        assert again[ARM].cause.fault is Fault.INVALID

    with HardwareLaboratory(station, partial(faulty, connect=echo_arms.connect, plant="nan"), RELAXED) as laboratory:
        assert laboratory.run(script, 30.0)
        assert [event["fault"] for event in laboratory.log.events if event["name"] == "fault"] == ["invalid"]


def test_the_loop_of_an_echoing_arm_passes_its_check(station):
    settings = LoopSettings(max_late=10_000, max_stall_s=0.25, watchdog_s=60.0)  # what is planted takes .3 s
    check_hardware(station, echo_arms.connect, ARM, settings=settings)


def test_a_loop_that_tolerates_frozen_encoders_does_not(station):
    with pytest.raises(CheckFailed, match="'frozen' planted must: tell FOLLOWING, not None"):
        check_hardware(station, echo_arms.connect, ARM, settings=replace(RELAXED, following_rad=10.0, following_m=1.0))


def test_a_driver_that_hangs_at_once_is_not_waited_for(station, monkeypatch):
    monkeypatch.setattr("trocar.hardware.robot.CONNECT_S", 8.0)
    with pytest.raises(ArmFault, match="its loop did not connect and begin within 8 s"):
        HardwareLaboratory(station, echo_arms.stuck_at_once, RELAXED)


def test_a_function_that_another_process_cannot_have_is_refused(station):
    with pytest.raises(InvalidInput, match=r"connect cannot be given to the loop's process .*; give a module-level"):
        HardwareLaboratory(station, lambda name: echo_arms.EchoArm(), RELAXED)


def test_an_arm_that_does_not_connect_is_named(station):
    with pytest.raises(ArmFault, match="no such arm: psm1"):
        HardwareLaboratory(station, echo_arms.refusing, RELAXED)


def test_the_end_of_the_loops_process_ends_the_script_with_a_sentence(laboratory):
    async def script(cell):
        async with trio.open_nursery() as nursery:
            nursery.start_soon(cell.robot.move, {ARM: there()})
            await trio.sleep(0.2)
            os.kill(laboratory.robot._process.pid, signal.SIGKILL)

    with pytest.raises(TrocarError, match="its loop has ended"):
        laboratory.run(script, 30.0)


def test_a_driver_that_does_not_return_ends_the_script_with_a_sentence(station):
    async def script(cell):
        await cell.robot.move({ARM: rest_to_rest(HOME, GOAL, SLOW)})

    with HardwareLaboratory(station, echo_arms.stuck, RELAXED) as laboratory:
        begin_s = time.monotonic()
        with pytest.raises(ArmFault, match=r"its loop has ended \(it has told nothing for 2.* s: a call of its driver"):
            laboratory.run(script, 60.0)
        assert time.monotonic() - begin_s < 20.0
        assert any(event["name"] == "fault" and event["fault"] == "gone" for event in laboratory.log.events)


def test_a_script_that_stands_still_for_long_accuses_nobody(laboratory):
    async def script(cell):
        time.sleep(2.5)
        assert (await cell.robot.move({ARM: there()}))[ARM].done

    assert laboratory.run(script, 60.0)


def test_what_goes_wrong_while_connecting_leaves_no_loop_behind(station, monkeypatch):
    def interrupted(robot, report):
        robots.append(robot)
        raise KeyboardInterrupt

    robots = []
    monkeypatch.setattr(HardwareRobot, "_take", interrupted)
    with pytest.raises(KeyboardInterrupt):
        HardwareLaboratory(station, echo_arms.connect, RELAXED)
    assert not robots[0]._process.is_alive()


def test_a_camera_that_the_station_lacks_is_named_before_anything_is_connected(station):
    with pytest.raises(UnknownName, match="camera 'ceiling'"):
        HardwareLaboratory(station, echo_arms.refusing, RELAXED, cameras={"ceiling": None})


def test_a_script_begins_with_what_is_read_then_not_when_arms_were_connected(laboratory):
    async def script(cell):
        assert cell.robot.read(ARM).time_s > begun_s

    time.sleep(0.5)
    begun_s = laboratory.cell.clock.now_s()
    assert laboratory.run(script, 60.0)


def test_the_emergency_stop_ends_the_motion_and_lasts_until_it_is_cleared(laboratory, tmp_path):
    async def press(cell):
        await cell.clock.sleep(0.3)
        laboratory.robot.emergency_stop("the button")

    async def script(cell):
        async with trio.open_nursery() as nursery:
            nursery.start_soon(press, cell)
            result = (await cell.robot.move({ARM: there()}))[ARM]
        assert result.cause.fault is Fault.EMERGENCY and "the button" in result.reason
        here = cell.robot.setpoint(ARM).q
        back = rest_to_rest(here, HOME, PAPER)
        assert (await cell.robot.move({ARM: back}))[ARM].cause.fault is Fault.EMERGENCY
        assert np.array_equal(cell.robot.setpoint(ARM).q, here)
        laboratory.robot.clear_faults(ARM)
        assert (await cell.robot.move({ARM: back}))[ARM].done

    assert laboratory.run(script, 30.0)
    assert max(use(tmp_path / "sent")) <= 1.001


def test_who_waits_for_a_fault_hears_of_it_though_faults_were_cleared_before(laboratory):
    async def script(cell):
        async with trio.open_nursery() as nursery:
            nursery.start_soon(laboratory.robot.refusal)
            await trio.sleep(0.1)
            laboratory.robot.clear_faults()
            laboratory.robot.emergency_stop("the button")
            await trio.sleep(5.0)

    with pytest.raises(ArmFault, match="the button"):
        laboratory.run(script, 60.0)


def test_reasons_of_stops_are_forgotten_with_the_motions_that_they_ended(laboratory):
    async def script(cell):
        for why in ("first", "second"):
            async with trio.open_nursery() as nursery:
                nursery.start_soon(stop, why)
                now = cell.robot.setpoint(ARM).q
                result = (await cell.robot.move({ARM: rest_to_rest(now, GOAL, SLOW)}))[ARM]
            assert result.ended is MotionEnd.HELD and why in result.reason
            kept.append(len(laboratory.robot._jobs._reasons))
        cell.robot.hold()
        await laboratory.robot.fresh()
        kept.append(len(laboratory.robot._jobs._reasons))

    async def stop(why):
        await trio.sleep(0.2)
        laboratory.robot.hold(ARM, reason=why)

    kept = []
    assert laboratory.run(script, 60.0)
    assert kept == [0, 0, 0]


def test_a_script_that_raises_leaves_its_arm_at_rest_and_is_named(laboratory, tmp_path):
    async def script(cell):
        async with trio.open_nursery() as nursery:
            nursery.start_soon(cell.robot.move, {ARM: there()})
            await cell.clock.sleep(0.15)  # of .548 s: past the middle, it brakes to its goal anyway
            raise KeyError("peg 13")

    with pytest.raises(KeyError, match="peg 13"):
        laboratory.run(script, 30.0)
    assert not np.loadtxt(tmp_path / "sent")[-1, 7:13].any()
    assert max(use(tmp_path / "sent")) <= 1.001
    assert np.abs(laboratory.cell.robot.setpoint(ARM).q - GOAL).max() > 0.01


@pytest.mark.parametrize("error", [KeyboardInterrupt, BrokenPipeError, KeyError])
def test_what_is_raised_where_reports_are_processed_ends_the_script_and_its_arm_comes_to_rest(station, tmp_path, error):
    """Ctrl-C raises wherever this process happens to be, and a listener that prints may have lost its terminal."""

    def listener(event):
        if event["name"] == "fault":
            raise error

    async def script(cell):
        async with trio.open_nursery() as nursery:
            nursery.start_soon(cell.robot.move, {ARM: there().stretched(8.0)})
            await cell.clock.sleep(0.5)
            laboratory.robot.emergency_stop()
            await cell.clock.sleep(20.0)

    with HardwareLaboratory(
        station, partial(echo_arms.connect, log=tmp_path / "sent"), RELAXED, listener=listener
    ) as laboratory:
        with pytest.raises(error):
            laboratory.run(script, 10.0)
        assert not laboratory.cell.robot.setpoint(ARM).moving
    assert laboratory.robot._process.exitcode == 0, "it was told to close, not killed"
    assert not np.loadtxt(tmp_path / "sent")[-1, 7:13].any()
    assert max(use(tmp_path / "sent")) <= 1.001


@pytest.mark.parametrize("where", ["reports", "rest"])
def test_a_second_ctrl_c_while_arms_brake_ends_the_run_as_well(laboratory, tmp_path, monkeypatch, where):
    def interrupted(*_):
        if interrupts:
            raise interrupts.pop()

    async def rest_interrupted():
        raise KeyboardInterrupt

    async def script(cell):
        async with trio.open_nursery() as nursery:
            nursery.start_soon(cell.robot.move, {ARM: there().stretched(8.0)})
            await cell.clock.sleep(0.5)
            interrupts.extend([KeyboardInterrupt()] * (2 if where == "reports" else 1))
            await cell.clock.sleep(20.0)

    interrupts = []
    monkeypatch.setattr(laboratory.robot, "_record", interrupted)
    if where == "rest":
        monkeypatch.setattr(laboratory.robot, "rest", rest_interrupted)
    with pytest.raises(KeyboardInterrupt):
        laboratory.run(script, 10.0)
    assert not interrupts
    laboratory.close()
    assert not np.loadtxt(tmp_path / "sent")[-1, 7:13].any()
    assert max(use(tmp_path / "sent")) <= 1.001


def test_a_listener_that_fails_while_the_loop_is_closed_leaves_no_loop_behind(station):
    def listener(event):
        raise KeyError("terminal")

    laboratory = HardwareLaboratory(station, echo_arms.connect, RELAXED, listener=listener)
    laboratory.robot.emergency_stop()
    with pytest.raises(KeyError, match="terminal"):
        laboratory.close()
    assert not laboratory.robot._process.is_alive()


def test_a_terminal_that_is_gone_does_not_end_the_loop(laboratory):
    """Its signals go to the script's process and to the loop's; the loop brakes the arms once the script is silent."""

    async def script(cell):
        for gone in (signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP):
            os.kill(laboratory.robot._process.pid, gone)
        assert (await cell.robot.move({ARM: there()}))[ARM].done

    assert laboratory.run(script, 60.0)


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP], ids=lambda how: how.name)
def test_arms_come_to_rest_within_their_limits_when_the_scripts_process_dies_or_freezes(how, tmp_path):
    log = tmp_path / "sent"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    script = subprocess.Popen([sys.executable, Path(echo_arms.__file__), log], env=environment)
    try:
        end_s = time.monotonic() + 60.0
        while (
            not (log.is_file() and len(log.read_text().splitlines()) > 10 and np.ptp(rows(log)[1][:, 0]) > 0.02)
            and time.monotonic() < end_s
        ):
            time.sleep(0.1)
        os.kill(script.pid, how)
        time.sleep(2.0)
        _, q = rows(log)
        assert not np.loadtxt(log)[-1, 7:13].any()  # the last thing it was told is to rest
        assert np.abs(q[-1] - echo_arms.FAR).max() > 0.01  # on the way
        assert max(use(log)) <= 1.001
    finally:
        script.kill()
        script.wait()
