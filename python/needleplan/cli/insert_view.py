"""Display of a running insertion on the terminal: a table that is updated, or plain lines."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

from needleplan.cli.answer import printable, terminal
from needleplan.control import (
    ExecutedStep,
    Listener,
    Options,
    RunEvent,
    RunEventName,
    path_distances_mm,
)
from needleplan.control.safety import SafetyEvent
from needleplan.devices import ForceSample, PoseSample, Sample, StageSample
from needleplan.estimation.tip import TipEstimate

if TYPE_CHECKING:
    from rich.live import Live
    from rich.table import Table

    from needleplan import planning

__all__ = ["EventView", "LiveView", "PlainView", "view"]

_PERIOD_S = 0.1  # shortest time between two updates of the terminal
_FAR_MM = 30.0  # largest distance to obstacles that a 3D table has
_SPACE_NUMBERS = 6  # numbers of a 3D pose
_DELAY_S = 1.0  # time from the start of a run to its first display
_TOLD = {RunEventName.TABLE_SWAPPED, RunEventName.REPLAN_REFUSED, RunEventName.PAUSED, RunEventName.RESUMED,
         RunEventName.WAITING, RunEventName.FAULT, RunEventName.STOP}  # fmt: skip


class EventView(Listener):
    """Listener that prints one line for each important event."""

    def event(self, event: RunEvent) -> None:
        """Print an event whose name is in `_TOLD`: table swapped, replan refused, paused, resumed, fault, or stop."""
        if event.name in _TOLD:
            self._say(f"{event.name.replace('_', ' ')}: {event.text}" + (f" ({event.cause})" if event.cause else ""))

    def _say(self, text: str) -> None:
        print(text, file=sys.stderr)


class PlainView(EventView):
    """Listener that prints one line for each decision and each important event."""

    def __init__(self, table: planning.Table) -> None:
        self._table = table

    def _away(self, position_mm: tuple[float, ...]) -> tuple[float, str]:
        """Return the distance (mm) of a tip from the target's centre, and in 3D a text with that from obstacles."""
        scenario = self._table.scenario
        target: tuple[float, ...] = scenario.target_mm
        away_mm = math.dist(position_mm[: len(target)], target)
        if len(target) == 2:
            return away_mm, ""
        risk_mm = float(scenario.grid.clearance_at(np.array([position_mm]))[0])
        return away_mm, "no obstacle within 30 mm" if risk_mm >= _FAR_MM else f"{risk_mm:.1f} mm from an obstacle"

    def step(self, step: ExecutedStep) -> None:
        """Print a decision."""
        self._say(
            f"step {step.number:3d}  {step.action!s:20s} {step.length_mm:5.2f} mm at {step.path_mm:6.2f} mm: "
            f"{_place(step)} success {100 * step.success:.1f} % by the table" + self._risk_text(step)
        )

    def _risk_text(self, step: ExecutedStep) -> str:
        away_mm, risk = self._away(step.estimate.position_mm)
        return f"; {away_mm:.1f} mm to the target, {risk}" if risk else ""


class LiveView(PlainView):
    """Listener that shows a table of the current values on a terminal, and the lines of events above the table."""

    def __init__(self, live: Live, table: planning.Table, options: Options) -> None:
        super().__init__(table)
        self._live = live
        self._axis = options.force_axis
        self._samples: dict[type[Sample], Sample] = {}
        self._tip: TipEstimate | None = None
        self._step: ExecutedStep | None = None
        self._state, self._due_s, self._now_ns = "DISABLED", time.monotonic() + _DELAY_S, 0
        self._line = np.empty((0, 2))

    def sample(self, sample: Sample) -> None:
        """Store a sample, and update the terminal: first 1 s after the start, then at most every 0.1 s."""
        self._samples[type(sample)] = sample
        self._now_ns = max(self._now_ns, sample.stamp.received_ns)
        if time.monotonic() >= self._due_s:
            self._due_s = time.monotonic() + _PERIOD_S
            self._live.start()
            self._live.update(self.rows(), refresh=True)

    def tip(self, time_ns: int, path_mm: float, tip: TipEstimate) -> None:  # noqa: ARG002
        """Store the estimated tip; `time_ns` and `path_mm` are not used."""
        self._tip = tip

    def step(self, step: ExecutedStep) -> None:
        """Store a decision. At the first decision, also compute the planned path from its pose."""
        if self._step is None:
            self._line = self._table.path(step.pose).points_mm
        self._step = step

    def safety(self, event: SafetyEvent) -> None:
        """Store the state of the guard."""
        self._state = str(event.state)

    def rows(self) -> Table:
        """Return the table of current values."""
        from rich.table import Table

        rows = Table(show_header=False, box=None, padding=(0, 2))
        stage, force, pose = (self._samples.get(kind) for kind in (StageSample, ForceSample, PoseSample))
        rows.add_row("state", self._state)
        if isinstance(stage, StageSample):
            rows.add_row("depth", f"{stage.depth_mm:7.2f} mm at {stage.velocity_mm_s:6.2f} mm/s")
        if isinstance(force, ForceSample):
            along = sum(each * axis for each, axis in zip(force.force_n, self._axis, strict=True))
            rows.add_row("force", f"{along:7.2f} N")
        if self._tip:
            tip = self._tip
            place, heading = f"x {tip.x_mm:7.2f} mm  y {tip.y_mm:7.2f} mm", f"{math.degrees(tip.heading_rad):6.1f} deg"
            away_mm, risk = self._away(tip.position_mm)
            if risk:
                rows.add_row("tip", f"lattice {place}  z {tip.z_mm:7.2f} mm  {heading}")
                rows.add_row("target", f"{away_mm:7.2f} mm away; {risk}")
            else:
                rows.add_row("tip", f"{place}  {heading}")
                rows.add_row("target", f"{away_mm:7.2f} mm away in the plane; {tip.z_mm:+.2f} mm out of the plane")
            apart = float(path_distances_mm(self._line, np.array([tip.position_mm[: self._line.shape[1]]]))[0])
            rows.add_row("plan", f"{apart:7.2f} mm from its path")
            rows.add_row("radius", f"{1 / max(tip.curvature_per_mm, 1e-9):7.2f} mm estimated; {tip.status}")
        if self._step:
            step = self._step
            success = f"success {100 * step.success:.1f} % by the table"
            rows.add_row("action", f"step {step.number}: {step.action}, {success}")
        ages = [
            f"{name} {(self._now_ns - each.stamp.received_ns) * 1e-6:.0f} ms"
            for name, each in (("stage", stage), ("force", force), ("tracker", pose)) if each is not None
        ]  # fmt: skip
        rows.add_row("ages", ", ".join(ages))
        return rows

    def _say(self, text: str) -> None:
        self._live.console.print(printable(text), markup=False)


@contextmanager
def view(table: planning.Table, options: Options, command: argparse.Namespace) -> Iterator[Listener]:
    """Yield a listener that shows a run on standard error: `LiveView` on a terminal, otherwise `PlainView`.

    The listener shows nothing with `--quiet`, and events without the steps with `--json`.
    """
    if command.quiet or command.json:
        yield Listener() if command.quiet else EventView()
        return
    if not sys.stderr.isatty():
        yield PlainView(table)
        return
    from rich.console import Console
    from rich.live import Live

    live = Live(console=Console(file=terminal()), auto_refresh=False, transient=True)
    try:
        yield LiveView(live, table, options)
    finally:
        live.stop()


def _place(step: ExecutedStep) -> str:
    """Return the estimated tip of a step as a text; in 3D with z, and with the name of the frame."""
    tip = step.estimate
    frame, depth = ("lattice ", f", z {tip.z_mm:6.2f}") if len(step.pose) == _SPACE_NUMBERS else ("", "")
    return f"{frame}x {tip.x_mm:6.2f}, y {tip.y_mm:6.2f}{depth} mm, {math.degrees(tip.heading_rad):6.1f} deg,"
