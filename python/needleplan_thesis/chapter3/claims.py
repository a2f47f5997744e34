"""Section 3.2: what the lumped and averaged models are worth beside the distributed one that they stand for."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from needleplan.models import AveragedLuGre, Beta, LumpedLuGre, Profile, distributed, simulate
from needleplan.models.friction import LuGre
from needleplan.reports.comparison import Agreement, Comparison
from needleplan.signals import Motion, Start, sinusoid
from needleplan_thesis.chapter3.published import CASES, model_ii, model_iii_b, passing_through

__all__ = ["averaging", "peaks"]

_SAYS = "rms against the distributed model with the same parameters, solved along its characteristics"


def peaks() -> list[Comparison]:
    """Return the largest forces of Models II and III-B, case 1, which nobody printed."""
    rows = []
    for label, model in (("II", model_ii(1)), ("III-B", model_iii_b(1))):
        motion = passing_through(1, cycles=2)
        force = simulate(model, motion).output[motion.time_s > 1 / CASES[1].frequency_hz]
        for name, value in (("in", force.max()), ("out", force.min())):
            rows.append(Comparison(
                f"ch3/section 3.2/largest force of Model {label} on the way {name}, case 1", None, float(value), "N",
                Agreement.OURS, "beta v lowers it on the way in, and raises it on the way out" if label != "II" else "",
            ))  # fmt: skip
    return rows


def averaging(note: Callable[[str], None], rate_hz: float) -> list[Comparison]:
    """Compare lumped and averaged models with the distributed one: constant patch, and tip inside."""
    note("friction: lumped models beside the distributed one")
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
        # One run of the distributed model for all that stand for the same parameters.
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
    """Compare models of the same surface with the distributed one."""
    exact = distributed(next(iter(models.values())), motion, profile)
    rows = []
    for name, model in models.items():
        error = 1e3 * float(np.sqrt(np.mean((simulate(model, motion).output - exact) ** 2)))
        rows.append(Comparison(f"ch3/section 3.2/{name}, case {case}", None, error, "mN", Agreement.OURS, _SAYS))
    return rows
