"""Keeping the tip in the plane of the plan by small rolls of the bevel.

With the distance z of the tip from the plane, its elevation e, the curvature k, and the roll d of the bevel out of the
plane (positive toward +z, for both sides of the bevel), the path over the remaining length s obeys

    z' = e,    e' = u,    u = k sin(d)

The correction with the least effort, the integral of u^2, that ends at z(L) = 0 is linear in s; at its beginning

    u(0) = -3 (z + e L) / L^2

(Bryson and Ho, Applied Optimal Control, 1975, section 5.2). It is computed anew at every decision, so that u follows
the line. The roll is limited to `most_rad`, at which the curvature in the plane is still k cos(d). A roll needs a
needle at rest: it is changed only if the distance at the target that is predicted for the present roll,
z + e L + k sin(d) L^2 / 2, exceeds a share of the radius of the target, and if the change can mend it.
"""

from __future__ import annotations

import math

from needleplan.estimation.tip import TipEstimate

__all__ = ["in_plane_per_mm", "plane_roll_rad"]

# Predicted distance from the plane, as a share of the radius of the target, above which the roll is changed.
_SHARE = 0.25

# Change of the roll (rad) below which the needle is not stopped for it.
_LEAST_RAD = 0.03


def in_plane_per_mm(tip: TipEstimate) -> float:
    """Return the curvature (1/mm) of the path in the plane, for the estimated roll of the bevel."""
    return tip.curvature_per_mm * abs(math.cos(tip.roll_rad))


def plane_roll_rad(tip: TipEstimate, length_mm: float, radius_mm: float, most_rad: float) -> float | None:
    """Return the roll (rad) of the bevel out of the plane that brings the tip back to it; None: keep the present roll.

    `length_mm` is the remaining length of the path, `radius_mm` the radius of the target, and `most_rad` the largest
    roll; 0 never changes it.
    """
    bend, straight = tip.curvature_per_mm, tip.z_mm + tip.elevation_rad * length_mm
    present = math.asin(math.sin(tip.roll_rad))
    missed = straight + bend * math.sin(present) * length_mm**2 / 2
    if abs(missed) <= _SHARE * radius_mm or bend <= 0 or most_rad <= 0:
        return None
    limit = math.sin(most_rad)
    wanted = math.asin(min(max(-3 * straight / (bend * length_mm**2), -limit), limit))
    gained = bend * abs(math.sin(wanted) - math.sin(present)) * length_mm**2 / 2
    small = abs(wanted - present) < _LEAST_RAD or gained < _SHARE * radius_mm / 2
    return None if small else wanted
