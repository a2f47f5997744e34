"""Entry point of `needleplan reproduce ch5`: all comparisons and figures; Table 5.1 with the section of the needle."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from needleplan.reports.chapters import Effort
from needleplan.reports.comparison import Agreement, Comparison, Evidence
from needleplan_thesis.chapter5.dynamics import natural_frequencies_hz
from needleplan_thesis.chapter5.insertions import AREA_M2, CASES, NEEDLE, SECOND_MOMENT_M4
from needleplan_thesis.chapter5.table52 import table52
from needleplan_thesis.chapter5.table53 import table53
from needleplan_thesis.citations import cited

if TYPE_CHECKING:
    from needleplan.reports.chapters import Request
    from needleplan.reports.comparison import Comparison

__all__ = ["files", "residual_n", "run", "singular_force_n", "table51"]

# Depth step of the simulated insertions (mm).
_STEPS_MM = {Effort.QUICK: 4.0, Effort.DEFAULT: 1.0, Effort.FULL: 0.5}


def files(_: Request) -> tuple[str, ...]:
    """Return the names of the files that `run` writes into the output folder."""
    return ("fig_5_1.png", "fig_5_2.png")


def run(request: Request) -> list[Comparison]:
    """Return the comparisons of the chapter; draw both figures if the request names a folder."""
    step = _STEPS_MM[request.effort]
    request.note("Tables 5.1 and 5.2")
    comparisons = [*table51(), *table52(step)]
    request.note("Table 5.3")
    comparisons += table53(step)
    if request.folder:
        from needleplan_thesis.chapter5.figures import figure_5_1, figure_5_2

        request.note("Figs. 5.1 and 5.2")
        figure_5_1(request.folder, step)
        figure_5_2(request.folder, step)
    if request.effort is Effort.QUICK:
        comparisons = [
            replace(comparison, reason=f"quick: steps of 4 mm; {comparison.reason}".rstrip("; "))
            for comparison in comparisons
        ]
    return cited(comparisons)


def residual_n(force_n: float) -> float:
    """Return the larger residual (N) of the two end conditions (5.6) at x = L, with the coefficients of Table 5.1.

    The conditions use the sign convention of the thesis, EI phi''' = Fc cos a - Fc sin a phi' and phi'' = 0, with
    phi = (c3 x^3 + c2 x^2) Fc. `force_n` is the cutting force Fc. The moment is divided by L to obtain a force.
    """
    bending, length, alpha = NEEDLE.bending_stiffness_n_mm2, NEEDLE.length_mm, NEEDLE.bevel_angle_rad
    c3 = math.cos(alpha) / (6 * bending - 3 * length**2 * force_n * math.sin(alpha))
    c2 = -3 * length * c3
    slope, moment = (3 * c3 * length**2 + 2 * c2 * length) * force_n, (6 * c3 * length + 2 * c2) * force_n
    shear = 6 * c3 * bending * force_n - (force_n * math.cos(alpha) - force_n * math.sin(alpha) * slope)
    return max(abs(shear), abs(moment) * bending / length)


def singular_force_n() -> float:
    """Return the force (N) at which the coefficients of Table 5.1 become infinite, 2 EI/(L^2 sin a)."""
    return 2 * NEEDLE.bending_stiffness_n_mm2 / (NEEDLE.length_mm**2 * math.sin(NEEDLE.bevel_angle_rad))


def table51() -> list[Comparison]:
    """Compare the cross-section of the needle and the polynomial of Table 5.1 with computed values."""
    worst = max(residual_n(force) for force in (0.05, 0.15, 0.2, 0.25))
    greatest = max(case.greatest_n or 0 for case in CASES)
    frequency = float(natural_frequencies_hz(NEEDLE, CASES[0].tissue, 0.0, 1)[0])
    return [
        _rounded("I", SECOND_MOMENT_M4, NEEDLE.second_moment_mm4 * 1e-12, "m4"),
        _rounded("A", AREA_M2, NEEDLE.area_mm2 * 1e-6, "m2"),
        Comparison(
            "ch5/Table 5.1/c2 and c3 meet (5.6)", "yes", f"to {worst:.1e} N", "",
            Agreement.REPRODUCED if worst < 1e-12 else Agreement.NOT_REPRODUCED,
            kind=Evidence.COMPUTED,
        ),
        Comparison(
            "ch5/Table 5.1/force of infinite c2 and c3", None, round(singular_force_n(), 4), "N", Agreement.OURS,
            f"a sign error in the tip force: with the correct sign no force is singular; largest axial force "
            f"{greatest:g} N",
            kind=Evidence.COMPUTED,
        ),
        Comparison(
            "ch5/needle/lowest natural frequency in air", None, round(frequency, 2), "Hz", Agreement.OURS,
            "an insertion takes seconds, so inertia is negligible; rho is printed in kg/m2 instead of kg/m3",
            kind=Evidence.COMPUTED,
        ),
    ]  # fmt: skip


def _rounded(name: str, published: float, computed: float, unit: str) -> Comparison:
    same = abs(computed / published - 1) < 3e-4
    verdict = Agreement.REPRODUCED if same else Agreement.NOT_REPRODUCED
    return Comparison(
        f"ch5/needle/{name}", published, float(f"{computed:.6g}"), unit, verdict, kind=Evidence.ARITHMETIC
    )
