"""What a late velocity does to the identified friction.

The fast observer of the thesis, [40, 400], delays the velocity by 0.1 s; the force went through a moving average of
five samples, 10 ms. A loop between two signals that are not equally late opens, and the bristles get the blame.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from needleplan.models import LumpedLuGre, fit, simulate
from needleplan.models.friction import steady
from needleplan.reports.comparison import Agreement, Comparison
from needleplan.signals import Array, HighGainObserver, MovingAverage, Record
from needleplan_thesis.chapter3.published import model_ii, passing_through

__all__ = ["velocity_lag"]

_NOISE_N = 0.004
_RATE_HZ = 200.0


def velocity_lag(note: Callable[[str], None]) -> list[Comparison]:
    """Identify Model II, case 1, from signals that are late in four ways; 4 mN of noise on the force."""
    note("friction: bias by the delay of the velocity")
    truth, motion = model_ii(1), passing_through(1, cycles=3, rate_hz=_RATE_HZ)
    observer = HighGainObserver.critically_damped(40.0, 1 / _RATE_HZ)
    force = simulate(truth, motion).output + _NOISE_N * np.random.default_rng(0).standard_normal(len(motion))
    averaged, late = MovingAverage(5).apply(force), observer.observe(motion.depth_mm)
    ways = {
        "no delays": (force, motion.velocity_mm_s),
        "force averaged": (averaged, motion.velocity_mm_s),
        "force averaged, velocity from the observer": (averaged, late),
        "force and velocity through the observer": (observer.normalised.apply(force), late),
    }
    rows = []
    for name, (measured, velocity) in ways.items():
        record = Record({
            "time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": velocity, "force_n": measured,
        })  # fmt: skip
        rows.append(_row(name, truth, record))
    return rows


def _row(name: str, truth: LumpedLuGre, record: Record) -> Comparison:
    found = fit(truth, record, mask=_after_first)
    bias = {each: 100 * (found.estimates[each].value / getattr(truth, each) - 1) for each in found.estimates}
    others = ", ".join(f"{each} {bias[each]:+.0f} %" for each in ("sigma1", "mu_s", "mu_c", "alpha", "sigma2"))
    return Comparison(
        f"ch3/velocity lag/bias of sigma0, {name}", None, bias["sigma0"], "%", Agreement.OURS,
        f"{others}; RMSE {1e3 * found.rmse:.1f} mN with 4 mN of noise; the observer [40, 400] delays by 0.1 s, the "
        "average of five samples by 10 ms",
    )  # fmt: skip


def _after_first(record: Record) -> Array:
    return np.asarray(steady(record), float).astype(bool)
