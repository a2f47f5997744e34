"""One integration step and one output of the force-depth model with their derivatives, for Kalman filters.

All functions use Python floats, because a filter processes one sample at a time and NumPy would take ten times as long.
The parameters are a tuple in the order of `NAMES`, and so are the derivatives with respect to the parameters.
"""

from __future__ import annotations

from math import exp

__all__ = ["NAMES", "Row", "Values", "exponential_step", "force", "kutta_step", "slope"]

NAMES = ("sigma0", "sigma1", "sigma2", "f1", "f2", "alpha", "beta")

Values = tuple[float, float, float, float, float, float, float]

Row = tuple[float, float, Values]
"""A value, its derivative with respect to z, and its derivatives with respect to the parameters."""


def slope(z: float, values: Values, depth_mm: float) -> Row:
    """Return z' (1/s) and its derivatives.

    Raises ZeroDivisionError if g is zero, and OverflowError if exp(-alpha l) overflows.
    """
    sigma0, _, _, f1, f2, alpha, beta = values
    fading = exp(-alpha * depth_mm)
    g = f1 + f2 * fading
    by_g = depth_mm * sigma0 * z / g**2
    return (
        depth_mm * (beta - sigma0 * z / g),
        -depth_mm * sigma0 / g,
        (-depth_mm * z / g, 0.0, 0.0, by_g, by_g * fading, -by_g * f2 * depth_mm * fading, depth_mm),
    )


def force(z: float, values: Values, depth_mm: float, direction: float) -> Row:
    """Return the axial force (N) and its derivatives. Raises the errors of `slope`."""
    sigma0, sigma1, sigma2, f1, f2, alpha, beta = values
    fading = exp(-alpha * depth_mm)
    g = f1 + f2 * fading
    gap = beta - sigma0 * z / g
    signed = direction * depth_mm
    damped = signed * sigma1 * fading
    by_g = damped * sigma0 * z / g**2
    return (
        sigma0 * z * depth_mm + damped * gap + signed * sigma2,
        sigma0 * depth_mm - damped * sigma0 / g,
        (
            z * depth_mm - damped * z / g,
            signed * fading * gap,
            signed,
            by_g,
            by_g * fading,
            -depth_mm * (damped * gap + by_g * f2 * fading),
            damped,
        ),
    )


def exponential_step(z: float, values: Values, depth_mm: float, step_s: float) -> Row:
    """Return z after the time `step_s` at the constant depth `depth_mm`, and its derivatives.

    The step is exact. If g is positive, z stays bounded for any `step_s`. Raises ZeroDivisionError if g is zero, and
    OverflowError if an exponential overflows.
    """
    sigma0, _, _, f1, f2, alpha, beta = values
    fading = exp(-alpha * depth_mm)
    g = f1 + f2 * fading
    rested = beta * g / sigma0
    decay = step_s * depth_mm * sigma0 / g
    kept = exp(-decay)
    lost = 1 - kept
    # z+ = rested (1 - kept) + z kept, with kept = exp(-decay)
    by_decay = (rested - z) * kept
    by_g = beta / sigma0 * lost - by_decay * decay / g
    return (
        rested * lost + z * kept,
        kept,
        (
            -rested / sigma0 * lost + by_decay * decay / sigma0,
            0.0,
            0.0,
            by_g,
            by_g * fading,
            -by_g * f2 * depth_mm * fading,
            g / sigma0 * lost,
        ),
    )


def kutta_step(z: float, values: Values, depths_mm: tuple[float, float, float], step_s: float) -> Row:
    """Return z after one step of Kutta's third-order method, as in the thesis, and its derivatives.

    `depths_mm` are the depths at the beginning, the middle and the end of the step. Raises the errors of `slope`.
    """
    h = step_s
    # k: slope; kz, kp: its derivatives by its argument and by the parameters; d, dp: those of the argument by the first
    # z and by the parameters; total: derivative of a slope by the parameters, the change of its argument included.
    k1, k1z, k1p = slope(z, values, depths_mm[0])
    k2, k2z, k2p = slope(z + h / 2 * k1, values, depths_mm[1])
    d2 = 1 + h / 2 * k1z
    d2p = [h / 2 * slope1 for slope1 in k1p]
    k3, k3z, k3p = slope(z + h * (2 * k2 - k1), values, depths_mm[2])
    d3 = 1 + h * (2 * k2z * d2 - k1z)
    total2 = [two + k2z * inner for two, inner in zip(k2p, d2p, strict=True)]
    d3p = [h * (2 * two - one) for two, one in zip(total2, k1p, strict=True)]
    total3 = [three + k3z * inner for three, inner in zip(k3p, d3p, strict=True)]
    by = [h / 6 * (one + 4 * two + three) for one, two, three in zip(k1p, total2, total3, strict=True)]
    return (
        z + h / 6 * (k1 + 4 * k2 + k3),
        1 + h / 6 * (k1z + 4 * k2z * d2 + k3z * d3),
        (by[0], by[1], by[2], by[3], by[4], by[5], by[6]),
    )
