"""Laws of the hidden effects that the library does not have.

Each takes the trial `t`, the force or depth so far, the size `s`, the numbers `at` and the number `n` of the trial. The
formulas in words and the places where they act stand in `second_generator_kinds`.
"""
# ruff: noqa: ARG001

import numpy as np
from scipy.signal import lfilter
from second_generator_hidden import Numbers
from second_generator_law import FINE_HZ, Insertion

Array = np.ndarray


def ripple(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    turn = 2 * np.pi * t.stage[0] / at["pitch_mm"] + at["phase_rad"]
    return s * (np.sin(turn) + 0.3 * np.sin(2 * turn)) * (t.depth > 0)


def fibres(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    phase = (t.depth / at["spacing_mm"] + at["phase_rad"]) % 1.0
    return s * phase**1.5 * t.push * (t.depth > 0)


def hum(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    return f + s * np.sin(2 * np.pi * at["frequency_hz"] * t.time + at["phase_rad"])


def pulse(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    return s * t.shaft * np.exp(2.5 * (np.cos(2 * np.pi * at["frequency_hz"] * t.time + n) - 1))


def slip(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    when = (0.3 + 0.4 * ((at["share"] + 0.37 * n) % 1.0)) * t.time[-1]
    return f + s * (1 + np.tanh((t.time - when) / 0.05)) / 2


def wander(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    rng = np.random.default_rng([int(at["seed"]), n])
    knots = np.cumsum(rng.normal(size=int(t.time[-1] / 2) + 3))
    return f + s * np.interp(t.time, 2.0 * np.arange(len(knots)), knots)


def room(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    return f + s * np.sin(2 * np.pi * t.time / at["period_s"] + at["phase_rad"] + 0.8 * n)


def spikes(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    rng = np.random.default_rng([int(at["seed"]), n])
    when = rng.uniform(0, t.time[-1], size=max(int(t.time[-1] / 2), 4))
    spikes = np.zeros(len(f))
    for each in when:
        first = int(np.searchsorted(t.time, each))
        spikes[first : first + int(0.04 * FINE_HZ)] += rng.choice([-1.0, 1.0])
    return f + s * spikes


def clock(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    return np.interp(t.time * (1 - s), t.time, f)


def swell(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    return s * t.shaft * np.sqrt(np.maximum(t.time, 0) / 20)


def gas(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    when = at["share"] * t.time[-1]
    return s * t.shaft * np.where(t.time > when, 1 - np.exp(-np.maximum(t.time - when, 0) / 0.8), 0.0)


def quadratic(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    return f + s * f * np.abs(f)


def saturation(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    return f - s * np.tanh(np.maximum(np.abs(f) - at["force_n"], 0.0) / 0.5) * np.sign(f)


def sensor_play(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    low, high = np.minimum.accumulate(f), np.maximum.accumulate(f)
    span = np.maximum(high - low, 1e-9)
    slope = np.gradient(f) * FINE_HZ
    decay = np.exp(-1 / (FINE_HZ * 0.4))
    side = lfilter([1 - decay], [1, -decay], np.tanh(slope / 0.05))
    return f - s * side * 4 * (f - low) * (high - f) / span**2


def dead_zone(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    return f - s * np.tanh(f / s)


def drag(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    return s * t.length * t.speed * np.abs(t.speed)


def rate_cutting(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    return s * t.cut_force * t.push * np.log1p(np.maximum(t.speed, 0) / 0.3)


def chatter(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    slow = np.exp(-((np.abs(t.speed) / at["speed_mm_s"]) ** 4)) * (np.abs(t.speed) > 0.05)
    return s * slow * (2 * ((t.slid / at["stride_mm"]) % 1.0) - 1) * t.grip * (t.depth > 0)


def band(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    return s * np.exp(-((np.log(np.abs(t.speed) / at["speed_mm_s"] + 1e-6) / 0.3) ** 2)) * t.length / 40 * t.grip


def adhesion(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    path, lasted = t.since_hold
    return s * np.log1p(lasted / 0.2) * np.exp(-np.minimum(path / at["path_mm"], 700)) * t.shaft * (t.held == 0)


def heal(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    path, lasted = t.since_hold
    return s * np.minimum(lasted, 3.0) / 3 * (1 - np.tanh((np.minimum(path, 100) - at["path_mm"]) / 0.5)) / 2 * t.push


def swelling_hold(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    return s * np.log1p(t.held / 0.3) * t.length / 40


def pressure(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    return s * (t.length / 40) ** 2.5 * t.grip


def film(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    return -s * t.grip * t.length**3 / (t.length**2 + at["depth_mm"] ** 2) / 40


def cable(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    return f + s * ((t.stage[0] / 40) ** 2 + 0.5 * np.sin(t.stage[0] / at["scale_mm"]))


def vessel(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    inside = np.tanh((t.depth - at["depth_mm"]) / 0.6) - np.tanh((t.depth - at["depth_mm"] - at["width_mm"]) / 0.6)
    return -s * inside / 2 * t.push


def ringing(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    radius, turn = np.exp(-3.0 / FINE_HZ), 2 * np.pi * at["frequency_hz"] / FINE_HZ
    return s * 1e-3 * lfilter([radius * np.sin(turn)], [1, -2 * radius * np.cos(turn), radius**2], t.stage[2])


def jerk(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    decay = np.exp(-1 / (FINE_HZ * 0.06))
    low = lfilter([1 - decay], [1, -decay], t.stage[2])
    return s * 1e-3 * (t.stage[2] - low)


def history(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    """Friction of the shaft that remembers the force: a slow lag of |F|."""
    decay = np.exp(-1 / (FINE_HZ * at["time_s"]))
    return s * t.grip * lfilter([1 - decay], [1, -decay], np.abs(f))
