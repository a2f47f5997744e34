"""The size of the problem and the noise of the tip: sections 6.2 and 6.4, which need no obstacle."""

from __future__ import annotations

import math

from needleplan.reports.comparison import Agreement, Comparison, measured
from needleplan.scenario import Scenario
from needleplan_thesis.chapter6.published import FORMULA_STATES, STATES, VALUE_ITERATION

__all__ = ["formula_states", "problem"]

_SECTION = "ch6/problem"


def formula_states(scenario: Scenario) -> float:
    """Return n = 4 pi rho xmax ymax / (spacing^2 delta), section 6.2: without the points of two edges."""
    dx, dy = scenario.grid.spacing_mm
    area = scenario.workspace.width_mm * scenario.workspace.height_mm
    return 4 * math.pi * scenario.needle.curvature_radius_mm * area / (dx * dy * scenario.step_mm)


def problem(thesis: Scenario) -> list[Comparison]:
    """Compare the size and the noise of `thesis`, a scenario with the workspace and the grid of section 6.4."""
    noise = thesis.motion.tip_noise
    steps = range(1 - len(noise), len(noise))
    mean = sum(m * noise[abs(m)] for m in steps)
    deviation = math.sqrt(sum(m * m * noise[abs(m)] for m in steps) - mean**2)
    formula = round(formula_states(thesis))
    return [
        _exact(
            "n, all grid points",
            STATES,
            thesis.states,
            "states",
            "(120 + 1)(80 + 1) grid points, 60 headings, 2 bevels",
        ),
        _exact(
            "n by the formula of 6.2",
            FORMULA_STATES,
            formula,
            "states",
            "without the points of two edges, as Table 6.3",
        ),
        _exact(
            "updates of 196 sweeps",
            VALUE_ITERATION.updates,
            VALUE_ITERATION.sweeps * thesis.states,
            "backups",
            "so the thesis' sweeps go over all grid points, its Table 6.3 does not",
        ),
        _exact("mean of the noise", 0, round(mean, 9), "heading steps", ""),
        measured(
            f"{_SECTION}/deviation of the noise",
            0.85,
            round(deviation, 4),
            "heading steps",
            "the printed probabilities have sqrt(2 * 0.24 + 8 * 0.027) = 0.834; 0.85 is that of the Gaussian behind "
            "them: its density at 0, 1, 2, scaled to one, is 0.470, 0.235, 0.030",
        ),
    ]


def _exact(what: str, published: float, ours: float, unit: str, reason: str) -> Comparison:
    verdict = Agreement.REPRODUCED if ours == published else Agreement.NOT_REPRODUCED
    return Comparison(f"{_SECTION}/{what}", published, ours, unit, verdict, reason)
