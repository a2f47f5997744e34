"""Table 5.3: effect of wrong values of kf and vf on the radius, and the statements of the text."""

from __future__ import annotations

import numpy as np

from needleplan.reports.comparison import Agreement, Comparison, Evidence
from needleplan_thesis.chapter5.insertions import (
    CASES,
    CHANGES,
    MEMORY,
    NO_FORCE,
    PRINTED,
    SENSITIVITY,
    DeflectionCase,
    ParameterChange,
    Reading,
    coil_path,
    depths_mm,
    radius_mm,
    required_force_n,
)

__all__ = ["radius_change", "table53"]

_SECTION = "ch5/Table 5.3"


def radius_change(
    reading: Reading, case: DeflectionCase, changes: tuple[ParameterChange, ...], speed: float, step_mm: float
) -> list[float]:
    """Return, for each parameter change, the ratio of the radius of the coil's path to the radius without the change.

    The cutting force is the same in all simulations: the one that the printed estimated radius requires. `speed`
    multiplies the velocity in the simulations with a change.
    """
    _, force = required_force_n(reading, case.tissue, case.velocity_mm_s, case.estimated_mm, step_mm, behind_mm=0.0)
    force = np.concatenate([[0.0], force])
    depth = depths_mm(step_mm)

    def radius(change: ParameterChange, factor: float) -> float:
        _, path = coil_path(reading, change.of(case.tissue), factor * case.velocity_mm_s, force, step_mm)
        return radius_mm(depth, path)

    nominal = radius(ParameterChange("", 1.0, 1.0), 1.0)
    return [radius(change, speed) / nominal for change in changes]


def table53(step_mm: float) -> list[Comparison]:
    """Compare the cells of Table 5.3, the statements of the text, and the signs of the changes of the radius."""
    factors = {
        reading.name: np.array([radius_change(reading, case, CHANGES, 1.0, step_mm) for case in CASES]).T
        for reading in (MEMORY, PRINTED)
    }
    cells = [
        Comparison(
            f"{_SECTION}/{case.name}/{change.name}", SENSITIVITY[row][column],
            ", ".join(
                f"{_error(case, values[row, column]):.2f} ({100 * (values[row, column] - 1):+.1f} %, {name})"
                for name, values in factors.items()
            ),
            "%", Agreement.IMPOSSIBLE,
            f"{NO_FORCE}; computed: the change of the radius at a fixed force, applied to the printed radius",
            kind=Evidence.IMPOSSIBLE,
        )
        for row, change in enumerate(CHANGES)
        for column, case in enumerate(CASES)
    ]  # fmt: skip
    return [*cells, *_statements(), *_signs(factors, step_mm)]


def _error(case: DeflectionCase, factor: float) -> float:
    return 100 * abs(factor * case.estimated_mm - case.measured_mm) / case.measured_mm


def _statements() -> list[Comparison]:
    nominal = CASES[1].error_percent
    better = [nominal - SENSITIVITY[row][1] for row in (0, 3)]
    over, under = (
        [abs(SENSITIVITY[row][column] - case.error_percent) for column, case in enumerate(CASES)] for row in (0, 1)
    )
    holds = sum(a < b for a, b in zip(over, under, strict=True))
    return [
        Comparison(
            f"{_SECTION}/kf +20 % or vf -20 % is better by almost 5 % (B, 10 mm/s)", "almost 5",
            f"{better[0]:.2f}, {better[1]:.2f}", "%",
            Agreement.REPRODUCED if all(4.5 < each < 5 for each in better) else Agreement.NOT_REPRODUCED,
            "therefore a cell is |R' - R_measured|/R_measured",
            kind=Evidence.ARITHMETIC,
        ),
        Comparison(
            f"{_SECTION}/more robust to kf too high than too low", "yes", f"in {holds} of 4 cases", "",
            Agreement.REPRODUCED if holds == len(CASES) else Agreement.NOT_REPRODUCED,
            "from the printed numbers; no property of the model: the nominal radius is too small, a larger kf "
            "increases it, and the error passes through zero",
            kind=Evidence.ARITHMETIC,
        ),
    ]  # fmt: skip


def _signs(factors: dict[str, np.ndarray], step_mm: float) -> list[Comparison]:
    rows = []
    for name, values in factors.items():
        rows += [
            _sign(f"kf -20 %: smaller radius, {name}", 100 * (values[1] - 1)),
            _sign(f"vf +20 % at the same force: smaller radius, {name}", 100 * (values[2] - 1)),
        ]
    same = (ParameterChange("", 1.0, 1.0),)
    for reading in (MEMORY, PRINTED):
        faster = [radius_change(reading, case, same, 1.5, step_mm)[0] for case in CASES[:2]]
        rows.append(
            _sign(f"15 for 10 mm/s at the same force: smaller radius, {reading.name}", 100 * (np.array(faster) - 1))
        )
    return rows


def _sign(what: str, percent: np.ndarray) -> Comparison:
    holds = bool((percent < 0).all())
    listed = ", ".join(f"{each:+.2f}" for each in percent)
    return Comparison(
        f"ch5/signs/{what}", "yes", listed, "%", Agreement.REPRODUCED if holds else Agreement.NOT_REPRODUCED,
        "" if holds else "the sign depends on the force by depth, which was not published",
        kind=Evidence.QUALITATIVE,
    )  # fmt: skip
