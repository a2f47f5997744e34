"""Preparation of a friction fit from periodic motion: selection of samples and start values (thesis, section 3.4.1)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from needleplan.errors import DataError, Mistake
from needleplan.signals import Record, cycles

__all__ = ["first_guess", "steady"]

# Shares of the largest speed above which a sample counts as fast, and below which it counts as slow.
_FAST, _SLOW = 0.9, 0.3
# Assumed friction at the largest speed, as a share of mu_c.
_FAST_SHARE = 0.6
# Assumed bending of the bristles before they slide, as a share of the stroke.
_PRESLIDING = 0.01


def steady(record: Record, skip_cycles: int = 1, phases: Sequence[str] = ()) -> NDArray[np.bool_]:
    """Return a mask of the samples to use in a friction fit, bool of shape (samples,).

    The mask contains the samples after the first `skip_cycles` cycles. If `phases` are given, it leaves out the samples
    of all other phases.

    The first cycle contains effects that disappear with repetition: the path is cut, bubbles escape, and the unknown
    initial bending decays. Raises DataError for a phase that the record does not have, and if no sample is left.
    """
    unknown = [phase for phase in phases if phase not in record.phase]
    if unknown:
        known = ", ".join(sorted(set(record.phase)))
        rule = f"must be one of {known}" if known else "must not be given, because the trial has no phases"
        raise DataError([Mistake("phase", phase, rule) for phase in unknown], record.trial)
    chosen = np.asarray(cycles(record.motion()) >= skip_cycles)
    if phases:
        chosen = chosen & np.isin(np.asarray(record.phase), list(phases))
    if not chosen.any():
        rule = f"leaves no sample: the trial has {cycles(record.motion()).max():.0f} full cycles"
        raise DataError(Mistake("skip_cycles", str(skip_cycles), rule), record.trial)
    return np.asarray(chosen)


def first_guess(records: Sequence[Record]) -> dict[str, float]:
    """Return start values for a fit of `LumpedLuGre` by parameter name, from the forces at high and at low velocity.

    The values have the right order of magnitude for a normal force of 1 N. Raises DataError for records without
    movement, or without force at high velocity.
    """
    speed = np.concatenate([np.abs(record.motion().velocity_mm_s) for record in records])
    force = np.concatenate([np.abs(record["force_n"]) for record in records])
    stroke = max(float(np.ptp(record["depth_mm"])) for record in records)
    top = float(speed.max())
    if not top or not stroke:
        raise DataError(Mistake("depth_mm", "", "is constant: a needle at rest does not determine any parameter"))
    known = np.isfinite(force)
    fast, slow = force[known & (speed >= _FAST * top)], force[known & (speed <= _SLOW * top)]
    high = float(np.median(fast)) if fast.size else 0.0
    low = float(np.median(slow)) if slow.size else 0.0
    if not high > 0:
        raise DataError(Mistake("force_n", "", "is zero at full speed: there is no friction to identify"))
    return {
        "sigma0": high / (_PRESLIDING * stroke),
        "sigma1": 5 * high / top,
        "sigma2": 0.1 * high / top,
        "mu_c": 0.9 * high / _FAST_SHARE,
        "mu_s": max(0.3 * low, 0.05 * high),
        "alpha": -float(np.log(1 - _FAST_SHARE)) / top,
    }
