"""Fig. 3.7: tissue that gives way, and what the relative velocity makes of its loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from needleplan.models import simulate
from needleplan.models.tissue import LumpedOnTissue, tune_slow_observer
from needleplan.plotting import caption, save
from needleplan.plotting.canvas import BLUE, GREY, ORANGE, SKY, title
from needleplan.reports.comparison import Agreement, Comparison
from needleplan.signals import Array, HighGainObserver, sinusoid

__all__ = ["deforming_tissue", "opening"]

_NOISE_N = 0.004
_RATE_HZ = 200.0

_TISSUES = {
    "gelatin, 5 %": (40.0, LumpedOnTissue(
        sigma0=1.2, sigma1=0.1, sigma2=0.02, mu_c=0.06, mu_s=0.05, alpha=0.1, stiffness=0.07, damping=0.01,
    )),
    "beef liver": (25.0, LumpedOnTissue(
        sigma0=5.0, sigma1=0.02, sigma2=0.015, mu_c=0.01, mu_s=0.008, alpha=0.1, stiffness=0.03, damping=0.005,
    )),
}  # fmt: skip
"""Amplitude (mm) and model at 0.1 Hz; no parameters were published for these tissues, and these are ours."""


@dataclass(frozen=True)
class _Loop:
    """Velocities (mm/s) and force (N) after the first cycle."""

    name: str
    needle: Array
    observed: Array
    relative: Array
    force: Array


def deforming_tissue(folder: Path | None, note: Callable[[str], None]) -> list[Comparison]:
    """Compare how wide the loops are against both velocities; draw Fig. 3.7."""
    note("friction: tissue that gives way")
    loops = [_loop(name, amplitude, model) for name, (amplitude, model) in _TISSUES.items()]
    rows = []
    for each in loops:
        wide, tuned, true = (opening(each.force, v) for v in (each.needle, each.observed, each.relative))
        narrower = tuned < wide / 2
        rows.append(Comparison(
            f"ch3/Fig. 3.7/{each.name}: hysteresis mostly gone against the relative velocity", "yes",
            "yes" if narrower else "no", "", Agreement.REPRODUCED if narrower else Agreement.NOT_REPRODUCED,
            f"opening at zero force, share of the top speed: {wide:.2f} against the needle, {tuned:.2f} against the "
            f"tuned slow observer, {true:.2f} against the true relative velocity; Kelvin-Voigt tissue of ours under "
            "Model II, no relaxation",
        ))  # fmt: skip
    if folder:
        _draw(loops, folder / "fig_3_7_tissue.png")
    return rows


def opening(force: Array, velocity: Array) -> float:
    """Return the distance of the two branches of a loop at zero force, as a share of the top speed."""
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
        "Fig. 3.7: friction in tissue that gives way, 0.1 Hz, 40 mm and 25 mm. Synthetic: Kelvin-Voigt tissue under "
        "Model II with parameters of ours; force and velocities all through the fast observer's low pass.",
    )
    save(figure, file)
