"""Effects outside of the documented library, on every axis that a gap can depend on.

Each has a cause that a laboratory knows. None is a documented effect under another name; what a documented
effect may imitate in part is left to the engine to tell.
"""

from itertools import pairwise

import numpy as np
from numpy.random import Generator
from scipy.signal import lfilter
from third_generator_documented import BOTH, Numbers, _number
from third_generator_motion import FINE_HZ, Array
from third_generator_state import Effect, Insertion


def fibre_layers(state: Insertion, size: float, n: Numbers) -> None:
    """Stacked fibres: the cutting force waves with the depth."""
    wave = np.sin(2 * np.pi * state.depth / n["period_mm"] + n["phase_rad"]) * -np.expm1(-state.inside / 2)
    state.force = state.force + size * wave * state.pushed


def fibre_snaps(state: Insertion, size: float, n: Numbers) -> None:
    """Fibres that load the tip and snap one after the other, on the first pass only."""
    edges = np.asarray(n["depths_mm"])
    index = np.clip(np.searchsorted(edges, state.depth) - 1, 0, edges.size - 2)
    saw = (state.depth - edges[index]) / (edges[index + 1] - edges[index])
    fresh = np.exp(-np.maximum(state.deepest - state.depth, 0.0) / 0.1)
    state.force = state.force + size * (np.clip(saw, 0, 1) ** 1.5 - 0.4) * fresh * state.pushed * (
        state.depth > edges[0]
    )


def drying(state: Insertion, size: float, _n: Numbers) -> None:
    """Friction that grows with the time, first slowly, then faster."""
    state.force = state.force + size * state.shaft * state.z * (state.time / 20.0) ** 1.6


def pulse(state: Insertion, size: float, n: Numbers) -> None:
    """Blood pressure: the grip of the tissue on the shaft pulses with the heart, another phase in each trial."""
    beat = np.sin(2 * np.pi * n["hz"] * state.time + n["phase_rad"][state.trial.number])
    state.force = state.force + size * state.shaft * state.z * (beat + 0.4 * beat**2)


def zero_step(state: Insertion, size: float, n: Numbers) -> None:
    """The sensor's mount slips at some time: the zero jumps."""
    at = n["share_of_time"][state.trial.number] * state.time[-1]
    state.force = state.force + size / (1 + np.exp(-np.clip((state.time - at) / 0.03, -60, 60)))


def knocks(state: Insertion, size: float, n: Numbers) -> None:
    """Somebody touches the bench: short decaying oscillations of the force."""
    total = np.zeros_like(state.time)
    for share in n["share_of_time"][4 * state.trial.number : 4 * state.trial.number + 4]:
        t = np.clip(state.time - share * state.time[-1], 0.0, 3.0)
        total += np.exp(-t / 0.25) * np.sin(2 * np.pi * n["hz"] * t)
    state.force = state.force + size * total


def wandering_zero(state: Insertion, size: float, n: Numbers) -> None:
    """A zero that wanders over some seconds, otherwise in each trial."""
    rng = np.random.default_rng([n["seed"], state.trial.number])
    knots = rng.standard_normal(int(state.time[-1] / n["time_s"]) + 3)
    t = state.time / n["time_s"]
    index = t.astype(int)
    part = (1 - np.cos(np.pi * (t - index))) / 2
    state.force = state.force + size * (knots[index] * (1 - part) + knots[index + 1] * part)


def speed_resonance(state: Insertion, size: float, n: Numbers) -> None:
    """Stick-slip in a band of speeds costs more friction there."""
    band = np.exp(-(((np.abs(state.velocity) - n["speed_mm_s"]) / n["width_mm_s"]) ** 2))
    state.force = state.force + size * state.shaft * state.z * band


def cutting_rate(state: Insertion, size: float, n: Numbers) -> None:
    """Fracture that depends on the rate: the force of the tip is a power of the speed."""
    ratio = (np.maximum(state.velocity, 0.2) / 5.0) ** n["exponent"]
    state.force = state.force + size * state.tip * (ratio - 1) * state.pushed


def warmed_contact(state: Insertion, size: float, n: Numbers) -> None:
    """Friction that follows the speed of the last seconds."""
    keep = np.exp(-1 / (FINE_HZ * n["time_s"]))
    mean = lfilter([1 - keep], [1, -keep], np.abs(state.velocity))
    state.force = state.force - size * state.shaft * state.z * mean / (mean + 4.0)


def turn_ringing(state: Insertion, size: float, n: Numbers) -> None:
    """After a reversal the drive rings for half a second or so."""
    late, _ = state.since_turn()
    ring = np.exp(-late / n["time_s"]) * np.sin(2 * np.pi * n["hz"] * late)
    state.force = state.force + size * ring * (state.depth > 0)


def recoil(state: Insertion, size: float, n: Numbers) -> None:
    """Tissue creeps against the needle during a rest, whatever the sign of the force; motion ends it."""
    late = state.since_rest_began()
    growth = np.log1p(late / n["time_s"]) / np.log(4.0)
    keep = np.exp(-1 / (FINE_HZ * 0.15))
    state.force = state.force + size * lfilter([1 - keep], [1, -keep], growth) * (state.depth > 0)


def rest_ripple(state: Insertion, size: float, n: Numbers) -> None:
    """A controller that hunts about its set point while it rests."""
    grip = lfilter([1 / 200], [1, -(1 - 1 / 200)], state.rests)
    state.force = state.force + size * grip * np.sin(2 * np.pi * n["hz"] * state.time)


def adhesion(state: Insertion, size: float, n: Numbers) -> None:
    """Tissue sticks during a rest: a peak when the motion begins again, higher after a longer rest."""
    late, x = state.since_rest_began(), state.trial.path.depth_mm
    begins = np.flatnonzero((late[:-1] > 0) & (late[1:] == 0)) + 1
    peak = np.zeros_like(x)
    for first, last in zip(begins, np.append(begins[1:], x.size), strict=True):
        s = np.abs(x[first:last] - x[first]) / n["travel_mm"]
        peak[first:last] = np.log1p(late[first - 1] / 0.3) * s * np.exp(1 - s)
    way = np.sign(state.trial.path.velocity_mm_s)
    state.force = state.force + size * state.shaft * peak * way


def saturation(state: Insertion, size: float, _n: Numbers) -> None:
    """The bridge of the sensor saturates: it shows large forces too small."""
    state.force = state.force - size * state.force**3 / (1 + state.force**2)


def sensor_hysteresis(state: Insertion, size: float, n: Numbers) -> None:
    """The sensor lags behind by a force after each turn of the force, as a glued strain gauge does."""
    force, width = state.force, n["width_n"]
    turns = np.flatnonzero(np.diff(np.sign(np.diff(force, prepend=force[0]))) != 0)
    edges, at, out = [0, *turns.tolist(), force.size - 1], 0.0, np.zeros_like(force)
    for first, last in pairwise(edges):
        out[first : last + 1] = np.clip(at + (force[first : last + 1] - force[first]) / width, -1, 1)
        at = float(out[last])
    state.force = force - size * out


def dead_band(state: Insertion, size: float, _n: Numbers) -> None:
    """A loose screw in the clamp: small forces are not transmitted."""
    state.force = state.force - size * np.tanh(state.force / size) if size else state.force


def suction(state: Insertion, size: float, n: Numbers) -> None:
    """Withdrawal leaves a vacuum: a pull that builds up with the distance, and that ends when air enters."""
    _, far = state.since_turn()
    back = np.maximum(-state.z, 0.0)
    state.force = state.force - size * -np.expm1(-far / n["travel_mm"]) * back * -np.expm1(-state.inside / 6)


def new_track(state: Insertion, size: float, n: Numbers) -> None:
    """A second insertion leaves the old track and wedges between two: friction beside it, growing from the turn."""
    _, far = state.since_turn()
    again = (state.deepest - state.depth > 0.3) & (state.velocity > 0)
    keep = np.exp(-1 / (FINE_HZ * 0.05))
    state.force = state.force + size * lfilter([1 - keep], [1, -keep], again * far / (far + n["travel_mm"]))


def ringing_holder(state: Insertion, size: float, n: Numbers) -> None:
    """A slack holder swings at some hertz when the stage accelerates; its quasi-static part, a mass, is left out."""
    w, damping = 2 * np.pi * n["hz"], n["damping"]
    pole = np.exp((-damping + 1j * np.sqrt(1 - damping**2)) * w / FINE_HZ)
    below = [1.0, -2 * pole.real, abs(pole) ** 2]
    swing = lfilter([sum(below)], below, state.acceleration)
    state.force = state.force + size * 1e-3 * (swing - state.acceleration)


def slack_cable(state: Insertion, size: float, _n: Numbers) -> None:
    """A cable swings to one side at strong accelerations: a force with their square root."""
    keep = np.exp(-1 / (FINE_HZ * 0.02))
    pull = np.sqrt(np.abs(state.acceleration) / 100.0)
    state.force = state.force + size * lfilter([1 - keep], [1, -keep], pull)


def spindle_ripple(state: Insertion, size: float, n: Numbers) -> None:
    """A bent spindle pushes once in a turn, whichever way it moves."""
    state.force = state.force + size * np.sin(2 * np.pi * state.trial.path.depth_mm / n["period_mm"] + n["phase_rad"])


def thread_friction(state: Insertion, size: float, n: Numbers) -> None:
    """An oval bearing rubs twice in a turn, against the movement."""
    wave = np.sin(2 * np.pi * state.trial.path.depth_mm / n["period_mm"] + n["phase_rad"])
    state.force = state.force + size * wave * state.law.bristle(state.trial.path.depth_mm, 0.2)


def _phase(rng: Generator) -> float:
    return round(float(rng.uniform(-np.pi, np.pi)), 3)


def _times(rng: Generator, count: int) -> list[float]:
    return [round(float(each), 3) for each in rng.uniform(0.15, 0.85, count)]


def _snaps(rng: Generator, deep: float) -> Numbers:
    gaps: Array = rng.uniform(2.5, 6.0, 40)
    return {"depths_mm": [round(float(each), 2) for each in 0.1 * deep + np.cumsum(gaps)]}


OUTSIDE_EFFECTS = (
    Effect("fibre_layers", "force", "N", 0.001, 0.6, fibre_layers, "position wave", ("depth",),
           lambda r, _d: {"period_mm": _number(r, 2.5, 9), "phase_rad": _phase(r)}),
    Effect("fibre_snaps", "force", "N", 0.001, 0.6, fibre_snaps, "depth", ("position wave",), _snaps),
    Effect("drying", "force", "", 0.001, 0.6, drying, "time", ("force",)),
    Effect("pulse", "force", "", 0.001, 0.4, pulse, "time", ("force",),
           lambda r, _d: {"hz": _number(r, 0.9, 1.6), "phase_rad": [_phase(r) for _ in range(5)]}),
    Effect("zero_step", "sensor", "N", 5e-4, 0.4, zero_step, "time", (),
           lambda r, _d: {"share_of_time": _times(r, 5)}, BOTH),
    Effect("knocks", "sensor", "N", 0.001, 0.8, knocks, "time", (),
           lambda r, _d: {"share_of_time": _times(r, 20), "hz": _number(r, 2, 5)}),
    Effect("wandering_zero", "sensor", "N", 5e-4, 0.15, wandering_zero, "time", (),
           lambda r, _d: {"time_s": _number(r, 2, 6), "seed": int(r.integers(1 << 30))}),
    Effect("speed_resonance", "force", "", 0.002, 0.8, speed_resonance, "speed", ("force",),
           lambda r, _d: {"speed_mm_s": round(float(r.uniform(3, 10)), 2), "width_mm_s": _number(r, 0.8, 2)}),
    Effect("cutting_rate", "force", "", 0.005, 1.5, cutting_rate, "speed", ("direction",),
           lambda r, _d: {"exponent": round(float(r.uniform(0.25, 0.6)), 3)}),
    Effect("warmed_contact", "force", "", 0.005, 0.9, warmed_contact, "speed", ("time", "phase", "force"),
           lambda r, _d: {"time_s": _number(r, 1, 4)}),
    Effect("turn_ringing", "sensor", "N", 0.001, 0.8, turn_ringing, "phase", ("time", "direction"),
           lambda r, _d: {"time_s": _number(r, 0.3, 1), "hz": _number(r, 1.5, 5)}),
    Effect("recoil", "force", "N", 0.001, 0.4, recoil, "hold", ("time", "phase"),
           lambda r, _d: {"time_s": _number(r, 0.1, 0.6)}, BOTH),
    Effect("rest_ripple", "sensor", "N", 0.001, 0.4, rest_ripple, "hold", ("time", "phase"),
           lambda r, _d: {"hz": _number(r, 1.5, 6)}),
    Effect("adhesion", "force", "", 0.002, 0.5, adhesion, "hold", ("phase", "force"),
           lambda r, _d: {"travel_mm": _number(r, 0.3, 1.5)}),
    Effect("saturation", "sensor", "", 0.005, 0.6, saturation, "force"),
    Effect("sensor_hysteresis", "sensor", "N", 0.001, 0.25, sensor_hysteresis, "force", ("direction", "phase"),
           lambda r, _d: {"width_n": _number(r, 0.3, 1.2)}),
    Effect("dead_band", "sensor", "N", 0.002, 0.25, dead_band, "force", ("direction", "phase")),
    Effect("suction", "force", "N", 0.002, 0.8, suction, "direction", ("phase", "depth"),
           lambda r, _d: {"travel_mm": _number(r, 4, 15)}),
    Effect("new_track", "force", "N", 0.002, 0.8, new_track, "direction", ("phase", "depth"),
           lambda r, _d: {"travel_mm": _number(r, 2, 8)}),
    Effect("ringing_holder", "sensor", "kg", 0.002, 2.0, ringing_holder, "acceleration", ("phase", "time"),
           lambda r, _d: {"hz": _number(r, 3, 12), "damping": round(float(r.uniform(0.03, 0.12)), 3)}),
    Effect("slack_cable", "sensor", "N", 0.001, 0.3, slack_cable, "acceleration", ("phase", "speed")),
    Effect("spindle_ripple", "sensor", "N", 5e-4, 0.3, spindle_ripple, "position wave", ("depth",),
           lambda r, _d: {"period_mm": _number(r, 1.0, 5), "phase_rad": _phase(r)}),
    Effect("thread_friction", "force", "N", 5e-4, 0.3, thread_friction, "position wave", ("depth",),
           lambda r, _d: {"period_mm": _number(r, 1.0, 5), "phase_rad": _phase(r)}),
)  # fmt: skip
