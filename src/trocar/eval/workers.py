"""Run units of work on all cores or on a cluster: yield results as they come, lose nothing when a worker dies."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any, Protocol, TypeVar

from trocar.errors import InvalidInput, InvalidValue, MachineError, NotInstalled
from trocar.registry import Registry

Unit = TypeVar("Unit")
Result = TypeVar("Result")

UNITS_A_PROCESS = 10
"""A process is replaced after this many units, which frees the memory that its libraries keep."""
PATIENCE_S = 10
"""Timeout for an answer of a dask scheduler."""
MAX_DEATHS = 3
"""Work is given up after this many deaths of workers in a row, with nothing finished in between."""


class Workers(Protocol):
    """Workers that run units of work."""

    @property
    def died(self) -> tuple[type[BaseException], ...]:
        """Return the exceptions of a unit's future if its worker died; the unit is then handed out again."""
        ...

    @property
    def count(self) -> int:
        """Return the number of units that run at once."""
        ...

    def open(self) -> AbstractContextManager[Executor]:
        """Return a new executor; it is called again after workers died."""
        ...


@dataclass(frozen=True)
class Processes:
    """Processes of this machine.

    They are forked from a server process that has loaded the simulator; without fork (on Windows), each loads it.
    A fork of this process would copy the progress bar's threads and their locks.

    Attributes:
        count: number of processes.
        loads: modules that the server process loads once for all.
    """

    count: int
    loads: Sequence[str] = ("trocar.eval.jobs",)
    died: tuple[type[BaseException], ...] = field(default=(BrokenProcessPool,), init=False)

    @contextmanager
    def open(self) -> Iterator[Executor]:
        """Return a pool; a killed worker breaks it, and :func:`run_all` opens another.

        After Ctrl-C it waits for the units that are running; a second Ctrl-C kills the workers.
        """
        forked = "forkserver" in multiprocessing.get_all_start_methods()
        context = multiprocessing.get_context("forkserver" if forked else "spawn")
        if forked:
            context.set_forkserver_preload(list(self.loads))
        pool = ProcessPoolExecutor(
            self.count, mp_context=context, initializer=_begin_worker, max_tasks_per_child=UNITS_A_PROCESS
        )
        try:
            yield pool
        finally:
            # An event, not a join: after Ctrl-C interrupts a join, Python 3.11 counts the thread as ended.
            ended = threading.Event()
            threading.Thread(target=_shut_down, args=(pool, ended), daemon=True).start()
            try:
                ended.wait()
            except KeyboardInterrupt:
                for worker in multiprocessing.active_children():
                    worker.kill()
                ended.wait()  # otherwise the interpreter's exit wakes a thread that is just ending
                raise


def _shut_down(pool: Executor, ended: threading.Event) -> None:
    pool.shutdown(wait=True, cancel_futures=True)
    ended.set()


def _begin_worker() -> None:
    """Leave Ctrl-C to the process that hands out the work: a running trial is finished and kept; but end with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, name="end with parent", daemon=True).start()


def _end_with_parent() -> None:
    """Wait until the process that hands out the work has ended, then end at once: files are written whole or not."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def _ctrl_c_held() -> Iterator[None]:
    """Block Ctrl-C for a moment; a process started meanwhile inherits the block, and later ignores Ctrl-C."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def run_all(
    function: Callable[[Unit], Result], units: Sequence[Unit], workers: Workers
) -> Iterator[tuple[Unit, Result]]:
    """Yield each unit of work with its result, in the order in which they end.

    A unit whose worker died, by a signal or for lack of memory, is handed out again. So ``function`` must save its
    result (a trial's file), and return at once if it exists.

    Args:
        function: does a unit; defined in a module, so that other processes find it.
        units: handed out in order; they must pickle.
        workers: the workers.

    Raises:
        MachineError: workers died several times in a row.
    """
    left = list(range(len(units)))
    deaths = 0
    while left:
        broken = ""
        with workers.open() as executor:
            for place, result in _handed_out(executor, function, units, left, workers):
                if isinstance(result, BaseException):
                    broken = str(result)
                    continue
                deaths = 0
                left.remove(place)
                yield units[place], result
        if not left:
            return
        deaths += 1
        if deaths >= MAX_DEATHS:
            raise MachineError(
                f"workers died {deaths} times in a row without finishing anything ({broken[:200]}); if memory is "
                "short, give fewer with --jobs; run the same command to continue"
            )
        time.sleep(0.2)


def _handed_out(
    executor: Executor, function: Callable[[Unit], Result], units: Sequence[Unit], left: Sequence[int], workers: Workers
) -> Iterator[tuple[int, Result | BaseException]]:
    """Yield indices of units with their results, or with the exception of a dead worker; keep the queue short."""
    waiting: dict[Future[Any], int] = {}
    queue = iter(list(left))

    def hand_out() -> None:
        for place in queue:
            with _ctrl_c_held():
                waiting[executor.submit(function, units[place])] = place
            if len(waiting) >= 2 * workers.count:
                return

    try:
        hand_out()
        while waiting:
            for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                place = waiting.pop(future)
                try:
                    result = future.result()
                except workers.died as error:
                    yield place, error
                    continue
                yield place, result
            hand_out()
    except workers.died as error:  # the executor accepts nothing any more
        for future, place in list(waiting.items()):
            if future.done() and not future.cancelled() and future.exception() is None:
                yield place, future.result()
        yield -1, error
    finally:
        for future in waiting:
            future.cancel()


@dataclass(frozen=True)
class DaskWorkers:
    """Workers of a dask cluster, which must all see the run's folder.

    Attributes:
        count: number of units that run at once.
        scheduler: address of the scheduler; empty: a cluster of processes is started on this machine.
    """

    count: int
    scheduler: str = ""

    @property
    def died(self) -> tuple[type[BaseException], ...]:
        """Return the exceptions that a unit's future raises if its worker died."""
        from distributed import KilledWorker
        from distributed.client import FutureCancelledError

        return KilledWorker, FutureCancelledError

    @contextmanager
    def open(self) -> Iterator[Executor]:
        """Return an executor of the cluster. Dask itself hands out the work of a dead worker again."""
        with self._client() as client:
            executor = client.get_executor(pure=False, retries=0)
            try:
                yield executor
            finally:
                executor.shutdown(wait=False)

    @contextmanager
    def _client(self) -> Iterator[Any]:
        from distributed import Client, LocalCluster  # an extra

        if self.scheduler:
            try:
                client = Client(self.scheduler, timeout=PATIENCE_S)
            except (OSError, ValueError) as error:
                remedy = "start one with `dask scheduler`, or drop --scheduler for a cluster on this machine"
                problem = f"has no dask scheduler that answers ({error})"
                raise InvalidInput(f"--scheduler {self.scheduler!r}", problem, remedy) from None
            with client:
                yield client
            return
        cluster = LocalCluster(
            n_workers=self.count,
            threads_per_worker=1,
            processes=True,
            dashboard_address=None,  # type: ignore[arg-type]  # it documents this: no dashboard
            memory_limit=0,
        )
        with cluster, Client(cluster) as client:
            yield client


def _processes(jobs: int, scheduler: str = "") -> Workers:
    if scheduler:
        raise InvalidInput(f"--scheduler {scheduler!r}", "is of a dask cluster", "add --backend dask, or drop it")
    return Processes(jobs)


BACKENDS: Registry[Callable[..., Workers]] = Registry(
    "backend", "trocar.workers", {"processes": _processes, "dask": DaskWorkers}
)
"""Functions of the number of jobs and the scheduler's address to :class:`Workers`, by name."""


def pick_workers(backend: str, jobs: int, scheduler: str = "") -> Workers:
    """Return workers of a backend.

    Raises:
        UnknownName: there is no such backend.
        NotInstalled: dask is requested but not installed.
        InvalidValue: the number of jobs is below 1.
    """
    if jobs < 1:
        raise InvalidValue("--jobs", jobs, "give 1 or more")
    if backend == "dask" and find_spec("distributed") is None:
        raise NotInstalled("--backend dask", "distributed", "dask")
    return BACKENDS.pick(backend)(jobs, scheduler)
