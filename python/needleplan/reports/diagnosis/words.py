"""Sentences of the report: title, result and advice."""

from __future__ import annotations

from collections.abc import Iterator

from needleplan.diagnosis import Diagnosis, GapAxis, RoundOutcome, Verdict

__all__ = ["STOPS", "advice", "answer", "title_of"]

# Text after "The unexplained gap depends on".
_ALONG = {
    GapAxis.TIME: "time: it changes at some moment, or slowly",
    GapAxis.DEPTH: "depth, the position of the tip",
    GapAxis.SPEED: "the speed of the needle",
    GapAxis.FORCE: "the force: perhaps the sensor is nonlinear, or the needle yields",
    GapAxis.DWELL: "the time since the start of a dwell: the reading changes while the needle is at rest",
    GapAxis.PERIOD: "position, periodically: perhaps a screw, a gear or a guide causes it",
}

STOPS = {
    RoundOutcome.ACCEPTED: "accepted",
    RoundOutcome.WEAK: "below the threshold",
    RoundOutcome.CHANCE: "too likely by chance",
    RoundOutcome.TIE: "tied with another effect",
    RoundOutcome.NO_TRANSFER: "refuted by the held-out trials",
    RoundOutcome.SMALL: "too small beside the first effect",
    RoundOutcome.NAMELESS: "a nonparametric alternative does better than one of the effects",
    RoundOutcome.ENOUGH: "the largest number of names is reached",
}
"""Text in the report for each outcome of a round."""

_TITLES = {
    Verdict.NONE: "no effect is missing that these data could show",
    Verdict.UNDERPOWERED: "no gap, but these data could hide a relevant effect",
    Verdict.INCOMPLETE: "missing effects: {names}, and at least one other",
    Verdict.AMBIGUOUS: "an effect is missing, and these data do not decide which",
    Verdict.UNKNOWN: "an effect is missing, and no known effect explains the gap",
    Verdict.IMPLAUSIBLE: "{names} fits best, but its amplitude is at its bound",
}


def title_of(found: Diagnosis) -> str:
    """Return the title of the report."""
    names = " and ".join(each.effect.title for each in found.effects)
    text = _TITLES.get(found.verdict, "missing effect: {names}").format(names=names or "an effect")
    return f"Diagnosis: {text}"


def answer(found: Diagnosis, unit: str) -> Iterator[str]:
    """Yield paragraphs that state the result of the diagnosis. `unit` is the unit of the diagnosed channel."""
    decision, noise = found.decision, found.calibration.noise.rms
    yield f"Verdict: {decision.verdict}. {_begun(decision.because)}."
    for each in found.effects:
        size = each.estimates["size"]
        yield (
            f"{_begun(each.effect.title)}: {each.effect.meaning.rstrip('.')}. Amplitude {size.value:.3g} {size.unit} "
            f"(95 %: {size.low:.3g} to {size.high:.3g}); it adds {each.rms:.3g} {unit} RMS to the training data, "
            f"{each.rms / noise:.2g} times the noise."
        )
    after = found.validation
    if found.effects and after:
        yield (
            f"On the held-out trials, with only the base model recalibrated, the residual RMS is "
            f"{after.before_rms:.3g} {unit} before and {after.after_rms:.3g} {unit} with the named effects; the noise "
            f"is {after.floor_rms:.3g} {unit}."
        )
    if decision.axis:
        along = _ALONG.get(decision.axis, str(decision.axis))
        yield f"The unexplained gap depends on {along}."
    heterogeneity_sd = (found.joint.likelihood if found.joint else found.selection.base).heterogeneity_sd
    yield (
        f"All parameters of the model were first fitted to each trial, so that a wrong parameter is not called a "
        f"missing effect. The estimated heterogeneity of the tissue is {heterogeneity_sd:.0%}."
    )


def _begun(text: str) -> str:
    return text[:1].upper() + text[1:]


def advice(found: Diagnosis) -> Iterator[str]:
    """Yield sentences: missing data, then recommended next steps, then the remarks of the diagnosis."""
    for why in found.checked.lacks.values():
        yield f"Missing data: {why}."
    match found.verdict:
        case Verdict.NAMED:
            yield "From now on, use model.toml in the folder of this page: it contains the named effects."
        case Verdict.INCOMPLETE:
            yield "Diagnose again with more trials of other motions: no effect explains the remaining gap."
        case Verdict.AMBIGUOUS if found.lacks_data:
            yield "The best effect may be right: record the missing data, and diagnose again with all recordings."
        case Verdict.AMBIGUOUS:
            yield f"Record the motion below, which separates these effects: {', '.join(found.decision.tied)}."
        case Verdict.UNKNOWN:
            yield "Look at the map and at the trials below; add a known cause as an effect file."
            yield "Record the motion below, which gives most information on the gap, and diagnose again."
        case Verdict.UNDERPOWERED:
            yield "The table of detection limits lists what may be hidden; the motion below lowers the limits."
        case Verdict.IMPLAUSIBLE:
            yield "Check the units, the sensor and the kind of model first."
        case _:
            pass
    for remark in found.remarks:
        yield f"Remark: {remark}" + "." * (remark[-1:] not in "?!.")
