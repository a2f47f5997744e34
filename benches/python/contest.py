"""Measuring a contestant of `compare_peers.py`: in a process of its own, with a time limit.

That process is `python contestants.py NAME FOLDER`, which calls `serve`. It reads the problem from FOLDER, builds the
contestant's input, solves it a few times and prints a line of JSON.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from importlib import import_module
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from problem import Problem

_MARK = "RESULT "


@dataclass(frozen=True)
class Answer:
    """Result of a solver. `values()` returns the values by state (the last may be missing) and is not timed."""

    values: Callable[[], NDArray[np.floating[Any]]]
    facts: dict[str, float] = field(default_factory=dict)


Solve = Callable[[], Answer]
Prepare = Callable[[Problem], Solve]


@dataclass(frozen=True)
class Contestant:
    """A solver in the comparison.

    `prepare` returns the solver, ready to run. The duration of `prepare` is the build time; `module` is imported before
    it. `warm_up` is the number of runs before the timed ones (compilation, first access to memory).
    """

    name: str
    label: str
    prepare: Prepare
    module: str = "needleplan.planning"
    repeats: int = 1
    warm_up: int = 0
    note: str = ""


@dataclass(frozen=True)
class Result:
    """Build and solve times (s), largest error (units of cost) and peak memory (GB), or the text of a `failure`."""

    name: str
    label: str
    failure: str = ""
    build: float = 0.0
    solves: list[float] = field(default_factory=list)
    error: float = float("nan")
    peak_gb: float = 0.0
    facts: dict[str, float] = field(default_factory=dict)
    note: str = ""

    @property
    def median(self) -> float:
        """Median solve time (s); NaN if the solver failed."""
        return median(self.solves) if self.solves else float("nan")

    @property
    def least(self) -> float:
        """Shortest solve time (s); NaN if the solver failed."""
        return min(self.solves, default=float("nan"))

    def renamed(self, name: str) -> Result:
        """Return this result under another name."""
        return replace(self, name=name)


def compete(contestant: Contestant, folder: Path) -> Result:
    """Run a contestant in this process and return its times, error and memory."""
    problem = Problem.read(folder)
    import_module(contestant.module)
    began = perf_counter()
    solve = contestant.prepare(problem)
    build = perf_counter() - began
    for _ in range(contestant.warm_up):
        answer = solve()
    solves = []
    for _ in range(contestant.repeats):
        began = perf_counter()
        answer = solve()
        solves.append(perf_counter() - began)
    values = np.asarray(answer.values(), dtype=np.float64).ravel()
    error = float(np.abs(values - np.load(folder / "reference.npy")[: len(values)]).max())
    peak_gb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9
    named = _named(contestant)
    return replace(named, build=build, solves=solves, error=error, peak_gb=peak_gb, facts=answer.facts)


def measure(contestant: Contestant, folder: Path, time_limit_s: float) -> Result:
    """Measure a contestant in a process of its own. If it fails or exceeds the limit, the result has a `failure`."""
    command = [sys.executable, str(Path(__file__).with_name("contestants.py").resolve()), contestant.name, str(folder)]
    named = _named(contestant)
    with tempfile.TemporaryFile("w+") as output, tempfile.TemporaryFile("w+") as errors:
        try:
            done = subprocess.run(command, stdout=output, stderr=errors, timeout=time_limit_s, check=False)
        except subprocess.TimeoutExpired:
            return replace(named, failure=f"not done after {time_limit_s:.0f} s")
        output.seek(0)
        for line in output:
            if line.startswith(_MARK):
                return Result(**json.loads(line.removeprefix(_MARK)))
        errors.seek(0)
        said = [line.strip() for line in errors if line.strip()]
    return replace(named, failure=said[-1][:200] if said else f"ended with exit code {done.returncode}")


def _named(contestant: Contestant) -> Result:
    return Result(contestant.name, contestant.label, note=contestant.note)


def serve(contestants: Mapping[str, Contestant]) -> None:
    """Measure the contestant that the command line names, and print its result as one line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", choices=sorted(contestants))
    parser.add_argument("folder", type=Path)
    options = parser.parse_args()
    print(_MARK + json.dumps(asdict(compete(contestants[options.name], options.folder))), flush=True)
