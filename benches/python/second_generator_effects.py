"""Hidden effects of the second generator that have a name in the library, each with a formula of its own.

Each acts at one of three places: on the motion in the tissue, on the law of the force, or in the sensor. The names and
the physics are those of the reference page on diagnosis; the formulas were written without the library's and differ
from the simplest law by some per cent.
"""
# ruff: noqa: ARG001

from collections.abc import Callable

import numpy as np
from scipy.signal import lfilter
from second_generator_hidden import Kind, Numbers, uniform
from second_generator_law import FINE_HZ, Insertion, elasto_plastic, shares

LOOP_HZ = 250  # rate of the implicit integration of moving tissue


def _puncture(trial: Insertion, force: np.ndarray, size: float, at: Numbers, number: int) -> np.ndarray:
    behind = trial.depth - at["depth_mm"]
    rise = np.clip(1 + behind / at["width_mm"], 0.0, 1.0) ** 1.6
    fresh = np.exp(-(trial.deepest - trial.length) / 0.15)
    return size * np.where(behind < 0, rise, np.exp(-np.maximum(behind, 0) / 0.25)) * fresh


def _cutting_layer(trial: Insertion, force: np.ndarray, size: float, at: Numbers, number: int) -> np.ndarray:
    return size * (1 + np.tanh((trial.depth - at["depth_mm"]) / 0.5)) / 2 * trial.push


def _fresh_cutting(trial: Insertion, force: np.ndarray, size: float, at: Numbers, number: int) -> np.ndarray:
    return -size * trial.tip * (1 - 1 / (1 + ((trial.deepest - trial.length) / 0.3) ** 2))


def _cutting_with_depth(trial: Insertion, force: np.ndarray, size: float, at: Numbers, number: int) -> np.ndarray:
    return size * 30 * (trial.length / 30) ** 1.08 * trial.push


def _friction_layer(trial: Insertion, force: np.ndarray, size: float, at: Numbers, number: int) -> np.ndarray:
    return size * 0.6 * np.logaddexp(0, (trial.length - at["depth_mm"]) / 0.6) * trial.grip


def _stribeck(trial: Insertion, force: np.ndarray, size: float, at: Numbers, number: int) -> np.ndarray:
    return size * trial.length * np.exp(-((np.abs(trial.speed) / at["speed_mm_s"]) ** 1.3)) * trial.grip


def _viscous(trial: Insertion, force: np.ndarray, size: float, at: Numbers, number: int) -> np.ndarray:
    return size * trial.length * trial.speed * (np.abs(trial.speed / 5) + 1e-3) ** -0.07


def _bristle(trial: Insertion, force: np.ndarray, size: float, at: Numbers, number: int) -> np.ndarray:
    long = elasto_plastic(trial.depth, shares(at["presliding_mm"]), turns=trial.turns)
    return size * trial.hold_force * (long - trial.grip)


def _relaxation(trial: Insertion, force: np.ndarray, size: float, at: Numbers, number: int) -> np.ndarray:
    path, lasted = trial.since_hold
    tau = at["time_s"]

    def lost(seconds: np.ndarray) -> np.ndarray:
        return 1 - np.exp(-((seconds / tau) ** 0.9))

    share = np.where(
        trial.held > 0, lost(trial.held), lost(lasted) * np.exp(-np.minimum(path / at["recovery_mm"], 700))
    )
    return -size * force * share


def _path_damage(trial: Insertion, force: np.ndarray, size: float, at: Numbers, number: int) -> np.ndarray:
    return -size * trial.shaft * (1 - (1 + trial.slid / (5 * at["path_mm"])) ** -5)


def _bump(trial: Insertion, force: np.ndarray, size: float, at: Numbers, number: int) -> np.ndarray:
    away = np.clip((trial.depth - at["depth_mm"]) / at["width_mm"], -300, 300)
    return size / np.cosh(1.2 * away) ** 2 * trial.grip


def _tissue_motion(trial: Insertion, depth: np.ndarray, size: float, at: Numbers, number: int) -> np.ndarray:
    """Kelvin-Voigt tissue that the shaft drags: u + tau du/dt = size C(L) z, with z of one element, implicit Euler."""
    step = max(FINE_HZ // LOOP_HZ, 1)
    coarse = depth[::step]
    limits = (size * trial.hold_force[::step]).tolist()
    moves = np.diff(coarse, prepend=coarse[0]).tolist()
    lag = at["time_s"] * LOOP_HZ
    keep, gain, yields = lag / (1 + lag), 1 / (1 + lag), trial.tissue.presliding_mm
    state, moved = 0.0, 0.0
    path = []
    for move, limit in zip(moves, limits, strict=True):
        state = (state + (move + moved * (1 - keep)) / yields) / (1 + gain * limit / yields)
        state = min(max(state, -1.0), 1.0)
        moved = keep * moved + gain * limit * state
        path.append(moved)
    return depth - np.interp(np.arange(len(depth)), np.arange(len(path)) * step, path)


def breath(time: np.ndarray, frequency: float, phase: float, rest: float) -> np.ndarray:
    """Peak-to-peak 1: a sine for `rest` 0, a shape that dwells after expiration for `rest` 1."""
    turn = np.cos(2 * np.pi * frequency * time + phase)
    dwelling = (np.exp(turn - 1) - np.exp(-2)) / (1 - np.exp(-2)) - 0.5
    return (1 - rest) * turn / 2 + rest * dwelling


def _respiration(trial: Insertion, depth: np.ndarray, size: float, at: Numbers, number: int) -> np.ndarray:
    return depth - size * breath(trial.time, at["frequency_hz"], at["phase_rad"], at["rest"])


def _inertia(trial: Insertion, force: np.ndarray, size: float, at: Numbers, number: int) -> np.ndarray:
    decay = np.exp(-1 / (FINE_HZ * 0.002))  # the mount yields within 2 ms
    return 1e-3 * size * lfilter([1 - decay], [1, -decay], trial.stage[2])


def _bias(trial: Insertion, force: np.ndarray, size: float, at: Numbers, number: int) -> np.ndarray:
    return force + size * (1 + 0.03 * np.sin(trial.time / 7 + number))


def _drift(trial: Insertion, force: np.ndarray, size: float, at: Numbers, number: int) -> np.ndarray:
    return force + size * trial.time * (1 + 0.08 * (trial.time / trial.time[-1] - 0.5))


def _thermal_drift(trial: Insertion, force: np.ndarray, size: float, at: Numbers, number: int) -> np.ndarray:
    nodes = 0.9 * np.expm1(-np.maximum(trial.time, 0) / at["time_s"]) + 0.1 * np.expm1(
        -np.maximum(trial.time, 0) / (3 * at["time_s"])
    )
    return force - size * nodes


def _gain_error(trial: Insertion, force: np.ndarray, size: float, at: Numbers, number: int) -> np.ndarray:
    return force * (1 + size)


def _latency(trial: Insertion, force: np.ndarray, size: float, at: Numbers, number: int) -> np.ndarray:
    delayed = np.interp(trial.time - 0.9 * size, trial.time, force)
    decay = np.exp(-1 / (FINE_HZ * 0.1 * size))
    return lfilter([1 - decay], [1, -decay], delayed)


def _place(low: float, high: float, **others: tuple[float, float]) -> Callable[[np.random.Generator], Numbers]:
    return uniform(depth_mm=(low, high), **others)


def draw_breath(rng: np.random.Generator) -> Numbers:
    return {**uniform(frequency_hz=(0.18, 0.35), phase_rad=(0, 2 * np.pi))(rng), "rest": float(rng.integers(2))}


LIBRARY = (
    Kind(
        "puncture",
        "law",
        "depth",
        "size (1 + (d - d0)/w)^1.6 before d0, exp(-(d - d0)/0.25 mm) after, first pass only",
        _puncture,
        0.2,
        0.002,
        4.0,
        "N",
        _place(8, 42, width_mm=(2.0, 4.0)),
    ),
    Kind(
        "cutting_layer",
        "law",
        "depth",
        "size (1 + tanh((d - d0)/0.5 mm))/2 on advance",
        _cutting_layer,
        0.1,
        0.0005,
        2.0,
        "N",
        _place(12, 40),
    ),
    Kind(
        "fresh_cutting",
        "law",
        "depth",
        "-size T(d) (1 - 1/(1 + ((deepest - d)/0.3 mm)^2))",
        _fresh_cutting,
        0.3,
        0.001,
        1.0,
        "1",
        also=("path",),
    ),
    Kind(
        "cutting_with_depth",
        "law",
        "depth",
        "size 30 (d/30)^1.08 on advance",
        _cutting_with_depth,
        0.003,
        5e-5,
        0.05,
        "N/mm",
    ),
    Kind(
        "friction_layer",
        "law",
        "depth",
        "size 0.6 ln(1 + exp((L - d0)/0.6 mm)) z",
        _friction_layer,
        0.005,
        1e-4,
        0.1,
        "N/mm",
        _place(12, 40),
    ),
    Kind(
        "stribeck",
        "law",
        "speed",
        "size L exp(-(|v|/v0)^1.3) z",
        _stribeck,
        0.005,
        1e-4,
        0.05,
        "N/mm",
        uniform(speed_mm_s=(1.2, 4.0)),
    ),
    Kind("viscous", "law", "speed", "size L v |v/5|^-0.07", _viscous, 2e-4, 1e-6, 0.01, "N s/mm2"),
    Kind(
        "bristle",
        "law",
        "direction",
        "a share size of C(L) has elements of a longer presliding",
        _bristle,
        0.3,
        0.02,
        1.0,
        "1",
        uniform(presliding_mm=(0.6, 3.0)),
        also=("phase", "path"),
    ),
    Kind(
        "relaxation",
        "law",
        "hold",
        "a share size of F is lost as 1 - exp(-(t/tau)^0.9), and returns as exp(-path/r)",
        _relaxation,
        0.1,
        0.0005,
        0.9,
        "1",
        uniform(time_s=(0.4, 1.5), recovery_mm=(0.2, 0.6)),
        also=("phase",),
    ),
    Kind(
        "tissue_motion",
        "motion",
        "direction",
        "u + tau u' = size C(L) z; depth in the tissue d - u",
        _tissue_motion,
        0.3,
        0.02,
        3.0,
        "mm/N",
        uniform(time_s=(0.05, 0.5)),
        also=("phase", "path"),
    ),
    Kind(
        "path_damage",
        "law",
        "path",
        "-size C(L) z (1 - (1 + W/(5 W0))^-5), W the path slid",
        _path_damage,
        0.2,
        0.005,
        0.9,
        "1",
        uniform(path_mm=(40, 120)),
        also=("time",),
    ),
    Kind(
        "bump",
        "law",
        "depth",
        "size sech^2(1.2 (d - d0)/w) z",
        _bump,
        0.1,
        0.0005,
        2.0,
        "N",
        _place(8, 42, width_mm=(1.0, 3.0)),
    ),
    Kind(
        "bias", "sensor", "time", "size (1 + 0.03 sin(t/7 s + trial))", _bias, 0.02, 0.0005, 1.0, "N", also=("force",)
    ),
    Kind("drift", "sensor", "time", "size t (1 + 0.08 (t/T - 0.5))", _drift, 0.001, 2e-5, 0.1, "N/s"),
    Kind(
        "thermal_drift",
        "sensor",
        "time",
        "size (1 - 0.9 exp(-t/tau) - 0.1 exp(-t/(3 tau)))",
        _thermal_drift,
        0.05,
        0.0003,
        2.0,
        "N",
        uniform(time_s=(3, 12)),
    ),
    Kind("gain_error", "sensor", "force", "size F", _gain_error, 0.1, 0.01, 0.3, "1"),
    Kind(
        "inertia",
        "law",
        "acceleration",
        "size a, through a lag of 2 ms",
        _inertia,
        0.5,
        0.02,
        30.0,
        "kg",
        also=("speed", "phase"),
    ),
    Kind(
        "latency",
        "sensor",
        "direction",
        "F(t - 0.9 size) through a lag of 0.1 size",
        _latency,
        0.03,
        0.012,
        0.12,
        "s",
        also=("phase", "time"),
    ),
    Kind(
        "respiration",
        "motion",
        "time",
        "d - size b(t); b a sine (rest 0) or (exp(cos - 1) - e^-2)/(1 - e^-2) (rest 1)",
        _respiration,
        1.0,
        0.05,
        12.0,
        "mm",
        draw_breath,
    ),
)
