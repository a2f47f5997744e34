"""Entry point of `needleplan reproduce ch3`: all comparisons in the order of the chapter, and Figs. 3.3 and 3.5."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from needleplan.identification.friction_candidates import EXPONENTS
from needleplan.models import Model, Profile, simulate
from needleplan.models.friction import intensity, steady
from needleplan.plotting import caption, save
from needleplan.plotting.canvas import BLACK, BLUE, GREEN, GREY, ORANGE, SKY, VERMILLION, title
from needleplan.reports.chapters import Effort
from needleplan.signals import Record
from needleplan_thesis.chapter3.fits import CaseFits, Generator, fit_cases
from needleplan_thesis.chapter3.prediction import prediction
from needleplan_thesis.chapter3.simplifications import averaging, deforming_tissue, peaks, velocity_lag
from needleplan_thesis.chapter3.tables import errors, orders, parameters, printed_output, recovered, statements
from needleplan_thesis.citations import cited

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from needleplan.reports.chapters import Request
    from needleplan.reports.comparison import Comparison

__all__ = ["draw_loops", "draw_profiles", "files", "run"]

_RATE_HZ = {Effort.QUICK: 12.5, Effort.DEFAULT: 50.0, Effort.FULL: 200.0}
"""Sampling rate of the fitted records (Hz). The noise is the same at each rate, so lower rates are less accurate."""


def files(_: Request) -> tuple[str, ...]:
    """Return the names of the files that `run` writes into the output folder."""
    return ("fig_3_3_profiles.png", "fig_3_5_loops.png", "fig_3_6_prediction.png", "fig_3_7_tissue.png")


def run(request: Request) -> list[Comparison]:
    """Return the comparisons of the chapter; draw the figures if the request names a folder."""
    quick, rate = request.effort is Effort.QUICK, _RATE_HZ[request.effort]
    exponents = (0.5, 5.0) if quick else EXPONENTS
    generators = (Generator.III_B,) if quick else tuple(Generator)
    by_generator = [fit_cases(generator, rate, exponents, request.note) for generator in generators]
    from_three = by_generator[0]
    compared = [
        *parameters(from_three),
        *(row for fits in by_generator for row in recovered(fits)),
        *errors(from_three),
        *orders(by_generator),
    ]
    if quick:
        compared = [
            replace(each, reason=f"quick: 12.5 samples a second; {each.reason}".rstrip("; ")) for each in compared
        ]
    if request.folder:
        draw_profiles(request.folder / "fig_3_3_profiles.png")
        draw_loops(from_three, request.folder / "fig_3_5_loops.png")
    return cited([
        *peaks(),
        *([] if quick else averaging(request.note, rate_hz=100.0)),
        *compared,
        *statements(),
        *printed_output(from_three[:1] if quick else from_three),
        *prediction(request.folder, request.note, 50.0 if quick else 200.0),
        *([] if quick else velocity_lag(request.note)),
        *deforming_tissue(request.folder, request.note),
    ])  # fmt: skip


_COLOURS = (VERMILLION, ORANGE, GREEN, BLUE, BLACK)
# Length w (mm) of the ramps of the normal force.
_RAMP_MM = 2.5


def draw_profiles(file: Path) -> None:
    """Draw Fig. 3.3: normal force per length against the distance from the entry, for five inserted lengths.

    One panel shows the right trapezoid (Model III-A), the other the isosceles trapezoid (Model III-B).
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.6, 2.9), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    states = {
        Profile.RIGHT: (0.8, 1.4, 2.0, _RAMP_MM, 9.0),
        Profile.ISOSCELES: (1.5, 2.8, 4.0, 2 * _RAMP_MM, 11.0),
    }
    for each, (profile, lengths) in zip(axes, states.items(), strict=True):
        for number, (length, colour) in enumerate(zip(lengths, _COLOURS, strict=True), start=1):
            # The far end is left out, because the right trapezoid jumps to zero there.
            position = np.linspace(0, length, 400)
            shape = intensity(profile, position, length, _RAMP_MM)
            label = f"{number}: L = {length:g} mm"
            each.plot([*position, length], [*shape, 0], color=colour, linewidth=1.3, label=label)
        each.set_xlabel("distance from the entry (mm)")
        each.legend(frameon=False, fontsize=8, loc="upper right")
        each.set_ylim(0, 1.1)
        each.set_xlim(-0.4, 1.6 * max(lengths))
    axes[0].set_ylabel("fn/f")
    title(axes[0], "(a) right trapezoid, Model III-A")
    title(axes[1], "(b) isosceles trapezoid, Model III-B")
    caption(figure, "Fig. 3.3: normal force per length by inserted length, w = 2.5 mm; state 4 is the last triangle.")
    save(figure, file)


def draw_loops(fits: Sequence[CaseFits], file: Path) -> None:
    """Draw Fig. 3.5, friction over velocity: Model III-B for each lambda (case 1), and all models (cases 2 and 4)."""
    from matplotlib.figure import Figure

    by_case = {fit.case: fit for fit in fits}
    figure = Figure(figsize=(10.5, 4.0), layout="constrained")
    panels = figure.subplots(1, 3)
    lambdas = {
        f"lambda {value:g}: {1e3 * found.rmse:.1f} mN": found.model for value, found in by_case[1].exponents.items()
    }
    _loop(panels[0], by_case[1].record, lambdas)
    title(panels[0], "(a) III-B, case 1")
    for axes, case, letter in ((panels[1], 2, "b"), (panels[2], 4, "c")):
        chosen = by_case[case]
        named = {f"{label}: {1e3 * found.rmse:.1f} mN": found.model for label, found in chosen.fits.items()}
        _loop(axes, chosen.record, named)
        title(axes, f"({letter}) case {case}")
    panels[0].set_ylabel("friction (N)")
    caption(
        figure,
        "Fig. 3.5: identified friction over velocity after the first cycle. Light blue: synthetic data from "
        f"{fits[0].generator} with 15 mN of noise. Insets: around zero velocity.",
    )
    save(figure, file)


def _loop(axes: Axes, record: Record, models: Mapping[str, Model]) -> None:
    counts, motion = steady(record), record.motion()
    last = counts & (motion.time_s > motion.time_s[counts].mean())
    near = np.abs(motion.velocity_mm_s) < 0.12 * np.abs(motion.velocity_mm_s).max()
    inset = axes.inset_axes((0.6, 0.07, 0.37, 0.37))
    for each, shown, size in ((axes, counts, 0.8), (inset, counts & near, 1.2)):
        each.plot(motion.velocity_mm_s[shown], record["force_n"][shown], ".", color=SKY, markersize=size, alpha=0.5)
    for (label, model), colour in zip(models.items(), _COLOURS, strict=False):
        force = simulate(model, motion).output
        axes.plot(motion.velocity_mm_s[last], force[last], color=colour, linewidth=0.9, label=label)
        masked = np.where(last & near, force, np.nan)
        inset.plot(motion.velocity_mm_s, masked, color=colour, linewidth=0.9)
    axes.axhline(0, color=GREY, linewidth=0.5)
    inset.tick_params(labelsize=6)
    axes.set_xlabel("velocity (mm/s)")
    axes.legend(frameon=False, fontsize=7.5, loc="upper left")
