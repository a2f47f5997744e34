"""An insertion in the lab twin that the page follows while it runs."""

from __future__ import annotations

import threading
from dataclasses import replace
from functools import singledispatch
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.config import SEED, Number
from needleplan.control import ExecutedStep, Insertion, Listener, Options, RunEvent
from needleplan.control.safety import SafetyLimits
from needleplan.devices import ForceSample, Sample
from needleplan.errors import NeedleplanError
from needleplan.page._recorded import packed_track
from needleplan.page._recorded_space import packed_space_track
from needleplan.page._requests import value_of
from needleplan.planning import PolicyTable, Pose, SpacePose, SpaceTable, Table
from needleplan.simulation import Simulation, simulated_station

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from needleplan.estimation.tip import TipEstimate
    from needleplan.page._requests import Request

__all__ = ["LabTwin"]

# The simulation whose robot, sensors, needle and effects the lab twin has: that of `needleplan insert`.
_SIMULATION = "steering"
# Share by which the needle may bend more or less than planned.
_ERROR = Number(at_least=-0.5, at_most=0.5)


class LabTwin:
    """Runs one insertion at a time in a thread, on simulated time; a new one stops the one before."""

    def __init__(self) -> None:
        self._changed = threading.Lock()
        self._run: _TwinRun | None = None

    def begin(self, table: Table, start: Pose | SpacePose, request: Request) -> None:
        """Begin an insertion by a table from a start.

        Parameters
        ----------
        table : Table
            The plan.
        start : Pose or SpacePose
            Where the needle enters.
        request : dict
            `seed` of the effects, and `curvature_error`: share by which the needle bends more than planned.

        Raises
        ------
        InputError
            If seed or share are outside of their range.
        """
        seed = value_of(request, "seed", SEED, 0)
        error = value_of(request, "curvature_error", _ERROR, 0.0)
        with self._changed:
            self._stop()
            self._run = _twin_run(table, start, seed, error)
            self._run.start()

    def state(self) -> bytes | None:
        """Return the message on the insertion up to now, as for a recording, or None if there was none."""
        run = self._run
        return None if run is None else run.message()

    def stop(self) -> None:
        """Stop the insertion that is running, and wait for its end."""
        with self._changed:
            self._stop()

    def _stop(self) -> None:
        if self._run is not None:
            self._run.stop()


class _TwinRun(Listener):
    """One insertion in a thread of its own, and what it has told."""

    def __init__(
        self,
        table: Table,
        start: Pose | SpacePose,
        seed: int,
        error: float,
        expected: tuple[float, ...],
    ) -> None:
        self._about: dict[str, Any] = {"seed": seed, "curvature_error": error}
        self._tip: list[tuple[float, ...]] = []
        self._force: list[tuple[float, float]] = []
        self._decisions: list[dict[str, Any]] = []
        self._events: list[dict[str, Any]] = []
        self._error_mm: float | None = None
        found = Simulation.read(_SIMULATION)
        effects = replace(found.setup.effects, curvature_error=error)
        found = replace(found, setup=replace(found.setup, effects=effects))
        self._station = simulated_station(found, table, start, seed)
        self._began_ns = self._station.clock.now_ns()
        self._options = Options(
            longest_mm=SafetyLimits().deepest_mm, torsion=self._station.torsion,
            needle_length_mm=self._station.needle_length_mm, expected_start=expected,
        )  # fmt: skip
        self._insertion = Insertion(
            table, self._station, self._options, registration=self._station.registration, listeners=[self],
        )  # fmt: skip
        self._thread = threading.Thread(target=self._work, name="needleplan lab twin")

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        if self._thread.is_alive():
            self._insertion.stop("stopped in the page")
        self._thread.join()

    def message(self) -> bytes:
        running = self._thread.is_alive()  # before the lists are read, so that the last message has all of them
        tip, force = np.array(self._tip[:]).reshape(-1, 5), np.array(self._force[:]).reshape(-1, 2)
        decisions, events = self._decisions[:], self._events[:]
        last_s = [float(rows[-1, 0]) for rows in (tip, force) if len(rows)] + [each["time_s"] for each in events]
        header = {
            **self._about, "running": running, "duration_s": max(last_s, default=0.0), "decisions": decisions,
            "events": events,
        }  # fmt: skip
        return self._packed(header, tip, force)

    def _packed(self, header: dict[str, Any], tip: NDArray[np.float64], force: NDArray[np.float64]) -> bytes:
        """Return the message; `tip` has time (s), x, y, z or heading, and depth, `force` time (s) and axial force."""
        raise NotImplementedError

    def _row(self, tip: TipEstimate) -> tuple[float, float, float]:
        raise NotImplementedError

    def sample(self, sample: Sample) -> None:
        if isinstance(sample, ForceSample):
            axis = self._options.force_axis
            along = sum(a * b for a, b in zip(sample.force_n, axis, strict=True))
            self._force.append((self._time_s(sample.stamp.received_ns), along))

    def tip(self, time_ns: int, path_mm: float, tip: TipEstimate) -> None:
        self._tip.append((self._time_s(time_ns), *self._row(tip), path_mm))

    def step(self, step: ExecutedStep) -> None:
        place = dict(zip(("x_mm", "y_mm", "z_mm"), step.pose, strict=False))
        self._decisions.append(
            {"time_s": self._time_s(step.time_ns), **place, "action": step.action.name.lower(), "success": step.success}
        )

    def event(self, event: RunEvent) -> None:
        told = {"name": str(event.name), "cause": event.cause, "text": event.text}
        self._events.append({"time_s": self._time_s(event.time_ns), **told})

    def _time_s(self, time_ns: int) -> float:
        return (time_ns - self._began_ns) * 1e-9

    def _work(self) -> None:
        try:
            with self._station, self._insertion:
                self._error_mm = self._insertion.run().error_mm
        except NeedleplanError as error:  # a fault of the simulated devices is an outcome of the run
            last_s = self._tip[-1][0] if self._tip else 0.0
            self._events.append({"time_s": last_s, "name": "fault", "cause": str(error), "text": ""})


class _PlaneTwinRun(_TwinRun):
    """An insertion by a plan in a plane."""

    def __init__(self, table: PolicyTable, start: Pose, seed: int, error: float) -> None:
        expected = (start.x_mm, start.y_mm, start.heading_rad)
        super().__init__(table, start, seed, error, expected)
        self._about["plan"], self._scenario = table.scenario.digest, table.scenario

    def _row(self, tip: TipEstimate) -> tuple[float, float, float]:
        return tip.x_mm, tip.y_mm, tip.heading_rad

    def _packed(self, header: dict[str, Any], tip: NDArray[np.float64], force: NDArray[np.float64]) -> bytes:
        return packed_track(header | {"error_mm": self._error_mm}, self._scenario, tip[:, :4], force)


class _SpaceTwinRun(_TwinRun):
    """An insertion by a 3D plan."""

    def __init__(self, table: SpaceTable, start: SpacePose, seed: int, error: float) -> None:
        heading, elevation = start.angles_rad
        expected = (start.x_mm, start.y_mm, heading, start.z_mm, elevation)
        super().__init__(table, start, seed, error, expected)
        self._table, self._planned = table, table.path(start).points_mm

    def _row(self, tip: TipEstimate) -> tuple[float, float, float]:
        return tip.x_mm, tip.y_mm, tip.z_mm

    def _packed(self, header: dict[str, Any], tip: NDArray[np.float64], force: NDArray[np.float64]) -> bytes:
        return packed_space_track(header, self._table, self._planned, tip, force)


@singledispatch
def _twin_run(table: Table, start: Any, seed: int, error: float) -> _TwinRun:
    raise NotImplementedError(type(table))


_twin_run.register(PolicyTable, _PlaneTwinRun)
_twin_run.register(SpaceTable, _SpaceTwinRun)
