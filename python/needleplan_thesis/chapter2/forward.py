"""What the model says without data: the profile of Fig. 2.2, and the statements of section 2.3 about its parameters."""

from __future__ import annotations

import numpy as np

from needleplan.models import simulate
from needleplan.models.force import ForceModel2, insertion_asymptote, regauged, retraction_asymptote
from needleplan.reports.comparison import Agreement, Comparison
from needleplan.signals import Array, insertion_cycles
from needleplan_thesis.chapter2.forces import PUBLISHED_FORCES

__all__ = ["forward"]

_MOTION = insertion_cycles(80.0, 10.0)
_TURN = int(np.flatnonzero(_MOTION.direction > 0)[-1])


def forward() -> list[Comparison]:
    """Return peaks and asymptotes of the published sets, and a verdict for every statement."""
    return [*_levels(), *_statements(), *_structure()]


def _force(model: ForceModel2) -> Array:
    return simulate(model, _MOTION).output


def _levels() -> list[Comparison]:
    rows = []
    for each in PUBLISHED_FORCES:
        motion = insertion_cycles(each.depth_mm, each.velocity_mm_s)
        force = simulate(each.model, motion).output
        turn = int(np.flatnonzero(motion.direction > 0)[-1])
        top = int(np.argmax(force[: turn // 4]))
        ends = insertion_asymptote(each.model, motion.depth_mm[[turn]])[0], retraction_asymptote(
            each.model, motion.depth_mm[[turn]]
        )[0]  # fmt: skip
        rows.append(Comparison(
            f"ch2/fig. 2.2/{each.title}, force of the published parameters", None,
            f"peak {force[top]:.3f} N at {motion.depth_mm[top]:.1f} mm; at 80 mm {force[turn]:.3f} N in, "
            f"{force[turn + 1]:.3f} N out (closed form {ends[0]:.3f}, {ends[1]:.3f})", "", Agreement.OURS,
            "no numbers are printed with the figures",
        ))  # fmt: skip
    return rows


def _statements() -> list[Comparison]:
    base = PUBLISHED_FORCES[0].model
    force, depth = _force(base), _MOTION.depth_mm
    soft, damped = _force(base.with_values(sigma0=base.sigma0 / 2)), _force(base.with_values(sigma1=base.sigma1 * 2))
    peaks = [float(each[: _TURN // 2].max()) for each in (force, soft, damped)]
    back = slice(_TURN + 1, None)
    pulled = float(-force[back].min())
    moved = float(np.abs(soft - force)[back].max())
    near, far = (
        float(np.abs(damped - force)[back][side].max()) for side in (depth[back] < 20, depth[back] > 50)
    )  # fmt: skip
    return [
        _said("smaller sigma0: a bigger peak", "yes", f"{peaks[0]:.3f} to {peaks[1]:.3f} N", peaks[1] > peaks[0]),
        _said(
            "smaller sigma0: almost no change in retraction", "almost none",
            f"{1e3 * moved:.1f} mN at most, of {1e3 * pulled:.0f}",
            moved < 0.1 * pulled,
        ),
        _said("larger sigma1: a bigger peak", "same", f"{peaks[0]:.3f} to {peaks[2]:.3f} N", peaks[2] > peaks[0]),
        _said(
            "sigma1 shapes the retraction near the entry", "near the entry point",
            f"{1e3 * near:.1f} mN above 20 mm, {1e3 * far:.2f} mN below 50 mm", near > 10 * far,
        ),
    ]  # fmt: skip


def _structure() -> list[Comparison]:
    base = PUBLISHED_FORCES[0].model
    done = simulate(base, _MOTION)
    printed = base.output_as_printed(done.states, _MOTION)
    scaled = _force(regauged(base, 7.0))
    return [
        Comparison(
            "ch2/eq. 2.1/force at the start of the retraction", "negative (Fig. 2.7a)",
            f"{done.output[_TURN + 1]:.3f} N with sign(l'), {printed[_TURN + 1]:.3f} N with sign(l)", "N",
            Agreement.REPRODUCED,
            "the print has lost the place of the dot; with sign(l) the needle would be pushed out",
        ),
        Comparison(
            "ch2/section 2.3/number of parameters that data can tell", "six (Model I), five (Model II)",
            f"of the seven six: all scaled by 7 changes the force by {np.abs(scaled - done.output).max():.0e} N", "",
            Agreement.REPRODUCED, "an exact symmetry of z; fixing beta (I) or f2 (II) removes it",
        ),
    ]  # fmt: skip


def _said(what: str, published: str, ours: str, holds: bool) -> Comparison:
    verdict = Agreement.REPRODUCED if holds else Agreement.NOT_REPRODUCED
    return Comparison(f"ch2/section 2.3/{what}", published, ours, "", verdict, "published parameters of A/A, 10 mm/s")
