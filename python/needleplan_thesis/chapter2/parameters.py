"""Forces of the published parameters (Fig. 2.2, section 2.3), and parameters identified from simulated records.

The identified parameters are compared with Table 2.3. Their open-loop forces are compared with Figs. 2.7 and 2.9.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from needleplan.estimation import JointForce
from needleplan.identification import FilterRun, identify_by_passes, mean_absolute_error
from needleplan.models import simulate
from needleplan.models.force import ForceModel2, insertion_asymptote, regauged, retraction_asymptote, with_gauge
from needleplan.reports.comparison import Agreement, Comparison, Evidence, measured
from needleplan.signals import Array, Record, insertion_cycles
from needleplan_thesis.chapter2.forces import (
    NO_DATA,
    PUBLISHED_FORCES,
    SENSOR,
    PublishedForce,
    corners,
    insertion_record,
)

__all__ = ["IdentifiedForce", "forward", "identified_forces", "robust_starts", "table_2_3_and_open_loops"]

# Motion of section 2.3, and the index of its last insertion sample.
_MOTION = insertion_cycles(80.0, 10.0)
_TURN = int(np.flatnonzero(_MOTION.direction > 0)[-1])


def forward() -> list[Comparison]:
    """Compare the forces of the published parameter sets with Fig. 2.2 and with every statement of section 2.3."""
    return [*_peaks(), *_statements(), *_symmetries()]


def _force(model: ForceModel2) -> Array:
    return simulate(model, _MOTION).output


def _peaks() -> list[Comparison]:
    rows = []
    for each in PUBLISHED_FORCES:
        motion = insertion_cycles(each.depth_mm, each.velocity_mm_s)
        force = simulate(each.model, motion).output
        turn = int(np.flatnonzero(motion.direction > 0)[-1])
        top = _first_peak(force[: turn + 1])
        ends = insertion_asymptote(each.model, motion.depth_mm[[turn]])[0], retraction_asymptote(
            each.model, motion.depth_mm[[turn]]
        )[0]  # fmt: skip
        rows.append(Comparison(
            f"ch2/fig. 2.2/{each.title}, force of the published parameters", None,
            f"peak {force[top]:.3f} N at {motion.depth_mm[top]:.1f} mm; at 80 mm {force[turn]:.3f} N in, "
            f"{force[turn + 1]:.3f} N out (closed form {ends[0]:.3f}, {ends[1]:.3f})", "", Agreement.OURS,
            "no numbers are printed with the figures",
            kind=Evidence.COMPUTED,
        ))  # fmt: skip
    return rows


def _first_peak(force: Array) -> int:
    """Return the index of the first local maximum; of the maximum if the force only rises."""
    falls = np.flatnonzero(np.diff(force) < 0)
    return int(falls[0]) if falls.size else int(np.argmax(force))


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
        _statement("smaller sigma0: a bigger peak", "yes", f"{peaks[0]:.3f} to {peaks[1]:.3f} N", peaks[1] > peaks[0]),
        _statement(
            "smaller sigma0: almost no change in retraction", "almost none",
            f"{1e3 * moved:.1f} mN at most, of {1e3 * pulled:.0f}",
            moved < 0.1 * pulled,
        ),
        _statement("larger sigma1: a bigger peak", "same", f"{peaks[0]:.3f} to {peaks[2]:.3f} N", peaks[2] > peaks[0]),
        _statement(
            "sigma1 shapes the retraction near the entry", "near the entry point",
            f"{1e3 * near:.1f} mN above 20 mm, {1e3 * far:.2f} mN below 50 mm", near > 10 * far,
        ),
    ]  # fmt: skip


def _symmetries() -> list[Comparison]:
    base = PUBLISHED_FORCES[0].model
    done = simulate(base, _MOTION)
    printed = base.output_as_printed(done.states, _MOTION)
    scaled = _force(regauged(base, 7.0))
    return [
        Comparison(
            "ch2/eq. 2.1/force at the start of the retraction", "negative (Fig. 2.7a)",
            f"{done.output[_TURN + 1]:.3f} N with sign(l'), {printed[_TURN + 1]:.3f} N with sign(l)", "N",
            Agreement.REPRODUCED,
            "a misprint of the dot: with sign(l) the tissue would push the needle out",
            kind=Evidence.QUALITATIVE,
        ),
        Comparison(
            "ch2/section 2.3/number of parameters that data can tell", "six (Model I), five (Model II)",
            f"six of seven: scaling all by 7 changes the force by {np.abs(scaled - done.output).max():.0e} N", "",
            Agreement.REPRODUCED, "an exact symmetry of the scale of z; fixing beta (I) or f2 (II) removes it",
            kind=Evidence.COMPUTED,
        ),
    ]  # fmt: skip


def _statement(what: str, published: str, computed: str, holds: bool) -> Comparison:
    verdict = Agreement.REPRODUCED if holds else Agreement.NOT_REPRODUCED
    return Comparison(
        f"ch2/section 2.3/{what}",
        published,
        computed,
        "",
        verdict,
        "published parameters of A/A, 10 mm/s",
        kind=Evidence.QUALITATIVE,
    )


@dataclass(frozen=True)
class IdentifiedForce:
    """A simulated record of one published parameter set, and the result of the joint filter on this record."""

    published: PublishedForce
    record: Record
    run: FilterRun


def identified_forces() -> list[IdentifiedForce]:
    """Identify each published parameter set from a record simulated with it, from values wrong by a factor of 3."""
    made = []
    for number, each in enumerate(PUBLISHED_FORCES):
        record = insertion_record(each, number)
        start = next(corners(each.model, 3.0, 1, seed=number))
        made.append(
            IdentifiedForce(each, record, identify_by_passes(JointForce(start), start, [record], smooth=SENSOR))
        )
    return made


def table_2_3_and_open_loops(identified: list[IdentifiedForce]) -> list[Comparison]:
    """Compare identified parameters with those that generated the record, and open-loop errors with published ones."""
    return [*(row for loop in identified for row in _parameters(loop)), *(_error(loop) for loop in identified)]


def robust_starts(count: int) -> list[Comparison]:
    """Count the starts from which the joint filter ends with an open-loop error below 10 mN.

    There are `count` starts for each parameter set, with values wrong by a factor of six. The records have no bubbles.
    """
    good = 0
    for number, each in enumerate(PUBLISHED_FORCES):
        record = insertion_record(each, 100 + number, bubbles=False)
        for start in corners(each.model, 6.0, count, seed=number):
            run = identify_by_passes(JointForce(start), start, [record])
            good += run.ok and mean_absolute_error(run.model, [record], smooth=SENSOR) < 10e-3
    total = count * len(PUBLISHED_FORCES)
    return [Comparison(
        "ch2/section 2.5.2/joint filter in passes, starts wrong by six that end below 10 mN", None,
        f"{good} of {total}", "", Agreement.OURS, "data from Model II with the sensor's noise; benches/python/"
        "force_filter.py starts from all corners",
        kind=Evidence.OWN_DATA,
    )]  # fmt: skip


def _parameters(loop: IdentifiedForce) -> list[Comparison]:
    place = "table 2.3" if loop.published.source.startswith("Table") else "section 2.5.2"
    true, found = loop.published.model, loop.run.model
    assert isinstance(found, ForceModel2)
    found = with_gauge(found, true.beta)
    reason = (
        "published: the parameters of the record; computed: identified from the record with noise and bubbles, from a "
        "start wrong by three, then scaled to the published beta, because only ratios are identifiable"
    )
    rows = []
    for name in ("sigma0", "sigma1", "sigma2", "f1", "f2"):
        value, computed = getattr(true, name), float(f"{getattr(found, name):.3g}")
        row = measured(f"ch2/{place}/{loop.published.title}/{name}", abs(value), computed * math.copysign(1, value),
                       true.parameters()[name].unit, reason, kind=Evidence.ROUND_TRIP)  # fmt: skip
        rows.append(replace(row, published=value, ours=computed))
    return rows


def _error(loop: IdentifiedForce) -> Comparison:
    figure = loop.published.source.split(", ")[-1].replace("Fig.", "fig.")
    error = mean_absolute_error(loop.run.model, [loop.record], smooth=SENSOR)
    return measured(
        f"ch2/{figure}/{loop.published.title}, mean absolute error of the open loop", loop.published.mae_n,
        round(error, 5), "N",
        f"the assumed amplitude of the bubbles determines it; {NO_DATA}",
        kind=Evidence.OWN_DATA,
    )  # fmt: skip
