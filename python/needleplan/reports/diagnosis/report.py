"""`report.html`: a diagnosis for a person, in one file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from needleplan.artifacts import version
from needleplan.diagnosis import Diagnosis, Library
from needleplan.diagnosis.isolability import Isolability, isolability
from needleplan.diagnosis.next_motion import NextMotion
from needleplan.models import ModelFile
from needleplan.reports.diagnosis import html, pictures
from needleplan.reports.diagnosis.report_next import next_part
from needleplan.reports.diagnosis.traces import Trace, correlation, gap_map, traces_of
from needleplan.reports.diagnosis.words import STOPS, advice, answer, title_of
from needleplan.signals import UNITS

__all__ = ["report_of"]

_SMALL = 0.05
_MOST = 12
_SMALLEST_P = 1e-6


def report_of(found: Diagnosis, file: ModelFile, library: Library, next_: NextMotion | None) -> str:
    """Return the page."""
    channel = found.given.channel
    unit = UNITS[channel.columns[0]]
    traces = traces_of(found)
    matrix = isolability(found.calibration, library, found.selection.base.level)
    return html.page(title_of(found), [
        *_answer(found, unit),
        *_effects(found),
        *_gap(found, traces, unit),
        *_where(found, traces),
        *next_part(next_),
        *_described(found, unit),
        *_trials(traces, unit),
        *_candidates(found),
        *_whiteness(found, traces),
        *_smallest(found, unit),
        *_isolability(matrix),
        *_provenance(found, file),
    ])  # fmt: skip


def _answer(found: Diagnosis, unit: str) -> Iterator[str]:
    yield '<section class="answer" aria-label="answer">'
    yield from map(html.paragraph, answer(found, unit))
    yield "</section>"
    todo = list(advice(found))
    if todo:
        yield html.heading("What to do")
        yield html.items(todo)


def _effects(found: Diagnosis) -> Iterator[str]:
    if not found.effects:
        return
    yield html.heading("How much")
    rows = [
        (f"{each.effect.title}: {name}", value.value, value.low, value.high, value.unit or "1")
        for each in found.effects
        for name, value in each.added.estimates.items()
    ]
    yield html.table(
        "Parameters of what was named, with 95 % intervals", ("parameter", "value", "from", "to", "unit"), rows
    )
    for each in found.effects:
        yield html.paragraph(f"{each.effect.title}: {each.effect.equation} (source: {each.effect.source}). "
                             f"{each.share:.0%} of what was gained.")  # fmt: skip
    rows = [(name, each.value, each.low, each.high, each.unit or "1") for name, each in found.estimates().items()]
    yield html.table(
        "The model itself, mean of the training trials", ("parameter", "value", "from", "to", "unit"), rows
    )


def _gap(found: Diagnosis, traces: Sequence[Trace], unit: str) -> Iterator[str]:
    yield html.heading("What the model leaves")
    text = f"Bars of what the model leaves, RMS in {unit}, for training and held-out trials, beside the noise"
    yield html.picture(pictures.gap_figure(found, traces, unit), text,
                       f"Before: the model, calibrated to each trial. After: {_added(found)}.")  # fmt: skip
    rows = [(each.trial, "held out" if each.held_out else "training", _rms(each.measured - each.before),
             _rms(each.measured - each.after) if each.after is not None else None) for each in traces]  # fmt: skip
    yield html.table(f"RMS of what is left, {unit}; the noise is {found.calibration.noise.rms:.3g} {unit}",
                     ("trial", "role", "before", "after"), rows)  # fmt: skip


def _where(found: Diagnosis, traces: Sequence[Trace]) -> Iterator[str]:
    yield html.heading("Where")
    phases, edges, energy = gap_map(traces, after=False)
    row, column = np.unravel_index(np.nanargmax(energy), energy.shape)
    most = (f"before, most at {edges[column]:.3g} to {edges[column + 1]:.3g} mm, {phases[row]}: "
            f"{energy[row, column]:.3g} times the noise")  # fmt: skip
    text = f"Whitened residual over depth, and a map of its mean square by depth and phase of the motion; {most}"
    caption = (
        "Whitened residual of all trials (grey: where 99 of 100 samples of noise lie), and its mean square by depth "
        f"and phase; 1 is noise alone. {most[0].upper()}{most[1:]}."
    )
    yield html.picture(pictures.map_figure(traces), text, caption)
    parts = found.localisation.where(_SMALL)
    if not parts:
        yield html.paragraph("No part of depth, speed, time, phase or trial has more than chance gives to the largest "
                             "part of its axis in one of twenty data sets without a gap.")  # fmt: skip
    else:
        yield html.table(
            "Parts that have more of the gap than chance gives to the largest of an axis, before anything was added",
            ("along", "part", "share of the gap", "p"),
            [(_words(each.axis), each.label, f"{each.share:.0%}", each.p_value) for each in parts[:_MOST]],
        )
    if found.localisation.changes:
        yield html.table(
            "Where a step fits best, with 95 % intervals",
            ("along", "at", "from", "to", "unit"),
            [(str(each.axis), each.place, each.low, each.high, each.unit) for each in found.localisation.changes],
        )


def _described(found: Diagnosis, unit: str) -> Iterator[str]:
    each = found.described
    if each is None:
        return
    yield html.heading("What has no name looks like this")
    if each.places:
        low, high = min(each.values), max(each.values)
        text = (
            f"Course of what is missing along {each.axis}: {low:.3g} to {high:.3g} {unit}, with two standard deviations"
        )
        caption = "Mean over what the data visited, with two standard deviations; beyond it, nothing is said."
        yield html.picture(pictures.course_figure(each, unit), text, caption)
    if each.formula:
        formula = " + ".join(f"{term.size:.3g} * {term.text}" for term in each.formula)
        yield html.paragraph(f"A formula that describes it, and explains nothing: {formula}.")
    if each.sparse and each.sparse.transfer is not None:
        yield html.paragraph(f"In another motion it brings {each.sparse.transfer:.0%} of what it promises there.")
    yield html.paragraph(
        "effect_to_name.py beside this page is an effect of this shape, for a person who knows its cause."
    )


def _trials(traces: Sequence[Trace], unit: str) -> Iterator[str]:
    yield html.heading("Measured and modelled")
    for each in traces:
        role = "held out" if each.held_out else "training"
        yield html.heading(f"{each.trial} ({role})", 3)
        names = ("x", "y", "z") if len(each.measured) == 3 else ("force",)
        after = "" if each.after is None else f", after {_rms(each.measured - each.after):.3g}"
        text = (f"Trial {each.trial}: measured against model over time, with the depth; left before "
                f"{_rms(each.measured - each.before):.3g}{after} {unit} RMS")  # fmt: skip
        yield html.picture(pictures.trial_figure(each, unit, names), text)


def _candidates(found: Diagnosis) -> Iterator[str]:
    yield html.heading("How it was decided")
    step = found.selection.steps[0]
    best, rival = step.screened[0], step.rivals[0]
    text = (
        f"Bars of the balance of every effect in the first round, best {best.effect.name} {best.balance:.3g}, and "
        f"of functions without a name, best {rival.name} {rival.balance:.3g}; threshold {found.gates.balance:g}"
    )
    caption = (
        "First round. An effect must pass the threshold, lead every other, and not be beaten by a smooth function "
        "without a name (hatched, in brackets)."
    )
    yield html.picture(pictures.candidates_figure(found), text, caption)
    rows = []
    for number, each in enumerate(found.selection.steps, start=1):
        first = each.ranked[0] if each.ranked else None
        second = each.ranked[1] if len(each.ranked) > 1 else None
        rows.append((
            str(number), first.name if first else "none", first.balance if first else None,
            f"{second.name} {second.balance:.3g}" if second else "none", _chance(each.p_value),
            f"{each.rivals[0].name} {each.rivals[0].balance:.3g}", STOPS[each.stop],
        ))  # fmt: skip
    columns = ("round", "best effect", "balance", "next best", "p by chance", "best without a name", "how it ended")
    yield html.table("Round by round", columns, rows)


def _chance(p_value: float | None) -> float | str | None:
    """Return a p-value as it can be told: it is extrapolated from simulations, and far out it is only a bound."""
    return f"below {_SMALLEST_P:g}" if p_value is not None and p_value < _SMALLEST_P else p_value


def _whiteness(found: Diagnosis, traces: Sequence[Trace]) -> Iterator[str]:
    yield html.heading("Is the rest noise?")
    values, bound = correlation(traces, 40, after=True)
    outside = int((np.abs(values) > bound).sum())
    text = f"Autocorrelation of the whitened residual at 40 lags; {outside} are outside of the 99 % band"
    yield html.picture(pictures.correlation_figure(traces), text,
                       "All trials. Grey: where 99 of 100 lags of white noise lie.")  # fmt: skip
    if found.verified:
        each = found.verified
        yield html.paragraph(f"Test of Ljung and Box on the held-out trials: p = {each.whiteness_before:.2g} before, "
                             f"{each.whiteness_after:.2g} after.")  # fmt: skip


def _smallest(found: Diagnosis, unit: str) -> Iterator[str]:
    yield html.heading("What would have been seen")
    titles = {each.effect.name: each.effect.title for each in found.selection.steps[0].screened}
    rows = [
        (each.effect, titles.get(each.effect, ""), each.size, each.unit or "1", each.rms, each.noise_multiple, "")
        if each.visible else
        (each.effect, titles.get(each.effect, ""), None, each.unit or "1", None, None,
         "not in these motions, or the model takes it up")
        for each in found.smallest
    ]  # fmt: skip
    columns = ("effect", "what it is", "size", "unit", f"RMS ({unit})", "in noise RMS", "remark")
    yield html.table("The smallest effect that would have been named in these data", columns, rows)


def _isolability(matrix: Isolability) -> Iterator[str]:
    yield html.heading("What these motions can tell apart")
    alike = matrix.alike()
    text = "Matrix of how much of each effect each other one imitates; " + (
        "most alike: " + ", ".join(f"{a} by {b} {share:.2f}" for a, b, share in alike[:5]) if alike
        else "no pair is above 0.8"
    )  # fmt: skip
    caption = "Share of what an effect (row) shows that another (column) can show too; empty: below 0.1."
    yield html.picture(pictures.isolability_figure(matrix), text, caption)
    if alike:
        yield html.table("Pairs that are hard to tell apart in these motions",
                         ("effect", "imitated by", "share"), alike)  # fmt: skip


def _provenance(found: Diagnosis, file: ModelFile) -> Iterator[str]:
    yield html.heading("Where this comes from")
    roles = {"training": found.checked.training, "held out": found.checked.held_out, "noise": found.checked.noise}
    rows = [(each.trial, role, len(each), each.digest or "not from a file") for role, records in roles.items()
            for each in records]  # fmt: skip
    yield html.table("Data", ("trial", "role", "samples", "digest"), rows)
    gates = [(name, float(value)) for name, value in vars(found.gates).items()]
    facts: list[tuple[str, str | float]] = [
        ("kind of the model", found.given.name), ("digest of the model file", file.digest),
        ("digest of this diagnosis", found.digest),
        ("made by", f"needleplan {version()}"), ("order of the noise", float(found.calibration.noise.order)),
    ]  # fmt: skip
    yield html.table("Model and program", ("fact", "value"), facts)
    yield html.table("Thresholds", ("gate", "value"), gates)


def _added(found: Diagnosis) -> str:
    """Return what `after` stands for in figures and tables."""
    if found.effects:
        return "with what was named"
    if not found.lacks_data or found.joint is None:
        return "nothing was added"
    return f"with what fits best, {', '.join(each.effect.name for each in found.joint.added)}, which is no name yet"


def _words(column: str) -> str:
    return column.removesuffix("_mm_s").removesuffix("_mm").removesuffix("_s")


def _rms(values: np.typing.NDArray[np.float64]) -> float:
    return float(np.sqrt(np.nanmean(values**2)))
