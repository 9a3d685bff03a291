"""Work on several processes, and on a dask cluster: nothing is lost when a worker is killed, and nothing done twice."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import pytest

from trocar.errors import TrocarError
from trocar.eval import workers
from trocar.eval.workers import pick_workers, run_all
from units_of_work import always_killed, done, killed_once, refused

COUNT = 8


def backends():
    missing = pytest.mark.skipif(find_spec("distributed") is None, reason="distributed is not installed")
    return ["processes", pytest.param("dask", marks=missing)]


def units(tmp_path):
    return [(str(tmp_path), number) for number in range(COUNT)]


@pytest.mark.parametrize("backend", backends())
def test_a_killed_worker_loses_nothing_and_nothing_is_done_twice(tmp_path, backend):
    found = list(run_all(killed_once, units(tmp_path), pick_workers(backend, 2)))
    assert (tmp_path / "killed").is_file()  # a worker was killed, in the middle of the work
    assert sorted(number for _, number in found) == list(range(COUNT))
    assert sorted(unit[1] for unit, _ in found) == list(range(COUNT))
    assert len(list(tmp_path.glob("done_*"))) == COUNT
    ended = (tmp_path / "ended").read_text().split()  # one that was killed with the first may not have come to say so
    assert len(ended) == len(set(ended)) >= COUNT - 1


def test_results_come_with_their_units_and_from_other_processes(tmp_path):
    found = list(run_all(done, units(tmp_path), pick_workers("processes", 2)))
    assert all(unit[1] == number for unit, number in found)
    assert str(os.getpid()) not in {path.read_text() for path in tmp_path.glob("done_*")}


class Slow:
    """Stands for workers: of what was handed out, the first unit ends whenever somebody waits."""

    count, died = 2, ()

    def __init__(self):
        self.waited_for = []

    @contextmanager
    def open(self):
        yield self

    def submit(self, function, unit):
        future = Future()
        future.unit = unit
        return future

    def wait(self, futures, **_):
        self.waited_for.append(len(futures))
        first = next(iter(futures))
        first.set_result(first.unit)
        return SimpleNamespace(done=[first])


def test_no_more_is_handed_out_than_keeps_every_worker_busy(monkeypatch):
    """What waits in a queue holds memory, and is worked off before a run that was stopped ends."""
    slow = Slow()
    monkeypatch.setattr(workers, "wait", slow.wait)
    assert list(run_all(done, range(7), slow)) == [(number, number) for number in range(7)]
    assert slow.waited_for == [4, 4, 4, 4, 3, 2, 1]


def test_work_that_kills_every_worker_is_given_up_in_a_sentence(tmp_path):
    with pytest.raises(TrocarError, match=r"died 3 times in a row.*--jobs"):
        list(run_all(always_killed, units(tmp_path)[:1], pick_workers("processes", 1)))


def test_what_a_unit_refuses_is_heard(tmp_path):
    with pytest.raises(TrocarError, match="unit 0 is refused"):
        list(run_all(refused, units(tmp_path)[:1], pick_workers("processes", 1)))


WORK = """
import sys
sys.path.insert(0, {tests!r})

if __name__ == "__main__":
    from trocar.eval.workers import Processes, run_all
    from units_of_work import long

    print("handed out", flush=True)
    try:
        list(run_all(long, [({folder!r}, number) for number in range(6)], Processes(2, loads=())))
    except KeyboardInterrupt:
        print("stopped", flush=True)
        sys.exit(130)
"""


def at_work(tmp_path):
    """Return a process that has work done by others, in a group with them as under a terminal."""
    script = tmp_path / "work.py"
    script.write_text(WORK.format(tests=str(Path(__file__).parents[1]), folder=str(tmp_path)))
    return subprocess.Popen(
        [sys.executable, script], start_new_session=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def begun(tmp_path, process):
    deadline = time.monotonic() + 300
    while len(list(tmp_path.glob("began_*"))) < 2 and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)


def ends_of(process):
    try:
        return process.communicate(timeout=300)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)


@pytest.mark.slow
def test_ctrl_c_waits_for_the_units_under_way(tmp_path):
    process = at_work(tmp_path)
    begun(tmp_path, process)
    os.killpg(process.pid, signal.SIGINT)
    out, err = ends_of(process)
    assert (process.returncode, out, err) == (130, "handed out\nstopped\n", "")
    assert len(list(tmp_path.glob("began_*"))) >= len(list(tmp_path.glob("done_*"))) >= 2


@pytest.mark.slow
def test_a_second_ctrl_c_kills_the_workers(tmp_path):
    process = at_work(tmp_path)
    begun(tmp_path, process)
    os.killpg(process.pid, signal.SIGINT)
    time.sleep(0.5)
    os.killpg(process.pid, signal.SIGINT)
    _, err = ends_of(process)
    assert "Traceback" not in err, err
    assert process.returncode == 130
    assert not list(tmp_path.glob("done_*"))


@pytest.mark.slow
def test_ctrl_c_while_workers_start_is_no_traceback_of_theirs(tmp_path):
    process = at_work(tmp_path)
    assert process.stdout is not None and process.stdout.readline() == "handed out\n"
    time.sleep(0.4)
    os.killpg(process.pid, signal.SIGINT)
    _, err = ends_of(process)
    assert (process.returncode, err) == (130, "")


@pytest.mark.slow
def test_workers_end_with_a_process_that_is_killed(tmp_path):
    process = at_work(tmp_path)
    begun(tmp_path, process)
    process.kill()
    try:
        process.communicate(timeout=20)  # until nobody holds its stdout any more, its workers included
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    assert len(list(tmp_path.glob("began_*"))) < 6


def test_no_work_needs_no_worker():
    assert list(run_all(done, [], pick_workers("processes", 2))) == []


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (("processes", 0, ""), "--jobs is 0"),
        (("ray", 1, ""), "choose one of processes, dask"),
        (("processes", 1, "tcp://x:1"), "add --backend dask"),
    ],
)
def test_workers_that_do_not_exist(given, words):
    with pytest.raises(TrocarError, match=words):
        pick_workers(*given)


@pytest.mark.skipif(find_spec("distributed") is None, reason="distributed is not installed")
def test_a_scheduler_that_does_not_answer(tmp_path, monkeypatch):
    monkeypatch.setattr(workers, "PATIENCE_S", 0.5)
    with pytest.raises(TrocarError, match="no dask scheduler that answers"):
        list(run_all(done, units(tmp_path), pick_workers("dask", 1, "tcp://127.0.0.1:9")))
