"""Many insertions, in several processes."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor

from needleplan_thesis.steering.course import Task
from needleplan_thesis.steering.trial import Trial, run_trial

__all__ = ["run_all"]


def run_all(tasks: Sequence[Task], processes: int = 1) -> Iterator[Trial]:
    """Yield what comes of each task, in their order."""
    if processes == 1:
        yield from map(run_trial, tasks)
        return
    # Not forked: threads of the planner would not be in the child.
    with ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("spawn")) as pool:
        yield from pool.map(run_trial, tasks, chunksize=4)
