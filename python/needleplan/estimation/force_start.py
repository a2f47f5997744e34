"""Where an identification of the axial force may begin, read off the records themselves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from needleplan.models.force import ForceModel1
from needleplan.signals import Record

__all__ = ["has_retraction", "starting_force"]

_BETA = 0.02
_RATE = 0.15
"""sigma0 / g in 1/(mm s): middle of what the thesis identified, 0.04 to 0.14 with g near the surface smaller."""

_LEAST = 1e-6


def has_retraction(records: Sequence[Record]) -> bool:
    """Return whether the needle moves out somewhere, by more than a tenth of the way in."""
    for record in records:
        motion = record.motion()
        change = np.diff(motion.depth_mm)
        if -change[change < 0].sum() > 0.1 * change[change > 0].sum():
            return True
    return False


def starting_force(records: Sequence[Record]) -> ForceModel1:
    """Return parameters of the right size, from the closed forms for deep and for shallow insertion.

    Deep, f / l is beta g + sigma2 on the way in and beta g - sigma2 on the way out; where there is no way out, the two
    are taken for equal. Close to the surface f / l is sigma1 beta + sigma2. Raises DataError for records without force
    or motion.
    """
    ratio, depth, inward = [], [], []
    for record in records:
        motion, force = record.motion(), record["force_n"]
        good = np.isfinite(force) & (motion.depth_mm > 0)
        ratio.append(force[good] / motion.depth_mm[good])
        depth.append(motion.depth_mm[good])
        inward.append(motion.direction[good] >= 0)
    slope, at, into = np.concatenate(ratio), np.concatenate(depth), np.concatenate(inward)
    if not slope.size:
        return ForceModel1(_BETA, 1.0, _BETA, _BETA, 0.0, 0.04)
    reach = float(at.max())
    deep, shallow = at > 0.6 * reach, (at < 0.08 * reach) & (at > 0.01 * reach)
    going_in = float(np.median(slope[deep & into])) if (deep & into).any() else float(np.median(slope))
    going_out = float(np.median(slope[deep & ~into])) if (deep & ~into).any() else 0.0
    sigma2 = max((going_in - going_out) / 2, _LEAST)
    f1 = max((going_in + going_out) / 2, 0.1 * sigma2) / _BETA
    first = float(np.median(slope[shallow & into])) if (shallow & into).any() else going_in
    return ForceModel1(
        sigma0=_RATE * f1, sigma1=max(first - sigma2, 0.1 * sigma2) / _BETA, sigma2=sigma2,
        f1=f1, f2=-0.3 * f1, alpha=3.0 / reach, beta=_BETA,
    )  # fmt: skip
