"""What `needleplan insert` takes from its table, in the plane and in 3D: checks, start, frame, answer and figure."""

from __future__ import annotations

import argparse
import math
from abc import ABC, abstractmethod
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from needleplan.cli.options import read_table, require_absent
from needleplan.cli.uncertainty import promise_lines, promised, read_model, read_registered, read_uncertainty
from needleplan.errors import InputError, Mistake, SweepError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from matplotlib.figure import Figure

    from needleplan.control import InsertionReport
    from needleplan.estimation.registration import Registration
    from needleplan.estimation.tip import TipSettings
    from needleplan.models.path import Vector
    from needleplan.planning import PolicyTable, Pose, Promise, SpacePose, SpaceTable, Success, Table
    from needleplan.scenario import Identified
    from needleplan.sweep import CurvatureLookup

__all__ = [
    "InsertPlan",
    "PlaneInsertPlan",
    "SpaceInsertPlan",
    "insert_plan_class",
    "read_insert_plan",
    "read_insert_table_set",
]


class InsertPlan(ABC):
    """A table and the start of an insertion by it."""

    table: Table
    start: Pose | SpacePose
    model: Identified | None = None
    promise: Promise | None = None

    @property
    @abstractmethod
    def expected_start(self) -> tuple[float, ...]:
        """The start as `Options.expected_start`."""

    @property
    def target_mm(self) -> tuple[float, ...]:
        """Centre of the target in the frame of the plan."""
        center: tuple[float, ...] = self.table.scenario.target_mm
        return center

    @property
    def target_radius_mm(self) -> float:
        """Radius of the target."""
        return float(self.table.scenario.target_radius_mm)

    @property
    def target_in_registration_mm(self) -> Vector:
        """Centre of the target in the frame to which a registration of a user leads."""
        x, y, z = (*self.target_mm, 0.0)[:3]
        return x, y, z

    @abstractmethod
    def success(self) -> Success:
        """Return the success of the plan from the start, from the same source as `plan` and `entry`."""

    def make_promise(self, options: argparse.Namespace, coil_mm: float | None = None) -> Iterator[str]:
        """Compute the promise from the start with the errors that the options and files state; yield its lines.

        `coil_mm` is the distance of the coil behind the tip in a simulated lab.
        """
        registered = read_registered(options.registration)
        if coil_mm is not None:
            registered.setdefault("coil_mm", coil_mm)
        planned_per_mm = 1 / self.table.scenario.needle.curvature_radius_mm if self.model else None
        uncertainty = read_uncertainty(options, registered, self.model, planned_per_mm)
        self.promise = promised(self.table, uncertainty, self.start)
        yield from (f"{name}: {line}" for name, line in promise_lines(self.promise).items())

    @abstractmethod
    def tip_settings(self, noise_rad_sqrt_mm: float | None = None) -> TipSettings:
        """Return the settings of the tip filter, with the tip noise of the lab, or else of the plan."""

    @abstractmethod
    def placed(self, registration: Registration) -> Registration:
        """Return a registration of a user as one to the frame of the plan."""

    def warnings(self, options: argparse.Namespace, force_limit_n: float) -> Iterator[str]:
        """Yield warnings where the shaft can buckle."""
        from needleplan.cli._buckling import buckling_warnings

        yield from buckling_warnings(options, self.table.path(self.start).length_mm, force_limit_n)

    def record(self, report: InsertionReport) -> dict[str, Any]:  # noqa: ARG002
        """Return keys that the JSON record has in addition to the record of the report."""
        return {}

    @abstractmethod
    def figure(self, report: InsertionReport, true_tip_mm: Vector | None) -> Figure:
        """Return the figure of the insertion."""

    def vtp(self, report: InsertionReport) -> bytes:  # noqa: ARG002
        """Return both paths as a VTP file. Raises InputError in the plane."""
        raise InputError(Mistake("--vtp", "", "needs a 3D table"))

    @abstractmethod
    def errors(self, report: InsertionReport) -> str:
        """Return the parts of the distance from the centre of the target as a text."""

    @abstractmethod
    def deviations(self, report: InsertionReport) -> str:
        """Return the deviations from the planned path as a text."""

    @abstractmethod
    def true_record(self, tip_mm: Vector, target_mm: Vector) -> dict[str, Any]:
        """Return the JSON record of the true positions in a simulated lab."""


class PlaneInsertPlan(InsertPlan):
    """A table in the plane."""

    table: PolicyTable
    start: Pose
    model: Identified | None

    def __init__(self, table: PolicyTable, options: argparse.Namespace) -> None:
        from needleplan.control import require_fitting
        from needleplan.scenario import Scenario

        self.table = table
        require_absent(options, ["--vtp"], "needs a 3D table")
        self.model = read_model(options.needle)
        scenario = Scenario.read(options.scenario) if options.scenario else None
        require_fitting(table, options.table, scenario, self.model)
        self.start = _start(table, options)

    @property
    def expected_start(self) -> tuple[float, ...]:
        """Pose at which the insertion starts: x_mm, y_mm and heading_rad."""
        return self.start.x_mm, self.start.y_mm, self.start.heading_rad

    def success(self) -> Success:
        """Return the success by the table."""
        from needleplan.planning import Success

        return Success(self.table.lookup(*self.start).success)

    def tip_settings(self, noise_rad_sqrt_mm: float | None = None) -> TipSettings:
        """Return the settings of the tip filter: tip noise, and scatter of the entry of `--needle`."""
        from needleplan.control import planned_tip_settings

        settings = planned_tip_settings(self.table, noise_rad_sqrt_mm)
        if self.model is None or self.model.entry is None:
            return settings
        entry = self.model.entry
        return replace(
            settings,
            entry_sd_mm=max(settings.entry_sd_mm, entry.offset_sd_mm),
            entry_sd_rad=max(settings.entry_sd_rad, entry.heading_sd_rad),
        )

    def placed(self, registration: Registration) -> Registration:
        """Return the registration: its frame is the plane of the plan."""
        return registration

    def figure(self, report: InsertionReport, true_tip_mm: Vector | None) -> Figure:
        """Return the figure of the insertion in the workspace."""
        from needleplan.reports.insertion import insertion_figure

        return insertion_figure(self.table, report, true_tip_mm)

    def errors(self, report: InsertionReport) -> str:
        """Return the distances in the plane and out of it."""
        return f"{report.error_mm:.2f} mm in the plane, {report.error_out_of_plane_mm:.2f} mm out of it"

    def deviations(self, report: InsertionReport) -> str:
        """Return the deviations in the plane and out of it."""
        return (
            f"at most {report.deviation_mm:.2f} mm from the planned path, {report.out_of_plane_mm:.2f} mm out of the "
            "plane"
        )

    def true_record(self, tip_mm: Vector, target_mm: Vector) -> dict[str, Any]:
        """Return the true error in the plane."""
        return {"true_error_mm": math.dist(tip_mm[:2], target_mm[:2])}


class SpaceInsertPlan(InsertPlan):
    """A 3D table. The plan uses the frame of the lattice; a registration by the user leads to RAS."""

    table: SpaceTable
    start: SpacePose

    def __init__(self, table: SpaceTable, options: argparse.Namespace) -> None:
        self.table = table
        rule = "is for a table in the plane, and this is a 3D table"
        require_absent(options, ["--scenario", "--needle"], rule)
        self.start = _start(table, options)

    @property
    def expected_start(self) -> tuple[float, ...]:
        """Pose at which the insertion starts: x_mm, y_mm, heading_rad, z_mm and elevation_rad."""
        heading, elevation = self.start.angles_rad
        return self.start.x_mm, self.start.y_mm, heading, self.start.z_mm, elevation

    @property
    def target_in_registration_mm(self) -> Vector:
        """Centroid of the target in RAS."""
        frame = self.table.scenario.grid.frame
        x, y, z = (frame.axes.T @ self.target_mm + frame.origin_mm).tolist()
        return x, y, z

    def success(self) -> Success:
        """Return the success by executions."""
        return self.table.estimate(self.start)

    def tip_settings(self, noise_rad_sqrt_mm: float | None = None) -> TipSettings:
        """Return the settings of the tip filter: the tip noise."""
        from needleplan.control import planned_tip_settings

        return planned_tip_settings(self.table, noise_rad_sqrt_mm)

    def placed(self, registration: Registration) -> Registration:
        """Return the registration to the lattice that follows one to RAS."""
        frame = self.table.scenario.grid.frame
        return registration.followed_by(frame.axes, -(frame.axes @ frame.origin_mm))

    def figure(self, report: InsertionReport, true_tip_mm: Vector | None) -> Figure:
        """Return the figure of the insertion in three slices and in 3D."""
        from needleplan.reports.insertion import space_insertion_figure

        return space_insertion_figure(self.table, report, true_tip_mm)

    def record(self, report: InsertionReport) -> dict[str, Any]:
        """Return the last estimate of the tip in RAS, and the smallest distance of the estimates from obstacles."""
        grid, inside = self.table.scenario.grid, report.executed_mm[report.path_mm > 0]
        place = report.tip and grid.frame.world(report.tip.position_mm).tolist()
        clearance_mm = float(grid.clearance_at(inside).min()) if len(inside) else None
        return {"tip_ras_mm": place, "clearance_mm": clearance_mm}

    def vtp(self, report: InsertionReport) -> bytes:
        """Return planned path (`executed` 0) and estimated tip (1) as a VTP file in RAS."""
        from needleplan.reports.insertion import insertion_vtp

        return insertion_vtp(self.table, report)

    def errors(self, report: InsertionReport) -> str:
        """Return the distances across and along the planned direction, and the error of the direction."""
        errors = report.space
        if errors is None:
            return "not known"
        return (
            f"{report.error_mm:.2f} mm across the planned direction, {errors.along_mm:+.2f} mm along it, direction "
            f"{math.degrees(errors.direction_rad):.1f} deg off"
        )

    def deviations(self, report: InsertionReport) -> str:
        """Return the deviation from the planned path."""
        clearance_mm = self.record(report)["clearance_mm"]
        nearest = "" if clearance_mm is None else f"; at least {clearance_mm:.1f} mm from obstacles"
        return f"at most {report.deviation_mm:.2f} mm from the planned path{nearest}"

    def true_record(self, tip_mm: Vector, target_mm: Vector) -> dict[str, Any]:  # noqa: ARG002
        """Return the true position in RAS, and whether it is in the target."""
        import numpy as np

        from needleplan.anatomy import TARGET

        scenario = self.table.scenario
        place = np.array(tip_mm, float)
        return {
            "true_tip_ras_mm": scenario.grid.frame.world(place).tolist(),
            "true_tip_in_target": bool(scenario.codes(place) == TARGET),
        }


def read_insert_plan(options: argparse.Namespace) -> InsertPlan:
    """Read the table that the options name, and check that it fits them. Raises InputError."""
    table = read_table(options)
    found: InsertPlan = insert_plan_class(table)(table, options)
    return found


def insert_plan_class(table: Table) -> type[Any]:
    """Return the `InsertPlan` of a table: `PlaneInsertPlan` or `SpaceInsertPlan`."""
    from needleplan.planning import PolicyTable, SpaceTable

    return {PolicyTable: PlaneInsertPlan, SpaceTable: SpaceInsertPlan}[type(table)]


def read_insert_table_set(options: argparse.Namespace, table: Table) -> CurvatureLookup | None:
    """Return the tables of `--table-set` that fit the plan, or None without the option.

    Raises SweepError if it has no table that differs from the plan in nothing but the curvature, and InputError if
    replanning is switched off.
    """
    if not options.table_set:
        return None
    from needleplan.sweep import CurvatureLookup, TableSet

    if options.no_replan:
        raise InputError(Mistake("--table-set", options.table_set, "must be left out with --no-replan"))
    stored = CurvatureLookup(TableSet.open(options.table_set), table.scenario)
    if not len(stored):
        rule = f"has no table that differs from {options.table} in nothing but the curvature"
        raise SweepError(rule, options.table_set)
    return stored


def _start(table: Table, options: argparse.Namespace) -> Any:
    # Not at the top: planning takes a quarter of a second to import, which every other command would wait for.
    from needleplan.cli.table_poses import poses_of

    return poses_of(table).start(options.start)
