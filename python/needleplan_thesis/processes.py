"""Map a function over tasks in several processes, which Ctrl-C ends without a traceback."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

__all__ = ["map_in_processes"]

_Task = TypeVar("_Task")
_Result = TypeVar("_Result")


def map_in_processes(
    function: Callable[[_Task], _Result], tasks: Sequence[_Task], processes: int, chunk: int = 1
) -> Iterator[_Result]:
    """Yield `function(task)` for every task, in the order of the tasks.

    If `processes` is 1, the function is called in this process. Otherwise each process takes `chunk` tasks at a time.
    """
    if processes == 1:
        yield from map(function, tasks)
        return
    # Spawned, not forked: a child would lack the threads of the planner.
    with ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("spawn")) as pool:
        # The workers inherit the blocked interrupt, so Ctrl-C reaches this process alone.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            results = pool.map(function, tasks, chunksize=chunk)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        try:
            yield from results
        except BaseException:
            for child in multiprocessing.active_children():
                child.terminate()
            raise
