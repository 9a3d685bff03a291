"""Work on a dask cluster: an existing one at an address, or a new one on this machine."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, field

from distributed import Client, KilledWorker, LocalCluster
from distributed.client import FutureCancelledError

from trocar.errors import InvalidInput

PATIENCE_S = 10
"""Timeout for an answer of the scheduler."""


@dataclass(frozen=True)
class DaskWorkers:
    """Workers of a dask cluster. The folder of the work must be on a file system that all of them see.

    Attributes:
        count: how many units are handed out at once.
        scheduler: address; empty: a cluster of processes is started on this machine.
    """

    count: int
    scheduler: str = ""
    died: tuple[type[BaseException], ...] = field(default=(KilledWorker, FutureCancelledError), init=False)

    @contextmanager
    def open(self) -> Iterator[Executor]:
        """Return an executor of the cluster. Dask itself hands the work of a dead worker out again."""
        with self._client() as client:
            executor = client.get_executor(pure=False, retries=0)
            try:
                yield executor
            finally:
                executor.shutdown(wait=False)

    @contextmanager
    def _client(self) -> Iterator[Client]:
        if self.scheduler:
            try:
                client = Client(self.scheduler, timeout=PATIENCE_S)
            except (OSError, ValueError) as error:
                raise InvalidInput(
                    f"--scheduler {self.scheduler!r}",
                    f"has no dask scheduler that answers ({error})",
                    "start one with `dask scheduler`, or drop --scheduler for a cluster on this machine",
                ) from None
            with client:
                yield client
            return
        cluster = LocalCluster(
            n_workers=self.count,
            threads_per_worker=1,
            processes=True,
            dashboard_address=None,  # type: ignore[arg-type]  # distributed documents it: no dashboard
            memory_limit=0,
        )
        with cluster, Client(cluster) as client:
            yield client


def dask_workers(jobs: int, scheduler: str = "") -> DaskWorkers:
    """Return workers of a dask cluster."""
    return DaskWorkers(jobs, scheduler)
