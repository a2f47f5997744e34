"""Live view of an insertion in 3D Slicer: in the frame of the plan in the plane, in RAS in 3D."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from needleplan.control import ExecutedStep, Listener, RunEvent, RunEventName
from needleplan.control.safety import OperatingState, SafetyEvent
from needleplan.devices import ForceSample, Sample
from needleplan.devices.igtl import SlicerServer, StatusCode
from needleplan.estimation.tip import TipEstimate
from needleplan.planning import Table

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

    def __init__(self, server: SlicerServer, table: Table) -> None:
        self._server, self._table = server, table
        self._path: list[tuple[float, float, float]] = []
        self._planned_with = ""
        self._force_ns = 0
        self._axes, self._origin_mm = table.scenario.frame_axes, table.scenario.frame_origin_mm
        server.show_target(self._shown(table.scenario.target_mm), 2 * table.scenario.target_radius_mm)

    def sample(self, sample: Sample) -> None:
        """Show a force sample, at most ten times a second."""
        now_ns = sample.stamp.received_ns
        if isinstance(sample, ForceSample) and now_ns >= self._force_ns and all(map(math.isfinite, sample.force_n)):
            self._force_ns = now_ns + _FORCE_NS
            self._server.show_force(sample.force_n)

    def tip(self, time_ns: int, path_mm: float, tip: TipEstimate) -> None:  # noqa: ARG002
        """Show the tip and, if it is at least 0.5 mm from the last shown point of the executed path, this path."""
        place = self._shown(tip.position_mm)
        self._server.show_tip(place, self._orientation(tip))
        if not self._path or math.dist(place, self._path[-1]) >= _SPACING_MM:
            self._path.append(place)
            self._server.show_path(self._path)

    def step(self, step: ExecutedStep) -> None:
        """Show the action and its success probability; at the first decision, also show the planned path."""
        if not self._planned_with:
            self._planned_with = step.table_digest
            line = self._table.path(step.pose).points_mm.tolist()
            self._server.show_plan([self._shown(point) for point in line])
        self._server.show_note(f"step {step.number}: {step.action}, success {100 * step.success:.1f} % by the table")

    def _shown(self, position_mm: Sequence[float]) -> tuple[float, float, float]:
        """Return a position of the plan (mm) in the frame that is shown."""
        place = np.resize([*position_mm, 0.0], 3)  # the plane is at z = 0
        x, y, z = (place @ self._axes + self._origin_mm).tolist()
        return x, y, z

    def _orientation(self, tip: TipEstimate) -> tuple[float, float, float, float]:
        """Return the quaternion (w, x, y, z) that turns x to the direction of the tip."""
        turned = Rotation.from_euler("ZY", [tip.heading_rad, -tip.elevation_rad])
        w, x, y, z = (Rotation.from_matrix(self._axes.T) * turned).as_quat(scalar_first=True).tolist()
        return w, x, y, z

    def event(self, event: RunEvent) -> None:
        """Show the text of an event that is a pause, a new table or the end of the run."""
        if event.name in (RunEventName.END, RunEventName.TABLE_SWAPPED, RunEventName.PAUSED):
            self._server.show_note(f"{event.name.replace('_', ' ')}: {event.text}")

    def safety(self, event: SafetyEvent) -> None:
        """Show the state of the guard."""
        self._server.show_state(str(event.state), _CODES[event.state], ", ".join(sorted(event.causes)))
