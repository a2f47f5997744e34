"""Live view of an insertion in 3D Slicer."""

from __future__ import annotations

import math

import numpy as np

from needleplan.control import ExecutedStep, Listener, RunEvent, RunEventName, drawn
from needleplan.control.safety import OperatingState, SafetyEvent
from needleplan.devices import ForceSample, Sample
from needleplan.devices.igtl import SlicerServer, StatusCode
from needleplan.estimation.tip import TipEstimate
from needleplan.planning import PolicyTable

__all__ = ["SlicerView"]

# smallest distance (mm) between two shown points of the executed path
_SPACING_MM = 0.5
# smallest time (ns) between two shown force values
_FORCE_NS = 100_000_000
_CODES = {
    OperatingState.ENABLED: StatusCode.OK,
    OperatingState.PAUSED: StatusCode.NOT_READY,
    OperatingState.DISABLED: StatusCode.NOT_READY,
    OperatingState.FAULT: StatusCode.HARDWARE_FAILURE,
}


class SlicerView(Listener):
    """Listener that shows tip, target, planned and executed path, force and guard state in 3D Slicer."""

    def __init__(self, server: SlicerServer, table: PolicyTable) -> None:
        self._server, self._table = server, table
        self._path: list[tuple[float, float, float]] = []
        self._planned_with = ""
        self._force_ns = 0
        x, y = table.scenario.target.center_mm
        server.show_target((x, y, 0.0), 2 * table.scenario.target.radius_mm)

    def sample(self, sample: Sample) -> None:
        """Show a force sample, at most ten times a second."""
        now_ns = sample.stamp.received_ns
        if isinstance(sample, ForceSample) and now_ns >= self._force_ns and all(map(math.isfinite, sample.force_n)):
            self._force_ns = now_ns + _FORCE_NS
            self._server.show_force(sample.force_n)

    def tip(self, time_ns: int, path_mm: float, tip: TipEstimate) -> None:  # noqa: ARG002
        """Show the tip and, if it is at least 0.5 mm from the last shown point of the executed path, this path."""
        place = (tip.x_mm, tip.y_mm, tip.z_mm)
        half = tip.heading_rad / 2
        self._server.show_tip(place, (math.cos(half), 0.0, 0.0, math.sin(half)))
        if not self._path or math.dist(place, self._path[-1]) >= _SPACING_MM:
            self._path.append(place)
            self._server.show_path(self._path)

    def step(self, step: ExecutedStep) -> None:
        """Show the action and its success probability; at the first decision, also show the planned path."""
        if not self._planned_with:
            self._planned_with = step.table_digest
            line = drawn(self._table.path(step.pose), self._table)
            self._server.show_plan([(x, y, 0.0) for x, y in np.asarray(line).tolist()])
        self._server.show_note(f"step {step.number}: {step.action}, success {100 * step.success:.1f} %")

    def event(self, event: RunEvent) -> None:
        """Show the text of an event that is a pause, a new table or the end of the run."""
        if event.name in (RunEventName.END, RunEventName.TABLE_SWAPPED, RunEventName.PAUSED):
            self._server.show_note(f"{event.name.replace('_', ' ')}: {event.text}")

    def safety(self, event: SafetyEvent) -> None:
        """Show the state of the guard."""
        self._server.show_state(str(event.state), _CODES[event.state], ", ".join(sorted(event.causes)))
