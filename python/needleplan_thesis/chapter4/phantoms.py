"""What chapter 4 of the thesis prints: section 4.3.2 and the captions of Figures 4.3 to 4.6.

The figures themselves are not in the text that is available, so that displacements and forces, which are only drawn,
have no published number here.

The generator of chapter 4's data: phantoms of known stiffness under a friction that is not the one that is fitted.

Friction: Model III-B (beta v), so that the identified Model II never sees itself, with lambda = 0.5, the value of the
thesis' four that is nearest to what the distributed equations give (lambda -> 0). Tissue: Kelvin-Voigt. The needle has
passed through and swings by 40 mm at 0.1 Hz for four cycles. Force at 200 Hz, 4 mN after the average over five samples;
encoder in steps of 1 micrometre; three trackers in the tissue at 40 Hz with 0.1 mm of noise, which move by 0.8, 0.6 and
1 times the displacement that the friction feels (the order of the thesis: sensor 3 moves most, sensor 2 least).

Stiffness and damping are ours. Those of gelatin are chosen so that the velocity against the tissue lags by about what
sensor 3 said (10.13 degrees), those of agar by about what its observer said (2.99 degrees): lags are not evidence, what
methods make of them is.
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

FREQUENCY_HZ, AMPLITUDE_MM = 0.1, 40.0
FORCE_HZ, TRACKER_HZ = 200.0, 40.0

FAST = (40.0, 400.0)
"""pf of Figures 4.3 and 4.5: alpha1 (1/s), alpha2 (1/s^2)."""

SENSOR_LAG_DEG = 10.13
"""By how much the needle's velocity less that of sensor 3 lags the needle's, in gelatin."""


@dataclass(frozen=True)
class Tuned:
    """A slow observer that was tuned by hand, and H(z) at 0.1 Hz."""

    phantom: str
    alpha1: float
    alpha2: float
    attenuation_percent: float
    lag_deg: float


GELATIN = Tuned("gelatin", 9.0, 20.25, 1.67, 12.36)
AGAR = Tuned("agar", 22.0, 121.0, 0.19, 2.99)


SHARES = (0.8, 0.6, 1.0)
"""Displacement of the three sensors over that of the tissue at the shaft."""

_FORCE_SD_N = 0.004
_TRACKER_SD_MM = 0.1
_OUTSIDE_MM = 126.0
_AVERAGED = 5
_LAMBDA = 0.5


@dataclass(frozen=True)
class PhantomTrial:
    """A trial with the truth that no sensor shows.

    `record` has the depth of the encoder and the averaged force; `relative_mm_s` is the true velocity against the
    tissue; `tracker_time_s` and `sensors_mm`, shape (3, samples), are what the trackers say.
    """

    motion: Motion
    record: Record
    relative_mm_s: Array
    tracker_time_s: Array
    sensors_mm: Array

    @property
    def lag_deg(self) -> float:
        """True lag of the velocity against the tissue, without the first cycle."""
        settled = self.motion.time_s >= 1 / FREQUENCY_HZ
        time, velocity = self.motion.time_s[settled], self.motion.velocity_mm_s[settled]
        return float(np.degrees(lag_rad(FREQUENCY_HZ, time, self.relative_mm_s[settled], velocity)))


@dataclass(frozen=True)
class Phantom:
    """A tissue with its friction."""

    name: str
    model: AveragedOnTissue

    def trial(self, cycles: float = 4.0, rate_hz: float = FORCE_HZ, amplitude_mm: float = AMPLITUDE_MM) -> PhantomTrial:
        """Return one trial, always the same."""
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
    """Return friction of the size of Table 3.4, case 1, on tissue."""
    return AveragedOnTissue(
        sigma0=1.203, sigma1=0.374, sigma2=0.014, mu_c=0.788, mu_s=0.033, alpha=0.088,
        stiffness=stiffness, damping=damping, exponent=_LAMBDA,
    )  # fmt: skip


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
