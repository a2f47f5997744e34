"""Everything of chapter 3, in the order of the chapter."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from needleplan.identification.shaft_models import EXPONENTS
from needleplan.reports.chapters import Effort
from needleplan_thesis.chapter3.claims import averaging, peaks
from needleplan_thesis.chapter3.errors import errors, orders, printed_output, statements
from needleplan_thesis.chapter3.figures import draw_loops, draw_profiles
from needleplan_thesis.chapter3.fits import fit_cases
from needleplan_thesis.chapter3.generator import Generator
from needleplan_thesis.chapter3.lag import velocity_lag
from needleplan_thesis.chapter3.prediction import prediction
from needleplan_thesis.chapter3.tables import parameters, recovered
from needleplan_thesis.chapter3.tissue import deforming_tissue

if TYPE_CHECKING:
    from needleplan.reports.chapters import Request
    from needleplan.reports.comparison import Comparison

__all__ = ["files", "run"]

_RATE_HZ = {Effort.QUICK: 12.5, Effort.DEFAULT: 50.0, Effort.FULL: 200.0}
"""Samples a second of the records that models are fitted to; noise of the same size is more of it at fewer."""


def files(_: Request) -> tuple[str, ...]:
    """Return the names of the files that `run` writes into its folder."""
    return ("fig_3_3_profiles.png", "fig_3_5_loops.png", "fig_3_6_prediction.png", "fig_3_7_tissue.png")


def run(request: Request) -> list[Comparison]:
    """Reproduce the chapter; figures where there is a folder."""
    quick, rate = request.effort is Effort.QUICK, _RATE_HZ[request.effort]
    exponents = (0.5, 5.0) if quick else EXPONENTS
    generators = (Generator.III_B,) if quick else tuple(Generator)
    every = [fit_cases(each, rate, exponents, request.note) for each in generators]
    from_three = every[0]
    compared = [
        *parameters(from_three),
        *(row for fits in every for row in recovered(fits)),
        *errors(from_three),
        *orders(every),
    ]
    if quick:
        compared = [
            replace(each, reason=f"quick: 12.5 samples a second; {each.reason}".rstrip("; ")) for each in compared
        ]
    if request.folder:
        draw_profiles(request.folder / "fig_3_3_profiles.png")
        draw_loops(from_three, request.folder / "fig_3_5_loops.png")
    return [
        *peaks(),
        *([] if quick else averaging(request.note, rate_hz=100.0)),
        *compared,
        *statements(),
        *printed_output(from_three[:1] if quick else from_three),
        *prediction(request.folder, request.note, 50.0 if quick else 200.0),
        *([] if quick else velocity_lag(request.note)),
        *deforming_tissue(request.folder, request.note),
    ]
