"""Table 5.2: radii and errors, and their consistency."""

from __future__ import annotations

import math

import numpy as np

from needleplan.reports.comparison import Agreement, Comparison, Evidence
from needleplan.signals import Array
from needleplan_thesis.chapter5.insertions import (
    CASES,
    END_MM,
    MEMORY,
    NEEDLE,
    NO_FORCE,
    PRINTED,
    DeflectionCase,
    ForceProfile,
    coil_path,
    depths_mm,
    radius_mm,
    required_force_n,
    tip_force_n,
)

__all__ = ["arcs_apart_mm", "mean_offset_n", "memory_path", "missing_force_n", "table52"]

_SECTION = "ch5/Table 5.2"
# Assumed standard deviation (mm) and rate (Hz) of the tracker.
_TRACKER_MM, _RATE_HZ = 0.1, 40.0


def table52(step_mm: float) -> list[Comparison]:
    """Compare the radii, errors, percentages and axial forces of Table 5.2 with computed ones."""
    return [
        *(radius for case in CASES for radius in _radii(case, step_mm)),
        *(_percentage(case, printed) for case, printed in zip(CASES, (None, None, 8.7, 18.72), strict=True)),
        *(error for case in CASES for error in _errors(case)),
        *_axial_balance(step_mm),
        *_with_one_offset(step_mm),
        *_velocity(),
    ]


def arcs_apart_mm(case: DeflectionCase) -> tuple[float, float]:
    """Return two largest distances (mm) between the arcs of the measured and the estimated radius.

    The first is for arcs tangent at the entry, the second for arcs with the lateral offset that minimises the distance.
    """
    depth = np.linspace(0, END_MM, 801)
    apart = _arc(case.estimated_mm, depth) - _arc(case.measured_mm, depth)
    return float(np.abs(apart).max()), float(np.ptp(apart) / 2)


def missing_force_n(case: DeflectionCase, step_mm: float) -> float:
    """Return the part (N) of the largest axial force that the memory model does not explain.

    The explained parts are the shaft friction and the axial part of the cutting force that the estimated radius
    requires. NaN if no axial force was published.
    """
    _, force = required_force_n(MEMORY, case.tissue, case.velocity_mm_s, case.estimated_mm, step_mm)
    friction = case.tissue.friction_n_s_mm2 * case.velocity_mm_s * END_MM
    return float((case.greatest_n or math.nan) - friction - force[-1] * math.sin(NEEDLE.bevel_angle_rad))


def _radii(case: DeflectionCase, step_mm: float) -> list[Comparison]:
    depth = depths_mm(step_mm)
    known = next(each for each in CASES if each.greatest_n and each.tissue == case.tissue)
    end = tip_force_n(known.greatest_n or 0.0, known.tissue, known.velocity_mm_s, 0.0)
    forces = np.stack([end * profile.of(depth) for profile in ForceProfile])
    _, paths = coil_path(PRINTED, case.tissue, case.velocity_mm_s, forces, step_mm)
    computed = [f"{radius_mm(depth, path):.0f} {profile}" for profile, path in zip(ForceProfile, paths, strict=True)]
    why = f"{NO_FORCE}; computed with Fc = {end:.3f} N at 80 mm, from the largest force at 15 mm/s, F0 = 0"
    return [
        Comparison(
            f"{_SECTION}/{case.name}/estimated radius", case.estimated_mm, ", ".join(computed), "mm",
            Agreement.IMPOSSIBLE,
            f"{why}; negative: bent against the force on the bevel",
            kind=Evidence.IMPOSSIBLE,
        ),
        Comparison(
            f"{_SECTION}/{case.name}/measured radius", case.measured_mm, None, "mm", Agreement.IMPOSSIBLE,
            "a measurement; the curve was not published as numbers",
            kind=Evidence.IMPOSSIBLE,
        ),
    ]  # fmt: skip


def _percentage(case: DeflectionCase, printed: float | None) -> Comparison:
    computed = round(case.error_percent, 2)
    name = f"{_SECTION}/{case.name}/error of the radius"
    if printed is None:
        return Comparison(
            name,
            None,
            computed,
            "%",
            Agreement.OURS,
            "not printed; computed from the printed radii",
            kind=Evidence.ARITHMETIC,
        )
    same = abs(computed - printed) <= 0.01
    verdict = Agreement.REPRODUCED if same else Agreement.NOT_REPRODUCED
    return Comparison(
        name,
        printed,
        computed,
        "%",
        verdict,
        "computed from the printed radii: |estimated - measured|/measured",
        kind=Evidence.ARITHMETIC,
    )


def _errors(case: DeflectionCase) -> list[Comparison]:
    tangent, shifted = arcs_apart_mm(case)
    if shifted > case.max_error_mm:
        consistency = "impossible for arcs of these radii, with any offset"
    elif tangent > case.max_error_mm:
        consistency = "impossible for arcs of these radii that are tangent at the entry"
    else:
        consistency = "possible"
    reason = f"{consistency}; the circles have a free centre, or the curves are no arcs; {NO_FORCE}"
    return [
        Comparison(
            f"{_SECTION}/{case.name}/greatest error", case.max_error_mm,
            f"{tangent:.3f} between tangent arcs of the printed radii, {shifted:.3f} with the best offset", "mm",
            Agreement.IMPOSSIBLE, reason,
            kind=Evidence.IMPOSSIBLE,
        ),
        Comparison(
            f"{_SECTION}/{case.name}/mean error", case.mean_error_mm, None, "mm", Agreement.IMPOSSIBLE,
            "the measured curve was not published as numbers",
            kind=Evidence.IMPOSSIBLE,
        ),
    ]  # fmt: skip


def memory_path(case: DeflectionCase, offset_n: float, step_mm: float) -> tuple[Array, Array]:
    """Return depth and deflection (mm) of the coil in the memory model.

    The cutting force at 80 mm follows from the largest axial force minus the offset F0 = `offset_n`; it grows with
    depth as a circular path requires. The axial force was published for 15 mm/s only; the same cutting force is assumed
    at 10 mm/s.
    """
    known = next(each for each in CASES if each.greatest_n and each.tissue == case.tissue)
    end = tip_force_n(known.greatest_n or 0.0, known.tissue, known.velocity_mm_s, offset_n)
    _, needed = required_force_n(MEMORY, case.tissue, case.velocity_mm_s, case.estimated_mm, step_mm)
    force = np.concatenate([[0.0], needed]) / needed[-1] * end
    return coil_path(MEMORY, case.tissue, case.velocity_mm_s, force, step_mm)


def mean_offset_n(step_mm: float) -> float:
    """Return the mean of `missing_force_n` (N) over the cases with a published axial force."""
    return float(np.mean([missing_force_n(case, step_mm) for case in CASES if case.greatest_n]))


def _with_one_offset(step_mm: float) -> list[Comparison]:
    offset = mean_offset_n(step_mm)
    why = f"F0 = {offset:.3f} N for all cases, the mean remainder at 15 mm/s: a fit, not a prediction"
    return [
        Comparison(
            f"{_SECTION}/{case.name}/radius by the memory model", case.estimated_mm,
            round(radius_mm(*memory_path(case, offset, step_mm))), "mm", Agreement.OURS, why,
            kind=Evidence.ROUND_TRIP,
        )
        for case in CASES
    ]  # fmt: skip


def _axial_balance(step_mm: float) -> list[Comparison]:
    known = [case for case in CASES if case.greatest_n]
    missing = {case.name: missing_force_n(case, step_mm) for case in known}
    needed = {}
    for case in known:
        _, force = required_force_n(PRINTED, case.tissue, case.velocity_mm_s, case.estimated_mm, step_mm, behind_mm=9.3)
        friction = case.tissue.friction_n_s_mm2 * case.velocity_mm_s * END_MM
        needed[case.name] = friction + float(force[-1]) * math.sin(NEEDLE.bevel_angle_rad)
    rows = [
        Comparison(
            f"{_SECTION}/{case.name}/axial force that the printed model needs for its radius", case.greatest_n,
            round(needed[case.name], 3), "N",
            Agreement.NOT_REPRODUCED if needed[case.name] > (case.greatest_n or 0) else Agreement.REPRODUCED,
            "published: the largest measured force; the printed model requires more than that"
            if needed[case.name] > (case.greatest_n or 0) else "published: the largest measured force",
            kind=Evidence.COMPUTED,
        )
        for case in known
    ]  # fmt: skip
    remainders = ", ".join(f"{value:.3f} ({name[0]})" for name, value in missing.items())
    rows.append(
        Comparison(
            f"{_SECTION}/axial force left over by the memory model at 15 mm/s",
            None,
            remainders,
            "N",
            Agreement.OURS,
            "one constant F0 (Coulomb friction, rupture, sensor offset) would explain both tissues; no proof",
            kind=Evidence.COMPUTED,
        )
    )
    return rows


def _velocity() -> list[Comparison]:
    rows = []
    for slow, fast in ((CASES[0], CASES[2]), (CASES[1], CASES[3])):
        apart = slow.measured_mm - fast.measured_mm
        spread = math.hypot(*(_circle_sd_mm(each) for each in (slow, fast)))
        rows.append(
            Comparison(
                f"{_SECTION}/{slow.name[0]}/measured radius falls with velocity", round(apart, 1),
                f"{apart / spread:.1f} standard deviations", "mm", Agreement.OURS,
                "for white tracker noise of 0.1 mm at 40 Hz (assumed) and circles with a free centre; one insertion "
                "per case does not establish it",
                kind=Evidence.ARITHMETIC,
            )
        )  # fmt: skip
    return rows


def _circle_sd_mm(case: DeflectionCase) -> float:
    """Return the smallest standard deviation (mm) of the radius of a fitted circle: R^2 sigma sqrt(720/n)/L^2."""
    samples = END_MM / case.velocity_mm_s * _RATE_HZ
    return case.measured_mm**2 * _TRACKER_MM * math.sqrt(720 / samples) / END_MM**2


def _arc(radius: float, depth: np.ndarray) -> np.ndarray:
    return np.asarray(radius - np.sqrt(radius**2 - depth**2))
