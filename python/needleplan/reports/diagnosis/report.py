"""`report.html`: answer, gap, hypotheses, next motions, curves, constants, in one file of at most six sections."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from needleplan.artifacts import version
from needleplan.diagnosis import Diagnosis, Isolability, Library, NextTrials, isolability, ranked_hypotheses
from needleplan.diagnosis.channels import ROUGH_MM, SMOOTH_MM
from needleplan.models import Model, ModelFile
from needleplan.reports.diagnosis import html, pictures
from needleplan.reports.diagnosis.document import MOST_HYPOTHESES, held_out_rms
from needleplan.reports.diagnosis.motion_file import motion_files
from needleplan.reports.diagnosis.traces import TrialTrace, correlation, gap_map
from needleplan.reports.diagnosis.words import advice, answer, title_of
from needleplan.signals import UNITS

__all__ = ["report_of"]

# Largest p-value with which a part of the recordings (a depth range, a phase, a trial ...) is listed.
_SMALL = 0.05
# Largest number of listed parts.
_MOST = 12
# p-value below which only "below 1e-06" is shown.
_SMALLEST_P = 1e-6


def report_of(
    found: Diagnosis,
    file: ModelFile,
    library: Library,
    next_: NextTrials | None,
    traces: Sequence[TrialTrace],
) -> str:
    """Return the HTML text of `report.html`. Without next motions (`next_` is None) the report lacks this section."""
    unit = UNITS[found.given.channel.columns[0]]
    smooth = found.tissue["smooth"] > found.tissue["rough"]
    return html.page(title_of(found), [
        *_answer(found, next_),
        *_gap(found, traces, unit),
        *_where(found, traces),
        *_course(found, unit),
        *_hypotheses(found),
        *_effects(found),
        *_isolability(isolability(found.calibration, library, found.heterogeneity, smooth=smooth)),
        *_smallest(found, unit),
        *_tissue(found),
        *_next_motions(next_, found.given),
        *_trials(traces, unit),
        *_whiteness(traces),
        *_constants(found),
        *_provenance(found, file),
    ])  # fmt: skip


def _answer(diagnosis: Diagnosis, next_: NextTrials | None) -> Iterator[str]:
    yield '<section class="answer" aria-label="answer">'
    yield from map(html.paragraph, answer(diagnosis))
    yield "</section>"
    if todo := list(advice(diagnosis, next_)):
        yield html.heading("What to do")
        yield html.items(todo)


def _hypotheses(diagnosis: Diagnosis) -> Iterator[str]:
    yield html.heading("Hypotheses")
    yield html.table(
        "The most probable first. One nat is a factor of 2.7 in probability.",
        ("hypothesis", "probability", "why it won or lost"),
        [
            (hypothesis.words, hypothesis.probability, hypothesis.because)
            for hypothesis in ranked_hypotheses(diagnosis, MOST_HYPOTHESES)
        ],
    )
    if len(diagnosis.decision.family) > 1:
        yield html.paragraph(f"At least one of these effects is missing: {', '.join(diagnosis.decision.family)}.")


def _gap(diagnosis: Diagnosis, traces: Sequence[TrialTrace], unit: str) -> Iterator[str]:
    yield html.heading("Gap")
    text = f"Bars of the residual RMS in {unit} for the trials of each role, with the noise"
    noise = diagnosis.calibration.noise.rms
    yield html.picture(pictures.gap_figure(noise, traces, unit), text,
                       "Before: the model without effects, fitted to each trial. "
                       f"After: {_added(diagnosis)}. Tolerances "
                       "and tissue are not part of these curves; the next figure takes them out.")  # fmt: skip
    budget = diagnosis.budget
    rows: list[tuple[str | float, ...]] = [
        (name, budget.roles[name], *stages.values()) for name, stages in budget.trials.items()
    ]
    stages = tuple(stage.name for stage in budget.stages())
    yield html.table(f"Gap budget: residual RMS after each stage, {unit}; the noise is {noise:.3g} {unit}",
                     ("trial", "role", *stages), rows)  # fmt: skip
    held = held_out_rms(diagnosis)
    if held and held["shrink"] == held["shrink"]:  # not NaN
        yield html.paragraph(
            f"Effects fitted to the training trials alone close {held['shrink']:.0%} of the gap of the held-out trials "
            "above the noise."
        )


def _where(diagnosis: Diagnosis, traces: Sequence[TrialTrace]) -> Iterator[str]:
    yield html.heading("Where", 3)
    phases, edges, energy = gap_map(traces, after=False)
    row, column = np.unravel_index(np.nanargmax(energy), energy.shape)
    most = (f"before, the largest mean square is {energy[row, column]:.3g} times that of noise, at "
            f"{edges[column]:.3g} to {edges[column + 1]:.3g} mm in the phase '{phases[row]}'")  # fmt: skip
    text = f"Whitened residual over depth, and a map of its mean square by depth and phase of the motion; {most}"
    caption = (
        "Whitened residual of all trials, tolerances and tissue taken out (grey: 99 % range of noise), and its mean "
        f"square by depth and phase; 1 is noise alone. {most[0].upper()}{most[1:]}."
    )
    yield html.picture(pictures.map_figure(traces), text, caption)
    parts = [each for each in diagnosis.where if each.p_value <= _SMALL]
    if not parts:
        yield html.paragraph("No part of the depth, speed or time range, no phase and no trial has a significant "
                             "share of the gap (p > 0.05).")  # fmt: skip
        return
    yield html.table(
        "Parts with a significant share of the gap of the model without effects",
        ("along", "part", "share of the gap", "p"),
        [(_words(part.axis), part.label, f"{part.share:.0%}", _chance(part.p_value)) for part in parts[:_MOST]],
    )


def _effects(diagnosis: Diagnosis) -> Iterator[str]:
    yield html.heading("Estimates", 3)
    shown = diagnosis.effects or diagnosis.likely
    columns = ("parameter", "value", "from", "to", "unit")
    if shown:
        rows = [
            (f"{effect.effect.title}: {name}", estimate.value, estimate.low, estimate.high, estimate.unit or "1")
            for effect in shown
            for name, estimate in effect.estimates.items()
        ]
        which = "the named effects" if diagnosis.effects else "the most probable set, which is not named"
        yield html.table(f"Parameters of {which}, with 95 % intervals", columns, rows)
        for effect in shown:
            yield html.paragraph(
                f"{effect.effect.title}: {effect.effect.equation} (source: {effect.effect.source}). Probability: "
                f"{diagnosis.marginals.get(effect.name, 0.0):.3f}. Share of the gap: {effect.share:.0%}."
            )
    rows = [
        (name, estimate.value, estimate.low, estimate.high, estimate.unit or "1")
        for name, estimate in diagnosis.estimates().items()
    ]
    yield html.table("Parameters of the base model, mean of the training trials", columns, rows)


def _course(diagnosis: Diagnosis, unit: str) -> Iterator[str]:
    course = diagnosis.course
    if course is None:
        return
    yield html.heading("Shape of what no effect explains", 3)
    values = np.concatenate([curve.mean[curve.inside] for curve in course.curves])
    if values.size:
        text = (f"Missing output along {course.axis.label}: {values.min():.3g} to {values.max():.3g} {unit}, with two "
                "standard deviations")  # fmt: skip
        caption = "Mean within the visited range, with two standard deviations."
        yield html.picture(pictures.course_figure(course, unit), text, caption)
    yield html.paragraph(
        "The file effect_to_name.py, in the folder of this page, defines an effect with this shape; complete it if you "
        "know the cause."
    )


def _next_motions(next_: NextTrials | None, model: Model) -> Iterator[str]:
    """Yield the HTML of the section on the next motions; nothing if no motion is proposed."""
    if next_ is None:
        return
    files = motion_files(next_, model)
    yield html.heading("What to measure next")
    yield html.paragraph(f"Role {next_.role}. {next_.why}")
    shown = {motion.name: motion for motion in next_.motions}
    for name, each in shown.items():
        file = files.get(name)
        which = f"The motion is in {file.name}, in the folder of this page." if file else "Record this trial once more."
        if file and file.problem:
            which = f"There is no file of this motion: {file.problem}."
        times = sum(one.name == name for one in next_.motions)
        yield html.paragraph(f"{name}: {each.about}{f', {times} times' if times > 1 else ''}. {which}")
        text = f"Depth over time of the proposed motion, {name}: {each.about}"
        seconds = float(each.motion.time_s[-1] - each.motion.time_s[0])
        yield html.picture(pictures.motion_figure(each.motion), text, f"The motion, {seconds:.0f} s.")
    yield html.table("Expected information of one trial, in bits", ("motion", "bits"), next_.considered)


def _trials(traces: Sequence[TrialTrace], unit: str) -> Iterator[str]:
    yield html.heading("Measured and modelled")
    for trace in traces:
        yield html.heading(f"{trace.trial} ({trace.words})", 3)
        names = ("x", "y", "z") if len(trace.measured) == 3 else ("force",)
        after = "" if trace.after is None else f", after {_rms(trace.measured - trace.after):.3g}"
        text = (f"Trial {trace.trial}: measured and modelled output over time, with the depth; residual before "
                f"{_rms(trace.measured - trace.before):.3g}{after} {unit} RMS")  # fmt: skip
        yield html.picture(pictures.trial_figure(trace, unit, names), text)


def _whiteness(traces: Sequence[TrialTrace]) -> Iterator[str]:
    yield html.heading("Whiteness of the residual", 3)
    values, bound = correlation(traces, 40, after=True)
    outside = int((np.abs(values) > bound).sum())
    text = f"Autocorrelation of the whitened residual at 40 lags; {outside} are outside of the 99 % band"
    yield html.picture(pictures.correlation_figure(traces), text,
                       "All trials. Grey: 99 % band of white noise.")  # fmt: skip


def _smallest(diagnosis: Diagnosis, unit: str) -> Iterator[str]:
    yield html.heading("Detection limits", 3)
    titles = {entry.effect.name: entry.effect.title for entry in diagnosis.posterior.entries}
    rows = [
        (limit.effect, titles[limit.effect], limit.amplitude, limit.unit or "1", limit.rms, limit.noise_multiple, "")
        if limit.visible else
        (limit.effect, titles[limit.effect], None, limit.unit or "1", None, None,
         "invisible in these motions, or absorbed by the model")
        for limit in diagnosis.detection_limits
    ]  # fmt: skip
    columns = ("effect", "meaning", "amplitude", "unit", f"RMS ({unit})", "in noise RMS", "remark")
    caption = "Amplitude of each effect that would have been named with a probability of 0.8"
    yield html.table(caption, columns, rows)


def _tissue(diagnosis: Diagnosis) -> Iterator[str]:
    yield html.heading("Heterogeneity of the tissue", 3)
    kinds = {
        "homogeneous": "none",
        "rough": f"exponential correlation along the depth, length {ROUGH_MM:g} mm",
        "smooth": f"Matern 5/2 correlation along the depth, length {SMOOTH_MM:g} mm",
    }
    yield html.paragraph(
        "Beside the most probable set of effects, the most probable standard deviation of the tissue's properties "
        f"along the depth is {diagnosis.heterogeneity:.1%} of their mean."
    )
    yield html.table(
        "Kinds of tissue",
        ("kind", "heterogeneity", "probability"),
        [(kind, words, diagnosis.tissue[kind]) for kind, words in kinds.items()],
    )


def _isolability(matrix: Isolability) -> Iterator[str]:
    yield html.heading("Which effects these motions separate", 3)
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


def _constants(diagnosis: Diagnosis) -> Iterator[str]:
    yield html.heading("Constants and provenance")
    rows = [(each.name, each.value, each.unit, each.effect, each.reason) for each in diagnosis.settings.described()]
    yield html.table("Constants of model, priors and answers", ("name", "value", "unit", "effect", "reason"), rows)


def _provenance(diagnosis: Diagnosis, file: ModelFile) -> Iterator[str]:
    yield html.heading("Provenance", 3)
    rows = [
        (recording.trial, str(recording.role), len(recording), recording.digest or "not from a file")
        for recording in diagnosis.recordings
    ]
    yield html.table("Data", ("trial", "role", "samples", "digest"), rows)
    facts: list[tuple[str, str | float]] = [
        ("kind of the model", diagnosis.given.name), ("digest of the model file", file.digest),
        ("digest of this diagnosis", diagnosis.digest),
        ("made by", f"needleplan {version()}"), ("order of the noise model", float(diagnosis.calibration.noise.order)),
    ]  # fmt: skip
    yield html.table("Model and program", ("fact", "value"), facts)


def _added(diagnosis: Diagnosis) -> str:
    """Return words for captions that say which effects were added to the model that the report labels "After"."""
    if not diagnosis.names and not diagnosis.lacks_data:
        return "no effect was added"
    names = ", ".join(dict.fromkeys(each.effect.title for each in diagnosis.likely))
    return f"with {names}" + ("" if diagnosis.names else ", not named because data are missing")


def _chance(p_value: float) -> float | str:
    """Return `p_value`, or a text such as "below 1e-06" if it is smaller than `_SMALLEST_P`."""
    return f"below {_SMALLEST_P:g}" if p_value < _SMALLEST_P else p_value


def _words(column: str) -> str:
    return column.removesuffix("_mm_s").removesuffix("_mm").removesuffix("_s")


def _rms(values: np.typing.NDArray[np.float64]) -> float:
    return float(np.sqrt(np.nanmean(values**2)))
