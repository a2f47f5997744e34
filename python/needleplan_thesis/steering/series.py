"""Many insertions, in several processes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from needleplan_thesis.processes import map_in_processes
from needleplan_thesis.steering.course import Task
from needleplan_thesis.steering.trial import Trial, run_trial

__all__ = ["run_all"]


def run_all(tasks: Sequence[Task], processes: int = 1) -> Iterator[Trial]:
    """Yield what comes of each task, in their order."""
    return map_in_processes(run_trial, tasks, processes, chunk=4)
