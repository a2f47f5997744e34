"""The documented effects, each with a law of the generator's own, some per cent from the documented one.

Names, units and meanings are those of docs/reference/diagnosis.md and of `effect_named(...).equation`; the laws
here are close to these equations, as the law of real tissue would be: another exponent, a smoother step, a
second time constant.
"""

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.random import Generator
from scipy.signal import lfilter
from scipy.special import erf
from third_generator_motion import FINE_HZ, Array
from third_generator_state import Effect, Insertion, affine_scan

Numbers = dict[str, Any]


def puncture(state: Insertion, size: float, n: Numbers) -> None:
    """A bulge that stiffens, slackens on retraction, and tears over a quarter of a millimetre."""
    deepest, deep = state.deepest, n["depth_mm"] + n["scatter_mm"][state.trial.number]
    q = np.minimum((state.depth - deep) / n["bulge_mm"], 0.0)
    bulge = np.maximum(np.exp(1.05 * q) - np.exp(-4.2), 0.0) / (1 - np.exp(-4.2))
    torn = np.exp(-np.maximum(deepest - deep, 0.0) / 0.25)
    state.force = state.force + size * bulge * torn * (state.depth > 0)


def cutting_layer(state: Insertion, size: float, n: Numbers) -> None:
    q = (state.depth - n["depth_mm"] - n["scatter_mm"][state.trial.number]) / n["width_mm"]
    state.force = state.force + size * 0.5 * (1 + erf(0.95 * q)) * state.pushed


def fresh_cutting(state: Insertion, size: float, n: Numbers) -> None:
    behind = np.maximum(state.deepest - state.depth, 0.0) / n["margin_mm"]
    state.force = state.force - size * state.tip * -np.expm1(-(behind**1.15)) * state.pushed


def cutting_with_depth(state: Insertion, size: float, _n: Numbers) -> None:
    state.force = state.force + size * 40.0 * (state.inside / 40.0) ** 1.08 * state.pushed


def friction_layer(state: Insertion, size: float, n: Numbers) -> None:
    q = (state.depth - n["depth_mm"] - n["scatter_mm"][state.trial.number]) / 0.6
    state.force = state.force + size * 0.6 * np.logaddexp(0.0, q) * state.z * (state.depth > 0)


def stribeck(state: Insertion, size: float, n: Numbers) -> None:
    drop = np.exp(-((np.abs(state.velocity) / n["speed_mm_s"]) ** 1.12))
    state.force = state.force + size * state.shaft * state.z * drop


def viscous(state: Insertion, size: float, _n: Numbers) -> None:
    """Slightly shear-thinning."""
    rate = state.velocity * (np.maximum(np.abs(state.velocity), 1e-3) / 6.0) ** -0.07
    state.force = state.force + size * state.inside * rate


def bristle(state: Insertion, size: float, _n: Numbers) -> None:
    state.widths = ((0.8, 1.1 * size), (0.2, 0.6 * size))


def relaxation(state: Insertion, size: float, n: Numbers) -> None:
    """Two time constants; travel restores the force."""
    travel = np.abs(np.diff(state.slide, prepend=state.slide[0])) / n["recovery_mm"]
    relaxed = np.zeros_like(state.force)
    for weight, ratio in ((0.75, 1.12), (0.25, 0.6)):
        rate = 1 / (FINE_HZ * n["time_s"] * ratio)
        keep = np.exp(-rate - travel)
        relaxed += weight * affine_scan(keep, (1 - keep) * rate / (rate + travel))
    state.force = state.force * (1 - size * relaxed)


def tissue_motion(state: Insertion, size: float, n: Numbers) -> None:
    """A spring that stiffens a little towards its end, and a damper; the tissue slides when the bristle does."""
    every = 4
    moves = np.diff(state.slide[::every]).tolist()
    ratio, width = every / FINE_HZ / n["lag_s"], state.trial.base["presliding_mm"]
    place, z, places = 0.0, 0.0, [0.0]
    for move in moves:
        before = place
        stiff = 1 + 0.04 * (place / size) ** 2 if size else 1.0
        place = (place + ratio * size * z) / (1 + ratio * stiff)
        slip = move - place + before
        way = 1.0 if slip > 0 else -1.0
        z = way - (way - z) * np.exp(-abs(slip) / width) if slip else z
        places.append(place)
    moved = np.interp(state.time, state.time[::every], places)
    state.slide = state.slide - moved
    state.velocity = np.gradient(state.slide, 1 / FINE_HZ)


def path_damage(state: Insertion, size: float, n: Numbers) -> None:
    def worn(there: Array, travel: Array) -> Array:
        slid = np.cumsum(there * travel[:, None], axis=0)
        return 1 - (1 + slid / (6 * n["sliding_mm"])) ** -6

    state.force = state.force - size * state.trial.base["friction"] * state.z * state.along_shaft(worn)


def bump(state: Insertion, size: float, n: Numbers) -> None:
    q = (state.depth - n["depth_mm"]) / n["width_mm"]
    shape = np.exp(-(np.abs(q * np.where(q > 0, 1.06, 0.94)) ** 1.9))
    state.force = state.force + size * shape * state.z


def bias(state: Insertion, size: float, n: Numbers) -> None:
    state.force = state.force + size * n["of_trial"][state.trial.number]


def drift(state: Insertion, size: float, _n: Numbers) -> None:
    state.force = state.force + size * state.time * (1 + 0.04 * (state.time - 15.0) / 15.0)


def thermal_drift(state: Insertion, size: float, n: Numbers) -> None:
    t = state.time / n["time_s"]
    state.force = state.force - size * (0.85 * np.expm1(-1.05 * t) + 0.15 * np.expm1(-0.7 * t))


def gain_error(state: Insertion, size: float, _n: Numbers) -> None:
    state.force = state.force * (1 + size)


def inertia(state: Insertion, size: float, _n: Numbers) -> None:
    """A holder that is not quite rigid: the acceleration arrives with a lag of 3 ms."""
    keep = np.exp(-1 / (FINE_HZ * 0.003))
    state.force = state.force + size * 1e-3 * lfilter([1 - keep], [1, -keep], state.acceleration)


def latency(state: Insertion, size: float, _n: Numbers) -> None:
    """Nine tenths of the delay are a pure delay, one tenth is a filter of first order."""
    late = np.interp(state.time - 0.9 * size, state.time, state.force)
    keep = np.exp(-1 / (FINE_HZ * 0.1 * size)) if size > 1e-5 else 0.0
    state.force = lfilter([1 - keep], [1, -keep], late)


def respiration(state: Insertion, size: float, n: Numbers) -> None:
    """Even powers of a cosine, as Lujan's, with breaths that are not quite equally long."""
    phase = n["phase_rad"]
    phase = phase[state.trial.number] if isinstance(phase, list) else phase
    angle = 2 * np.pi * n["frequency_hz"] * state.time + phase
    angle = angle + 0.08 * np.sin(0.37 * angle + 1.0)
    wave = ((1 + np.sin(angle)) / 2) ** (1 + 0.95 * n["rest"])
    state.move(state.depth - size * wave)


def play(x: Array, gap: float) -> Array:
    """Give the position of the needle behind a gap that opens when the motor turns back."""
    out, at = np.empty_like(x), float(x[0])
    turns = np.flatnonzero(np.diff(np.sign(np.diff(x, prepend=x[0]))) != 0)
    edges = [0, *turns.tolist(), x.size - 1]
    for first, last in pairwise(edges):
        part = x[first : last + 1]
        out[first : last + 1] = np.maximum(at, part) if part[-1] >= part[0] else np.minimum(at, part + gap)
        at = float(out[last])
    return out


def backlash(state: Insertion, size: float, _n: Numbers) -> None:
    """Two gaps in parallel: the flank of the gear gives way a little."""
    state.move(0.85 * play(state.depth, size) + 0.15 * play(state.depth, 1.25 * size))


def drive_stick(state: Insertion, size: float, _n: Numbers) -> None:
    """The lag after a rest or a reversal; what is left of the one before decays along the travel."""
    if not size:
        return
    x, rest = state.depth, state.rests
    ways = np.sign(np.diff(x, prepend=x[0])) * (rest == 0)
    begins = np.flatnonzero((np.diff(ways, prepend=0.0) != 0) & (ways != 0))
    lag, left = np.zeros_like(x), 0.0
    for first, last in zip(begins, np.append(begins[1:], x.size), strict=True):
        s = np.abs(x[first:last] - x[first]) / size
        lag[first:last] = left * np.exp(-s) + ways[first] * size * s * np.exp(-(s**1.05) / np.e)
        left = float(lag[last - 1])
    state.move(x - lag)


def guide_friction(state: Insertion, size: float, _n: Numbers) -> None:
    z = state.law.bristle(state.trial.path.depth_mm, 1.3 * state.trial.base["presliding_mm"])
    state.force = state.force + size * z


def friction_by_direction(state: Insertion, size: float, _n: Numbers) -> None:
    state.force = state.force - size * state.shaft * np.maximum(-state.z, 0.0) ** 1.1


def entry_spring(state: Insertion, size: float, n: Numbers) -> None:
    q = state.inside / n["depth_mm"]
    state.force = state.force + size * state.inside * (1 + q**8) ** -0.125


def track_ageing(state: Insertion, size: float, n: Numbers) -> None:
    def aged(there: Array, _travel: Array) -> Array:
        entered = np.diff(there.astype(np.int8), axis=0, prepend=0) > 0
        earlier = np.maximum(np.cumsum(entered, axis=0) - 1, 0)
        return np.asarray(-np.expm1(-((earlier / n["insertions"]) ** 0.95)))

    state.force = state.force - size * state.trial.base["friction"] * state.z * state.along_shaft(aged)


def _number(rng: Generator, low: float, high: float) -> float:
    return round(float(np.exp(rng.uniform(np.log(low), np.log(high)))), 3)


def _place(rng: Generator, deep: float, low: float = 0.25, high: float = 0.75) -> Numbers:
    return {
        "depth_mm": round(float(rng.uniform(low, high)) * deep, 2),
        "scatter_mm": np.round(0.12 * rng.standard_normal(5), 3).tolist(),
    }


def _breath(rng: Generator, phases: int | None) -> Numbers:
    phase = np.round(rng.uniform(-np.pi, np.pi, phases), 3)
    return {
        "frequency_hz": _number(rng, 0.15, 0.42), "rest": round(float(rng.random()), 2),
        "phase_rad": phase.tolist() if phases else float(phase),
    }  # fmt: skip


def _weaker(share: float) -> Any:
    return lambda _n, base, _deep: share * base["friction"]


BOTH = (1.0, -1.0)
DOCUMENTED_EFFECTS = (
    Effect("puncture", "force", "N", 0.01, 2.5, puncture, "depth", ("phase",),
           lambda r, d: {**_place(r, d), "bulge_mm": _number(r, 0.8, 4)}),
    Effect("cutting_layer", "force", "N", 0.005, 1.0, cutting_layer, "depth", ("direction",),
           lambda r, d: {**_place(r, d), "width_mm": _number(r, 0.3, 2.5)}, BOTH, lambda _n, b, _d: 0.7 * b["cutting"]),
    Effect("fresh_cutting", "force", "", 0.01, 1.0, fresh_cutting, "phase", ("depth", "direction"),
           lambda r, _d: {"margin_mm": _number(r, 0.2, 3)}),
    Effect("cutting_with_depth", "force", "N/mm", 1e-4, 0.03, cutting_with_depth, "depth", ("direction", "force"),
           signs=BOTH, limit=lambda _n, b, d: 0.7 * b["cutting"] / d),
    Effect("friction_layer", "force", "N/mm", 2e-4, 0.07, friction_layer, "depth", ("force",),
           _place, BOTH, _weaker(0.7)),
    Effect("stribeck", "force", "", 0.005, 1.5, stribeck, "speed", ("phase", "hold"),
           lambda r, _d: {"speed_mm_s": _number(r, 0.6, 6)}),
    Effect("viscous", "force", "N s/mm2", 1e-5, 0.005, viscous, "speed", ("force",),
           signs=BOTH, limit=_weaker(0.03)),
    Effect("bristle", "contact", "mm", 0.005, 5.0, bristle, "phase", ("direction", "depth")),
    Effect("relaxation", "whole", "", 0.005, 0.7, relaxation, "hold", ("time", "phase"),
           lambda r, _d: {"time_s": _number(r, 0.3, 5), "recovery_mm": _number(r, 0.05, 1.5)}),
    Effect("tissue_motion", "tissue", "mm", 0.004, 3.0, tissue_motion, "phase", ("direction", "hold", "speed", "time"),
           lambda r, _d: {"lag_s": _number(r, 0.1, 2)}, weight=1.5),
    Effect("path_damage", "force", "", 0.01, 0.9, path_damage, "time", ("depth", "direction", "phase"),
           lambda r, _d: {"sliding_mm": _number(r, 15, 300)}),
    Effect("bump", "force", "N", 0.005, 1.2, bump, "depth", ("position wave",),
           lambda r, d: {"depth_mm": _place(r, d)["depth_mm"], "width_mm": _number(r, 0.7, 3)}, (1.0, 1.0, -1.0)),
    Effect("bias", "sensor", "N", 5e-4, 0.3, bias, "force", ("time", "phase", "direction"),
           lambda r, _d: {"of_trial": np.round(1 + 0.05 * r.standard_normal(5), 3).tolist()}, BOTH),
    Effect("drift", "sensor", "N/s", 5e-5, 0.03, drift, "time", signs=BOTH),
    Effect("thermal_drift", "sensor", "N", 5e-4, 0.6, thermal_drift, "time", (),
           lambda r, _d: {"time_s": _number(r, 2, 25)}, BOTH),
    Effect("gain_error", "sensor", "", 0.005, 0.3, gain_error, "force", signs=BOTH, weight=0.0),
    Effect("inertia", "sensor", "kg", 0.01, 2.0, inertia, "acceleration", ("phase",)),
    Effect("latency", "sensor", "s", 5e-4, 0.1, latency, "phase", ("direction", "acceleration", "speed")),
    Effect("respiration", "tissue", "mm", 0.004, 6.0, respiration, "time", ("phase", "hold"),
           lambda r, _d: _breath(r, None), weight=2.5),
    Effect("backlash", "drive", "mm", 0.003, 2.0, backlash, "phase", ("direction", "depth"),
           tier="further", weight=1.2),
    Effect("drive_stick", "drive", "mm", 0.003, 2.0, drive_stick, "phase", ("hold", "acceleration", "direction"),
           tier="further", weight=1.2),
    Effect("guide_friction", "force", "N", 0.002, 0.6, guide_friction, "direction", ("depth", "force", "phase"),
           tier="further", weight=0.5),
    Effect("friction_by_direction", "force", "", 0.005, 1.5, friction_by_direction, "direction",
           ("force", "depth", "phase"), signs=BOTH, limit=lambda _n, _b, _d: 0.7, tier="further", weight=0.5),
    Effect("entry_spring", "force", "N/mm", 1e-4, 0.05, entry_spring, "depth", ("force",),
           lambda r, _d: {"depth_mm": round(float(r.uniform(4, 30)), 1)}, tier="further", weight=0.5),
    Effect("track_ageing", "force", "", 0.01, 0.9, track_ageing, "time", ("phase", "direction", "depth"),
           lambda r, _d: {"insertions": _number(r, 0.5, 4)}, tier="further", weight=0.5),
    Effect("respiration_by_trial", "tissue", "mm", 0.004, 6.0, respiration, "time", ("phase", "hold"),
           lambda r, _d: _breath(r, 5), tier="further", weight=1.25),
)  # fmt: skip
