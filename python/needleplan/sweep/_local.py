"""Dask processes of this machine, for the time of a run."""

from __future__ import annotations

import logging
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

__all__ = ["local_client"]

# Address of the status page of Dask. Dask opens port 8787 to the network unless told otherwise, and warns if a second
# run of this machine has it.
_PAGE = "127.0.0.1:0"


@contextmanager
def local_client(workers: int | None) -> Iterator[Client]:
    """Start processes of this machine, one per processor by default, and yield a client; close all at the end."""
    from dask.system import CPU_COUNT  # processors that this process may use, by affinity and control group
    from distributed import Client, LocalCluster

    resource_tracker.ensure_running()  # which unblocks SIGINT when it starts
    with _without_ctrl_c():
        local = LocalCluster(
            n_workers=workers or CPU_COUNT, threads_per_worker=1, dashboard_address=_PAGE, silence_logs=logging.CRITICAL
        )
    try:
        with Client(local) as client:
            yield client
    finally:
        _close(local)


def _close(local: LocalCluster) -> None:
    """Close all processes. Whether Dask can close them says nothing about the run, which has ended.

    `LocalCluster.close` raises an AssertionError ("can only join a started process") if a worker has died and the
    process that takes its place has not started. Dask has told this process to stop; a second call closes the rest.
    """
    from distributed import Status

    for state in (Status.failed, Status.closed):
        try:
            local.close()
        except Exception:  # of any kind: all results are delivered, or an error of the run itself is on its way
            local.status = state


@contextmanager
def _without_ctrl_c() -> Iterator[None]:
    """Block SIGINT while processes are started, which inherit this: Ctrl-C is for the command, which ends them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
