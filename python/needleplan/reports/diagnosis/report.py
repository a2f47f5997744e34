"""`report.html`: a diagnosis on one page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from needleplan.artifacts import version
from needleplan.diagnosis import Diagnosis, Isolability, Library, isolability
from needleplan.diagnosis.next_motion import NOTHING, Exploring, NextMotion, Revealing, Separating
from needleplan.models import ModelFile
from needleplan.reports.diagnosis import html, pictures
from needleplan.reports.diagnosis.traces import TrialTrace, correlation, gap_map
from needleplan.reports.diagnosis.words import STOPS, advice, answer, title_of
from needleplan.signals import UNITS

__all__ = ["report_of"]

# Largest p-value with which a part of the recordings (a depth range, a phase, a trial ...) is listed.
_SMALL = 0.05
# Largest number of listed parts.
_MOST = 12
# p-value below which only "below 1e-06" is shown, because simulated data do not resolve smaller values.
_SMALLEST_P = 1e-6


def report_of(
    found: Diagnosis, file: ModelFile, library: Library, next_: NextMotion | None, traces: Sequence[TrialTrace]
) -> str:
    """Return the HTML text of `report.html`. Without a next motion (`next_` is None) the report lacks this section."""
    channel = found.given.channel
    unit = UNITS[channel.columns[0]]
    matrix = isolability(found.calibration, library, found.selection.base.heterogeneity_sd)
    return html.page(title_of(found), [
        *_answer(found, unit),
        *_effects(found),
        *_gap(found, traces, unit),
        *_where(found, traces),
        *_next_motion(next_),
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
    yield html.heading("Amplitudes")
    rows = [
        (f"{each.effect.title}: {name}", value.value, value.low, value.high, value.unit or "1")
        for each in found.effects
        for name, value in each.estimates.items()
    ]
    yield html.table(
        "Parameters of the named effects, with 95 % intervals", ("parameter", "value", "from", "to", "unit"), rows
    )
    for each in found.effects:
        yield html.paragraph(f"{each.effect.title}: {each.effect.equation} (source: {each.effect.source}). "
                             f"Share of the total gain: {each.share:.0%}.")  # fmt: skip
    rows = [(name, each.value, each.low, each.high, each.unit or "1") for name, each in found.estimates().items()]
    yield html.table(
        "Parameters of the base model, mean of the training trials", ("parameter", "value", "from", "to", "unit"), rows
    )


def _gap(found: Diagnosis, traces: Sequence[TrialTrace], unit: str) -> Iterator[str]:
    yield html.heading("Residual")
    text = f"Bars of the residual RMS in {unit} for training and held-out trials, with the noise"
    yield html.picture(pictures.gap_figure(found.calibration.noise.rms, traces, unit), text,
                       f"Before: the model, calibrated to each trial. After: {_added(found)}.")  # fmt: skip
    rows = [(each.trial, "held out" if each.held_out else "training", _rms(each.measured - each.before),
             _rms(each.measured - each.after) if each.after is not None else None) for each in traces]  # fmt: skip
    yield html.table(f"Residual RMS, {unit}; the noise is {found.calibration.noise.rms:.3g} {unit}",
                     ("trial", "role", "before", "after"), rows)  # fmt: skip


def _where(found: Diagnosis, traces: Sequence[TrialTrace]) -> Iterator[str]:
    yield html.heading("Where")
    phases, edges, energy = gap_map(traces, after=False)
    row, column = np.unravel_index(np.nanargmax(energy), energy.shape)
    most = (f"before, the largest mean square is {energy[row, column]:.3g} times that of noise, at "
            f"{edges[column]:.3g} to {edges[column + 1]:.3g} mm in the phase '{phases[row]}'")  # fmt: skip
    text = f"Whitened residual over depth, and a map of its mean square by depth and phase of the motion; {most}"
    caption = (
        "Whitened residual of all trials (grey: 99 % range of noise), and its mean square by depth "
        f"and phase; 1 is noise alone. {most[0].upper()}{most[1:]}."
    )
    yield html.picture(pictures.map_figure(traces), text, caption)
    parts = found.localisation.where(_SMALL)
    if not parts:
        yield html.paragraph("No part of the depth, speed or time range, no phase and no trial has a significant "
                             "share of the gap (p > 0.05).")  # fmt: skip
    else:
        yield html.table(
            "Parts with a significant share of the gap of the base model",
            ("along", "part", "share of the gap", "p"),
            [(_words(each.axis), each.label, f"{each.share:.0%}", each.p_value) for each in parts[:_MOST]],
        )
    if found.localisation.changes:
        yield html.table(
            "Change points with 95 % intervals",
            ("along", "at", "from", "to", "unit"),
            [(str(each.axis), each.place, each.low, each.high, each.unit) for each in found.localisation.changes],
        )


def _described(found: Diagnosis, unit: str) -> Iterator[str]:
    each = found.described
    if each is None:
        return
    yield html.heading("Shape of the unexplained gap")
    if each.places:
        low, high = min(each.values), max(each.values)
        text = f"Missing output along {each.axis.label}: {low:.3g} to {high:.3g} {unit}, with two standard deviations"
        caption = "Mean within the visited range, with two standard deviations."
        yield html.picture(pictures.course_figure(each.curves, unit), text, caption)
    if each.formula:
        formula = " + ".join(f"{term.factor:.3g} * {term.text}" for term in each.formula)
        yield html.paragraph(f"A formula that describes the gap without explaining it: {formula}.")
    if each.sparse and each.sparse.transfer is not None:
        yield html.paragraph(f"On the held-out trials it achieves {each.sparse.transfer:.0%} of the predicted gain.")
    yield html.paragraph(
        "The file effect_to_name.py, in the folder of this page, defines an effect with this shape; complete it if you "
        "know the cause."
    )


def _trials(traces: Sequence[TrialTrace], unit: str) -> Iterator[str]:
    yield html.heading("Measured and modelled")
    for each in traces:
        role = "held out" if each.held_out else "training"
        yield html.heading(f"{each.trial} ({role})", 3)
        names = ("x", "y", "z") if len(each.measured) == 3 else ("force",)
        after = "" if each.after is None else f", after {_rms(each.measured - each.after):.3g}"
        text = (f"Trial {each.trial}: measured and modelled output over time, with the depth; residual before "
                f"{_rms(each.measured - each.before):.3g}{after} {unit} RMS")  # fmt: skip
        yield html.picture(pictures.trial_figure(each, unit, names), text)


def _candidates(found: Diagnosis) -> Iterator[str]:
    yield html.heading("Selection of effects")
    step = found.selection.rounds[0]
    best, alternative = step.screened[0], step.alternatives[0]
    text = (
        f"Bars of the BIC gain of every effect in the first round, best {best.effect.name} {best.bic_gain:.3g}, and "
        f"of nonparametric alternatives, best {alternative.name} {alternative.bic_gain:.3g}; "
        f"threshold {found.gates.bic_gain:g}"
    )
    caption = (
        "First round. An effect must pass the threshold, lead every other effect, and not be beaten by a nonparametric "
        "alternative (hatched, in brackets)."
    )
    yield html.picture(pictures.candidates_figure(found), text, caption)
    rows = []
    for number, each in enumerate(found.selection.rounds, start=1):
        first = each.ranked[0].newest if each.ranked else None
        second = each.ranked[1].newest if len(each.ranked) > 1 else None
        rows.append((
            str(number), first.name if first else "none", first.bic_gain if first else None,
            f"{second.name} {second.bic_gain:.3g}" if second else "none", _chance(each.p_value),
            f"{each.alternatives[0].name} {each.alternatives[0].bic_gain:.3g}", STOPS[each.outcome],
        ))  # fmt: skip
    columns = ("round", "best effect", "BIC gain", "next best", "p-value", "best alternative", "outcome")
    yield html.table("Rounds", columns, rows)


def _chance(p_value: float | None) -> float | str | None:
    """Return `p_value`, or a text such as "below 1e-06" if it is smaller than `_SMALLEST_P`."""
    return f"below {_SMALLEST_P:g}" if p_value is not None and p_value < _SMALLEST_P else p_value


def _whiteness(found: Diagnosis, traces: Sequence[TrialTrace]) -> Iterator[str]:
    yield html.heading("Whiteness of the residual")
    values, bound = correlation(traces, 40, after=True)
    outside = int((np.abs(values) > bound).sum())
    text = f"Autocorrelation of the whitened residual at 40 lags; {outside} are outside of the 99 % band"
    yield html.picture(pictures.correlation_figure(traces), text,
                       "All trials. Grey: 99 % band of white noise.")  # fmt: skip
    if found.validation:
        each = found.validation
        yield html.paragraph(f"Ljung-Box test on the held-out trials: p = {each.whiteness_before:.2g} before, "
                             f"{each.whiteness_after:.2g} after.")  # fmt: skip


def _smallest(found: Diagnosis, unit: str) -> Iterator[str]:
    yield html.heading("Detection limits")
    titles = {each.effect.name: each.effect.title for each in found.selection.rounds[0].screened}
    rows = [
        (each.effect, titles.get(each.effect, ""), each.amplitude, each.unit or "1", each.rms, each.noise_multiple, "")
        if each.visible else
        (each.effect, titles.get(each.effect, ""), None, each.unit or "1", None, None,
         "invisible in these motions, or absorbed by the model")
        for each in found.detection_limits
    ]  # fmt: skip
    columns = ("effect", "meaning", "amplitude", "unit", f"RMS ({unit})", "in noise RMS", "remark")
    yield html.table("Smallest amplitude of each effect that would have been named", columns, rows)


def _isolability(matrix: Isolability) -> Iterator[str]:
    yield html.heading("Which effects these motions separate")
    alike = matrix.alike()
    text = "Matrix of the share of each effect that every other effect imitates; " + (
        "most alike: " + ", ".join(f"{a} by {b} {share:.2f}" for a, b, share in alike[:5]) if alike
        else "no pair is above 0.8"
    )  # fmt: skip
    caption = "Share of an effect (row) that another effect (column) imitates; empty: below 0.1."
    yield html.picture(pictures.isolability_figure(matrix), text, caption)
    if alike:
        yield html.table("Pairs that are hard to separate in these motions",
                         ("effect", "imitated by", "share"), alike)  # fmt: skip


def _provenance(found: Diagnosis, file: ModelFile) -> Iterator[str]:
    yield html.heading("Provenance")
    roles = {"training": found.checked.training, "held out": found.checked.held_out, "noise": found.checked.noise}
    rows = [(each.trial, role, len(each), each.digest or "not from a file") for role, records in roles.items()
            for each in records]  # fmt: skip
    yield html.table("Data", ("trial", "role", "samples", "digest"), rows)
    gates = [(name, float(value)) for name, value in vars(found.gates).items()]
    facts: list[tuple[str, str | float]] = [
        ("kind of the model", found.given.name), ("digest of the model file", file.digest),
        ("digest of this diagnosis", found.digest),
        ("made by", f"needleplan {version()}"), ("order of the noise model", float(found.calibration.noise.order)),
    ]  # fmt: skip
    yield html.table("Model and program", ("fact", "value"), facts)
    yield html.table("Thresholds", ("gate", "value"), gates)


def _added(found: Diagnosis) -> str:
    """Return words for captions that say which effects were added to the model that the report labels "After"."""
    if found.effects:
        return "with the named effects"
    if not found.lacks_data or found.joint is None:
        return "no effect was added"
    names = ", ".join(each.effect.name for each in found.joint.effects)
    return f"with the best effect, {names}, which is not named because data are missing"


def _words(column: str) -> str:
    return column.removesuffix("_mm_s").removesuffix("_mm").removesuffix("_s")


def _rms(values: np.typing.NDArray[np.float64]) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def _next_motion(each: NextMotion | None) -> Iterator[str]:
    """Yield the HTML of the section on the next motion; nothing if no motion is proposed."""
    if each is None:
        return
    program = each.program
    yield html.heading("What to measure next")
    yield html.paragraph(f"One more trial, role {each.role}: {program.about}. {_expectation(each)}")
    yield html.paragraph("The motion is in next_motion.toml, in the folder of this page. The comment at its beginning "
                         "explains how to simulate the motion and how to run it on a robot.")  # fmt: skip
    text = f"Depth over time of the proposed motion, {program.name}: {program.about}"
    yield html.picture(pictures.motion_figure(each.motion), text,
                       f"The motion, {each.motion.time_s[-1]:.0f} s.")  # fmt: skip
    match each:
        case Separating() if NOTHING not in {pair.alternative for pair in each.separations}:
            yield html.table(
                "Expected growth of the lead by one more trial; 1 is the lead that a name needs",
                ("true effect", "against", "this motion", "last motion repeated", "probability of a decision"),
                [(pair.true, pair.alternative, pair.thresholds, again.thresholds, f"{pair.resolves:.0%}")
                 for pair, again in zip(each.separations, each.repeated, strict=True)],
            )  # fmt: skip
        case Revealing():
            yield html.table(
                "Detection limits",
                ("effect", "now", "with this motion", "last motion repeated", "unit"),
                [(one.effect, one.now, one.after, one.repeated, one.unit or "1") for one in each.effects],
            )
        case Exploring():
            ordered = sorted(each.considered, key=lambda one: one[1], reverse=True)
            yield html.table("Information of one more trial on the gap, in bits", ("motion", "bits"), ordered)


def _expectation(each: NextMotion) -> str:
    if not isinstance(each, Separating) or NOTHING in {pair.alternative for pair in each.separations}:
        return each.why
    odds = (
        f"This motion decides between the effects with a probability of {each.resolves:.0%}; the last training "
        f"motion, repeated, would decide with a probability of {each.repeated_resolves:.0%}."
    )
    return f"{odds} {each.why}"
