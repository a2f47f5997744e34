"""Errors due to simplifications of the friction model and of the signals: section 3.2 and Fig. 3.7.

- Section 3.2: lumped and averaged models are compared with the distributed model, which they approximate.
- Delays: the fast observer of the thesis, [40, 400], delays the velocity by 0.1 s, and a moving average over five
  samples delays the force by 10 ms. Two signals with different delays form an open loop, which the fit attributes to
  the bristles.
- Fig. 3.7: tissue that moves with the needle. The hysteresis loop nearly vanishes if the force is plotted against the
  velocity relative to the tissue.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from needleplan.models import AveragedLuGre, Beta, LumpedLuGre, Profile, distributed, fit, simulate
from needleplan.models.friction import LuGre, steady
from needleplan.models.tissue import LumpedOnTissue, tune_slow_observer
from needleplan.plotting import caption, save
from needleplan.plotting.canvas import BLUE, GREY, ORANGE, SKY, title
from needleplan.reports.comparison import Agreement, Comparison, Evidence
from needleplan.signals import Array, HighGainObserver, Motion, MovingAverage, Record, Start, sinusoid
from needleplan_thesis.chapter3.published import CASES, model_ii, model_iii_b, passing_through

__all__ = ["averaging", "deforming_tissue", "opening", "peaks", "velocity_lag"]

_REFERENCE = "rms deviation from the distributed model with the same parameters, solved along its characteristics"


def peaks() -> list[Comparison]:
    """List the largest forces of Models II and III-B, case 1. The thesis does not print them."""
    rows = []
    for label, model in (("II", model_ii(1)), ("III-B", model_iii_b(1))):
        motion = passing_through(1, cycles=2)
        force = simulate(model, motion).output[motion.time_s > 1 / CASES[1].frequency_hz]
        for name, value in (("in", force.max()), ("out", force.min())):
            rows.append(Comparison(
                f"ch3/section 3.2/largest force of Model {label} on the way {name}, case 1", None, float(value), "N",
                Agreement.OURS, "beta v lowers it on the way in and raises it on the way out" if label != "II" else "",
                kind=Evidence.COMPUTED,
            ))  # fmt: skip
    return rows


def averaging(note: Callable[[str], None], rate_hz: float) -> list[Comparison]:
    """Compare lumped and averaged models with the distributed model.

    Two motions are used: with a constant contact length (needle through the tissue), and with the tip inside.
    """
    note("friction: lumped models compared with the distributed model")
    rows = []
    for case, each in CASES.items():
        through = passing_through(case, cycles=1.25, rate_hz=rate_hz)
        inside = sinusoid(
            offset_mm=38, amplitude_mm=25, frequency_hz=each.frequency_hz, cycles=1.25, start=Start.MIDDLE,
            rate_hz=rate_hz,
        )  # fmt: skip
        two, three = model_ii(case), model_iii_b(case)
        values = {name: value for name, value in three.values().items() if name != "exponent"}
        two_with_length = LumpedLuGre(**values, profile=Profile.ISOSCELES)
        # One call per parameter set, because the distributed model is slow.
        rows += _compared(case, through, Profile.UNIFORM, {"constant patch, uniform force: II": two})
        rows += _compared(case, through, Profile.ISOSCELES, {"constant patch, trapezoid: II": two})
        rows += _compared(case, through, Profile.ISOSCELES, {
            "constant patch: III-B, beta v": three,
            "constant patch: III-B, beta |v|": _with(three, Beta.ABSOLUTE),
        })  # fmt: skip
        rows += _compared(case, inside, Profile.ISOSCELES, {
            "tip inside: II with Fn(L)": two_with_length,
            "tip inside: III-B, beta v": three,
            "tip inside: III-B, beta of a moving tip": _with(three, Beta.TIP),
        })  # fmt: skip
    return rows


def _with(model: AveragedLuGre, beta: Beta) -> AveragedLuGre:
    return AveragedLuGre(**{**vars(model), "beta": beta})


def _compared(case: int, motion: Motion, profile: Profile, models: Mapping[str, LuGre]) -> list[Comparison]:
    """Return the RMS deviations of `models` from the distributed model. All models must have the same parameters."""
    exact = distributed(next(iter(models.values())), motion, profile)
    rows = []
    for name, model in models.items():
        error = 1e3 * float(np.sqrt(np.mean((simulate(model, motion).output - exact) ** 2)))
        rows.append(
            Comparison(
                f"ch3/section 3.2/{name}, case {case}",
                None,
                error,
                "mN",
                Agreement.OURS,
                _REFERENCE,
                kind=Evidence.COMPUTED,
            )
        )
    return rows


# Standard deviation of the noise (N), and sampling rate (Hz).
_NOISE_N = 0.004
_RATE_HZ = 200.0


def velocity_lag(note: Callable[[str], None]) -> list[Comparison]:
    """Identify Model II (case 1) from signals with 4 mN of noise and four combinations of delays.

    Returns the biases of the identified parameters.
    """
    note("friction: bias due to the delay of the velocity")
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
    bias = {
        estimate: 100 * (found.estimates[estimate].value / getattr(truth, estimate) - 1) for estimate in found.estimates
    }
    others = ", ".join(f"{each} {bias[each]:+.0f} %" for each in ("sigma1", "mu_s", "mu_c", "alpha", "sigma2"))
    return Comparison(
        f"ch3/velocity lag/bias of sigma0, {name}", None, bias["sigma0"], "%", Agreement.OURS,
        f"{others}; RMSE {1e3 * found.rmse:.1f} mN with 4 mN of noise; the observer [40, 400] delays by 0.1 s, the "
        "average of five samples by 10 ms",
        kind=Evidence.OWN_DATA,
    )  # fmt: skip


def _after_first(record: Record) -> Array:
    return np.asarray(steady(record), float).astype(bool)


_TISSUES = {
    "gelatin, 5 %": (40.0, LumpedOnTissue(
        sigma0=1.2, sigma1=0.1, sigma2=0.02, mu_c=0.06, mu_s=0.05, alpha=0.1, stiffness=0.07, damping=0.01,
    )),
    "beef liver": (25.0, LumpedOnTissue(
        sigma0=5.0, sigma1=0.02, sigma2=0.015, mu_c=0.01, mu_s=0.008, alpha=0.1, stiffness=0.03, damping=0.005,
    )),
}  # fmt: skip
"""By tissue: amplitude (mm) of the motion at 0.1 Hz, and model. The parameters are assumed; none were published."""


@dataclass(frozen=True)
class _Loop:
    """Velocities (mm/s) and force (N) after the first cycle, for one tissue; all are filtered by the fast observer.

    `needle` is the velocity of the needle, `observed` that of the slow observer, `relative` the true velocity of the
    needle relative to the tissue.
    """

    name: str
    needle: Array
    observed: Array
    relative: Array
    force: Array


def deforming_tissue(folder: Path | None, note: Callable[[str], None]) -> list[Comparison]:
    """Compare the widths of the force loops against the velocity of the needle and the velocity relative to the tissue.

    Draws Fig. 3.7 if a folder is given.
    """
    note("friction: moving tissue")
    loops = [_loop(name, amplitude, model) for name, (amplitude, model) in _TISSUES.items()]
    rows = []
    for loop in loops:
        wide, tuned, true = (opening(loop.force, v) for v in (loop.needle, loop.observed, loop.relative))
        narrower = tuned < wide / 2
        rows.append(Comparison(
            f"ch3/Fig. 3.7/{loop.name}: hysteresis mostly gone against the relative velocity", "yes",
            "yes" if narrower else "no", "", Agreement.REPRODUCED if narrower else Agreement.NOT_REPRODUCED,
            f"width at zero force over the top speed: {wide:.2f} over the velocity of the needle, {tuned:.2f} over "
            f"that of the tuned slow observer, {true:.2f} over the true relative velocity; assumed Kelvin-Voigt tissue "
            "under Model II, no relaxation",
            kind=Evidence.OWN_DATA,
        ))  # fmt: skip
    if folder:
        _draw(loops, folder / "fig_3_7_tissue.png")
    return rows


def opening(force: Array, velocity: Array) -> float:
    """Return the width of a hysteresis loop: velocity between its two branches at zero force, over the top speed."""
    before = np.flatnonzero(np.sign(force[:-1]) != np.sign(force[1:]))
    share = force[before] / (force[before] - force[before + 1])
    crossing = velocity[before] + share * (velocity[before + 1] - velocity[before])
    rising = force[before] < 0
    return float(abs(np.median(crossing[rising]) - np.median(crossing[~rising])) / np.abs(velocity).max())


def _loop(name: str, amplitude: float, model: LumpedOnTissue) -> _Loop:
    motion = sinusoid(offset_mm=130, amplitude_mm=amplitude, frequency_hz=0.1, cycles=4, rate_hz=_RATE_HZ)
    run = simulate(model, motion)
    force = run.output + _NOISE_N * np.random.default_rng(0).standard_normal(len(motion))
    fast = HighGainObserver.critically_damped(40.0, 1 / _RATE_HZ)
    filtered, needle = fast.normalised.apply(force), fast.observe(motion.depth_mm)
    tuned = tune_slow_observer(motion.time_s, motion.depth_mm, force)
    observed = tuned.projection.transfer.apply(needle) if tuned.projection else needle
    relative = fast.normalised.apply(motion.velocity_mm_s - run.states[2])
    late = motion.time_s > 10
    return _Loop(name, needle[late], observed[late], relative[late], filtered[late])


def _draw(loops: list[_Loop], file: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 6.0), layout="constrained")
    every = figure.subplots(2, 2, squeeze=False)
    for row, loop, letters in zip(every, loops, ("ab", "cd"), strict=True):
        row[0].plot(loop.needle, loop.force, color=BLUE, linewidth=0.7)
        row[0].set_xlabel("velocity of the needle (mm/s)")
        row[1].plot(loop.relative, loop.force, color=SKY, linewidth=2.2, label="true")
        row[1].plot(loop.observed, loop.force, color=ORANGE, linewidth=0.7, label="slow observer, tuned")
        row[1].set_xlabel("velocity relative to the tissue (mm/s)")
        row[1].legend(frameon=False, fontsize=8, loc="upper left")
        for axes, letter in zip(row, letters, strict=True):
            axes.axhline(0, color=GREY, linewidth=0.5)
            axes.set_ylabel("friction (N)")
            title(axes, f"({letter}) {loop.name}")
    caption(
        figure,
        "Fig. 3.7: friction in moving tissue, 0.1 Hz, 40 mm and 25 mm. Synthetic: Kelvin-Voigt tissue under Model II "
        "with assumed parameters; force and velocities filtered by the low pass of the fast observer.",
    )
    save(figure, file)
