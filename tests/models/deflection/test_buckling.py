"""Buckling loads against the determinant of the column's end conditions, integrated numerically."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from needleplan.errors import ModelError
from needleplan.models.deflection import ShaftEnd, UnsupportedShaft

EI, LENGTH = 2324.0, 120.0

# Rows of (u, u', u'', u''' + N/EI u') at the end that vanish.
VANISHING = {ShaftEnd.FREE: (2, 3), ShaftEnd.PINNED: (0, 2), ShaftEnd.CLAMPED: (0, 1)}


def determinant(force_n: float, end: ShaftEnd) -> float:
    """Return the determinant of the end conditions for the two solutions of a clamped column; 0: it buckles."""
    ends = []
    for start in ([0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]):
        done = solve_ivp(
            lambda _, y: [y[1], y[2], y[3], -force_n * LENGTH**2 / EI * y[2]], (0, 1), start, rtol=1e-10, atol=1e-12
        )
        y = done.y[:, -1]
        y[3] += force_n * LENGTH**2 / EI * y[1]
        ends.append(y[list(VANISHING[end])])
    return float(np.linalg.det(ends))


@pytest.mark.slow
@pytest.mark.parametrize("end", ShaftEnd)
def test_the_load_is_the_first_at_which_a_bent_shape_is_in_equilibrium(end: ShaftEnd) -> None:
    forces = np.linspace(0.02, 5.0, 60) * EI * math.pi**2 / LENGTH**2
    values = [determinant(each, end) for each in forces]
    first = next(k for k in range(len(forces) - 1) if values[k] * values[k + 1] < 0)
    exact = brentq(determinant, forces[first], forces[first + 1], args=(end,), xtol=1e-10)
    assert float(UnsupportedShaft(EI, LENGTH, end).buckling_n(0.0)) == pytest.approx(exact, rel=1e-6)


def test_effective_lengths_of_the_textbook() -> None:
    for end, factor in ((ShaftEnd.FREE, 2.0), (ShaftEnd.PINNED, 0.699), (ShaftEnd.CLAMPED, 0.5)):
        euler = math.pi**2 * EI / (factor * LENGTH) ** 2
        assert float(UnsupportedShaft(EI, LENGTH, end).buckling_n(0.0)) == pytest.approx(euler, rel=1e-3)


def test_the_load_rises_with_the_depth() -> None:
    shaft = UnsupportedShaft(EI, LENGTH)
    loads = shaft.buckling_n([0.0, 60.0, 120.0, 130.0])
    assert loads[1] == pytest.approx(4 * loads[0])
    assert np.isinf(loads[2:]).all()
    depth = shaft.holds_from_mm(10.0)
    assert 0 < depth < LENGTH
    assert float(shaft.buckling_n(depth)) == pytest.approx(10.0)
    assert shaft.holds_from_mm(0.1) == 0


@pytest.mark.parametrize("values", [(0.0, 100.0), (100.0, -1.0), (math.nan, 100.0), (100.0, math.inf)])
def test_wrong_numbers_are_refused(values: tuple[float, float]) -> None:
    with pytest.raises(ModelError, match="above 0"):
        UnsupportedShaft(*values)
