"""Table 2.3 and the open loops of Figs. 2.7 and 2.9: parameters identified from our records, and what they predict."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from needleplan.estimation import FilterRun, JointForce, identify_by_passes, mean_absolute_error
from needleplan.models.force import ForceModel2, with_gauge
from needleplan.reports.comparison import Agreement, Comparison, measured
from needleplan.signals import Record
from needleplan_thesis.chapter2.forces import PUBLISHED_FORCES, PublishedForce
from needleplan_thesis.chapter2.generator import SENSOR, insertion_record
from needleplan_thesis.chapter2.published import NO_DATA
from needleplan_thesis.chapter2.starts import corners

__all__ = ["Loop", "loops", "robust_starts", "table_2_3_and_loops"]


@dataclass(frozen=True)
class Loop:
    """A record of one combination, and the joint filter's passes over it."""

    published: PublishedForce
    record: Record
    run: FilterRun


def loops() -> list[Loop]:
    """Identify every published combination from a record of its own, started wrong by a factor of three."""
    made = []
    for number, each in enumerate(PUBLISHED_FORCES):
        record = insertion_record(each, number)
        start = next(corners(each.model, 3.0, 1, seed=number))
        made.append(Loop(each, record, identify_by_passes(JointForce(start), start, [record], smooth=SENSOR)))
    return made


def table_2_3_and_loops(made: list[Loop]) -> list[Comparison]:
    """Return the identified parameters beside those that made the record, and the errors in the open loop."""
    return [*(row for loop in made for row in _parameters(loop)), *(_error(loop) for loop in made)]


def robust_starts(count: int) -> list[Comparison]:
    """Return how many of `count` starts for each combination, wrong by six, end below 10 mN without bubbles."""
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
        "force_filter.py takes all corners",
    )]  # fmt: skip


def _parameters(loop: Loop) -> list[Comparison]:
    place = "table 2.3" if loop.published.source.startswith("Table") else "section 2.5.2"
    made, found = loop.published.model, loop.run.model
    assert isinstance(found, ForceModel2)
    found = with_gauge(found, made.beta)
    reason = (
        "published: what made the record; ours: identified from it in spite of noise and bubbles, from a start wrong "
        "by three, then brought to the published beta, as only ratios are well told"
    )
    rows = []
    for name in ("sigma0", "sigma1", "sigma2", "f1", "f2"):
        value, ours = getattr(made, name), float(f"{getattr(found, name):.3g}")
        row = measured(f"ch2/{place}/{loop.published.title}/{name}", abs(value), ours * math.copysign(1, value),
                       made.parameters()[name].unit, reason)  # fmt: skip
        rows.append(replace(row, published=value, ours=ours))
    return rows


def _error(loop: Loop) -> Comparison:
    figure = loop.published.source.split(", ")[-1].replace("Fig.", "fig.")
    ours = mean_absolute_error(loop.run.model, [loop.record], smooth=SENSOR)
    return measured(
        f"ch2/{figure}/{loop.published.title}, mean absolute error of the open loop", loop.published.mae_n,
        round(ours, 5), "N",
        f"the size of the bubbles decides it, and that is ours; {NO_DATA}",
    )  # fmt: skip
