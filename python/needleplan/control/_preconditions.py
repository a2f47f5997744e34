"""Checks before the first motion: the table fits scenario and needle, and the needle is at the expected start."""

from __future__ import annotations

import math
import tomllib
from typing import Any

import numpy as np

from needleplan.control._driver import NeedleDriver
from needleplan.control._needle import NeedleState
from needleplan.control._options import Options
from needleplan.errors import DeviceFault, Mistake, PoseError, TableError
from needleplan.estimation.registration import Registration
from needleplan.planning import PolicyTable, Status
from needleplan.scenario import Identified, Scenario

__all__ = ["measured_entry", "require_expected", "require_fitting"]

# largest relative difference of the table's radius from an identified radius that has no interval
_DEFAULT_SHARE = 0.05


def require_fitting(
    table: PolicyTable, source: str, scenario: Scenario | None = None, needle: Identified | None = None
) -> None:
    """Raise TableError, with every difference, if a table does not fit the scenario or the needle, or is not converged.

    The needle fits if the radius of the table lies in the 95 % interval of the identified radius. If the interval is
    not finite, the radii may differ by 5 %.

    Parameters
    ----------
    table
        The table that an insertion would use.
    source
        Name of the table in the error message.
    scenario
        Scenario for which the table must have been planned; solver and title may differ. None: any scenario.
    needle
        Identified needle that the table must fit. None: any needle.

    Raises
    ------
    TableError
        If planning did not converge, an entry of the scenario differs, or the needle does not fit.

    """
    mistakes = []
    if table.stats.status is not Status.CONVERGED:
        mistakes.append(
            Mistake("status", table.stats.status, "must be converged; otherwise the success probabilities may be wrong")
        )
    if scenario is not None and scenario.digest != table.scenario.digest:
        mistakes += _differences(table.scenario, scenario)
    if needle is not None:
        radius = table.scenario.needle.curvature_radius_mm
        low, high = needle.interval_mm
        if not math.isfinite(low):
            low, high = (needle.radius_mm * share for share in (1 - _DEFAULT_SHARE, 1 + _DEFAULT_SHARE))
        if not min(low, high) <= radius <= max(low, high):
            rule = f"must be from {low:.4g} to {high:.4g} mm: the identified needle has {needle.radius_mm:.4g} mm"
            mistakes.append(Mistake("needle.curvature_radius_mm", f"{radius:g}", rule))
    if mistakes:
        raise TableError(mistakes, source)


def _differences(planned: Scenario, wanted: Scenario) -> list[Mistake]:
    """Return a mistake for every key of the scenario file, but solver and title, that differs."""
    planned_values, wanted_values = _keys(planned), _keys(wanted)
    mistakes = []
    for key in [*planned_values, *(key for key in wanted_values if key not in planned_values)]:
        if planned_values.get(key) != wanted_values.get(key):
            rule = f"must be equal to that of the scenario, {wanted_values.get(key, 'not set')}"
            mistakes.append(Mistake(key, str(planned_values.get(key, "not set")), rule))
    return mistakes


def _keys(scenario: Scenario) -> dict[str, Any]:
    """Return the values of a scenario file by dotted key; a list of tables is one value."""
    values: dict[str, Any] = {}
    for name, value in tomllib.loads(scenario.to_toml()).items():
        if name not in ("solver", "title", "schema"):
            values |= (
                {f"{name}.{key}": entry for key, entry in value.items()} if isinstance(value, dict) else {name: value}
            )
    return values


def measured_entry(
    needle: NeedleState, driver: NeedleDriver, registration: Registration, frames: int, oldest_s: float
) -> tuple[float, ...]:
    """Return the pose of the entry, averaged over `frames` frames of the needle at rest.

    The pose is x_mm, y_mm, heading_rad in the plane, and z_mm, elevation_rad out of it.

    The needle is assumed to be straight, so the entry lies on the axis of the coil. Raises DeviceFault if the tracker
    sends no usable frames, or if the median time between two frames is at least `oldest_s` (s), the age limit of the
    guard, because the insertion would then pause at every frame.
    """
    rows, times_ns = [], []
    for _ in range(frames):
        driver.settle(1)
        pose = needle.pose
        assert pose is not None
        times_ns.append(pose.stamp.received_ns)
        position, direction = registration.place(pose.position_mm, pose.quaternion)
        ahead = registration.coil_offset_mm - needle.path_mm
        rows.append([*(at + ahead * along for at, along in zip(position, direction, strict=True)), *direction])
    interval_s = float(np.median(np.diff(times_ns))) * 1e-9
    if interval_s >= oldest_s:
        raise DeviceFault(
            f"tracker: a frame arrives every {1e3 * interval_s:.0f} ms, and poses may be {1e3 * oldest_s:.0f} ms old: "
            "set a higher frame rate, or set safety.pose_age_s to more than the time between two frames"
        )
    x, y, z, dx, dy, dz = np.mean(rows, axis=0).tolist()
    return x, y, math.atan2(dy, dx), z, math.atan2(dz, math.hypot(dx, dy))


def require_expected(entry: tuple[float, ...], path_mm: float, options: Options) -> None:
    """Raise PoseError if the needle is not at its entry before the first motion.

    `path_mm` is the depth of the stage beyond the entry depth. If it is farther from 0 than `start_within_mm`, the zero
    of the stage is wrong, or the needle is not where the table begins; the loop would then drive the needle inward
    without a plan. `entry` (x_mm, y_mm, heading_rad ...) is the measured entry. It must be close to the
    `expected_start` of the options; without an `expected_start`, every entry is accepted.
    """
    if not abs(path_mm) <= options.start_within_mm:
        rule = (
            f"must be within {options.start_within_mm:g} mm of the entry depth, {options.entry_depth_mm:g} mm: move "
            "the needle to its entry, home the stage, or state the depth of the stage at the entry (--entry-depth)"
        )
        raise PoseError(Mistake("stage depth", f"{path_mm + options.entry_depth_mm:.2f} mm", rule))
    expected = options.expected_start
    if expected is None:
        return
    off_mm, off_rad = math.dist(_position(entry, expected), _position(expected, expected)), _angle_rad(entry, expected)
    if off_mm > options.start_within_mm or off_rad > options.start_within_rad:
        measured, where = _pose_text(entry[: len(expected)]), _pose_text(expected)
        rule = f"is {off_mm:.1f} mm and {math.degrees(off_rad):.1f} deg from the expected start, {where}"
        raise PoseError(Mistake("start", measured, rule))


def _position(pose: tuple[float, ...], expected: tuple[float, ...]) -> tuple[float, ...]:
    """Return x and y, and z if the expected pose has it."""
    return (*pose[:2], *(pose[3:4] if len(expected) > 3 else ()))


def _angle_rad(pose: tuple[float, ...], expected: tuple[float, ...]) -> float:
    """Return the angle between two directions: of the headings, or in 3D if the expected pose has an elevation."""
    turned = math.remainder(pose[2] - expected[2], 2 * math.pi)
    if len(expected) == 3:
        return abs(turned)
    up, expected_up = pose[4], expected[4]
    # Vincenty's form of the angle between two directions, which is accurate for small angles.
    aside = math.hypot(
        math.cos(up) * math.sin(turned),
        math.cos(expected_up) * math.sin(up) - math.sin(expected_up) * math.cos(up) * math.cos(turned),
    )
    return math.atan2(
        aside, math.sin(expected_up) * math.sin(up) + math.cos(expected_up) * math.cos(up) * math.cos(turned)
    )


def _pose_text(pose: tuple[float, ...]) -> str:
    text = f"x {pose[0]:.2f} mm, y {pose[1]:.2f} mm, heading {math.degrees(pose[2]):.2f} deg"
    if len(pose) == 3:
        return text
    return f"lattice {text}, z {pose[3]:.2f} mm, elevation {math.degrees(pose[4]):.2f} deg"
