"""Published numbers of chapter 4, and the phantoms of known stiffness that replace its measurements.

Published numbers are from section 4.3.2 and the captions of Figures 4.3 to 4.6. Displacements and forces are only drawn
in the figures of the thesis, so there are no published numbers for them.

The simulated friction is Model III-B (beta v), so the fitted Model II is not the true model. Lambda is 0.5; of the four
values in the thesis it is nearest to the distributed equations (lambda -> 0). The tissue is Kelvin-Voigt. The needle
has passed through the phantom and oscillates by 40 mm at 0.1 Hz for four cycles. The sensors are

- force at 200 Hz with 4 mN of noise after the average over five samples;
- an encoder with steps of 1 micrometre;
- three trackers in the tissue at 40 Hz with 0.1 mm of noise. Their displacements are 0.8, 0.6 and 1 times the
  displacement of the tissue at the shaft, because in the thesis sensor 3 moves most and sensor 2 least.

Stiffness and damping are assumed. The values for gelatin give about the published lag of sensor 3 (10.13 degrees). The
values for agar give about the published lag of the observer (2.99 degrees). Computed lags are therefore no evidence
about the tissues of the thesis; only the errors of the methods are evidence.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from needleplan.models import AveragedOnTissue, simulate
from needleplan.signals import Array, HighGainObserver, Motion, MovingAverage, Record, lag_rad, sinusoid

__all__ = [
    "AGAR",
    "AGAR_PHANTOM",
    "AMPLITUDE_MM",
    "DRY",
    "FAST",
    "FORCE_HZ",
    "FREQUENCY_HZ",
    "GELATIN",
    "GELATIN_PHANTOM",
    "PHANTOMS",
    "SENSOR_LAG_DEG",
    "SHARES",
    "TRACKER_HZ",
    "VISCOUS",
    "Phantom",
    "PhantomTrial",
    "Tuned",
]

# Frequency and amplitude of the motion of the needle.
FREQUENCY_HZ, AMPLITUDE_MM = 0.1, 40.0
# Sampling rates of the force sensor and of the trackers.
FORCE_HZ, TRACKER_HZ = 200.0, 40.0

FAST = (40.0, 400.0)
"""Fast observer (pf of Figures 4.3 and 4.5): alpha1 (1/s), alpha2 (1/s^2)."""

SENSOR_LAG_DEG = 10.13
"""Published phase lag in gelatin (degrees): of the needle's velocity relative to sensor 3, behind its own velocity."""


@dataclass(frozen=True)
class Tuned:
    """A slow observer of the thesis, tuned by hand: its parameters, and the printed attenuation and lag at 0.1 Hz."""

    phantom: str
    alpha1: float
    alpha2: float
    attenuation_percent: float
    lag_deg: float


# The two slow observers of the thesis, as printed.
GELATIN = Tuned("gelatin", 9.0, 20.25, 1.67, 12.36)
AGAR = Tuned("agar", 22.0, 121.0, 0.19, 2.99)


SHARES = (0.8, 0.6, 1.0)
"""Displacements of the three sensors, relative to the displacement of the tissue at the shaft."""

# Standard deviations of the averaged force (N) and of the trackers (mm).
_FORCE_SD_N = 0.004
_TRACKER_SD_MM = 0.1

# Depth of the tip in the middle of the stroke (mm); the phantom is thinner.
_OUTSIDE_MM = 126.0

# Number of samples of the force sensor's moving average.
_AVERAGED = 5
# Exponent lambda of the simulated Model III-B.
_LAMBDA = 0.5


@dataclass(frozen=True)
class PhantomTrial:
    """A simulated trial with the true velocity of the needle.

    `record` has the depth of the encoder and the averaged force; `relative_mm_s` is the true velocity of the needle
    relative to the tissue; `sensors_mm`, shape (3, samples), holds the measured displacements of the trackers at
    `tracker_time_s`.
    """

    motion: Motion
    record: Record
    relative_mm_s: Array
    tracker_time_s: Array
    sensors_mm: Array

    @property
    def lag_deg(self) -> float:
        """True phase lag (degrees), after the first cycle, of `relative_mm_s` behind the velocity of the needle."""
        settled = self.motion.time_s >= 1 / FREQUENCY_HZ
        time, velocity = self.motion.time_s[settled], self.motion.velocity_mm_s[settled]
        return float(np.degrees(lag_rad(FREQUENCY_HZ, time, self.relative_mm_s[settled], velocity)))


@dataclass(frozen=True)
class Phantom:
    """A named tissue with the friction of a needle in it."""

    name: str
    model: AveragedOnTissue

    def trial(self, cycles: float = 4.0, rate_hz: float = FORCE_HZ, amplitude_mm: float = AMPLITUDE_MM) -> PhantomTrial:
        """Simulate a trial and return it. The noise has a fixed seed, so equal arguments give equal trials."""
        motion = sinusoid(
            offset_mm=_OUTSIDE_MM, amplitude_mm=amplitude_mm, frequency_hz=FREQUENCY_HZ, cycles=cycles, rate_hz=rate_hz
        )
        done = simulate(self.model, motion)
        generator = np.random.default_rng([4, round(amplitude_mm)])
        noisy = done.output + _FORCE_SD_N * _AVERAGED**0.5 * generator.standard_normal(len(motion))
        depth = np.round(motion.depth_mm, 3)
        record = Record(
            {
                "time_s": motion.time_s,
                "depth_mm": depth,
                "velocity_mm_s": HighGainObserver(*FAST, 1 / rate_hz).observe(depth),
                "force_n": MovingAverage(_AVERAGED).apply(noisy),
            },
            trial=f"{self.name}, {amplitude_mm:g} mm",
        )
        time = np.arange(0, motion.time_s[-1], 1 / TRACKER_HZ)
        moved = np.interp(time, motion.time_s, done.states[1])
        noise = _TRACKER_SD_MM * generator.standard_normal((len(SHARES), time.size))
        sensors = np.array(SHARES)[:, None] * moved + noise
        return PhantomTrial(motion, record, motion.velocity_mm_s - done.states[2], time, sensors)


def _mixed(stiffness: float, damping: float) -> AveragedOnTissue:
    """Return the friction of Table 3.4, case 1, on tissue of a stiffness (N/mm) and damping (N s/mm)."""
    return AveragedOnTissue(
        sigma0=1.203, sigma1=0.374, sigma2=0.014, mu_c=0.788, mu_s=0.033, alpha=0.088,
        stiffness=stiffness, damping=damping, exponent=_LAMBDA,
    )  # fmt: skip


# Simulated phantoms; all parameters of the tissues are assumed.
GELATIN_PHANTOM = Phantom("gelatin", _mixed(0.165, 0.02))
AGAR_PHANTOM = Phantom("agar", _mixed(0.56, 0.02))
VISCOUS = Phantom(
    "nearly viscous friction",
    AveragedOnTissue(
        sigma0=0.2,
        sigma1=0.02,
        sigma2=0.03,
        mu_c=0.05,
        mu_s=0.01,
        alpha=0.05,
        stiffness=0.1,
        damping=0.02,
        exponent=_LAMBDA,
    ),
)
DRY = Phantom(
    "nearly dry friction",
    AveragedOnTissue(
        sigma0=1.2,
        sigma1=0.05,
        sigma2=0.003,
        mu_c=0.35,
        mu_s=0.3,
        alpha=0.3,
        stiffness=0.13,
        damping=0.02,
        exponent=_LAMBDA,
    ),
)
PHANTOMS = (GELATIN_PHANTOM, AGAR_PHANTOM, VISCOUS, DRY)
