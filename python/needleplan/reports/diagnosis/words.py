"""The verdict in words for the report."""

from __future__ import annotations

from collections.abc import Iterator

from needleplan.diagnosis import Diagnosis, GapAxis, RoundOutcome, Verdict

__all__ = ["STOPS", "advice", "answer", "title_of"]

_ALONG = {
    GapAxis.TIME: "time: a change at some moment, or a slow change",
    GapAxis.DEPTH: "depth, the position of the tip",
    GapAxis.SPEED: "the speed of the needle",
    GapAxis.FORCE: "force: the sensor is nonlinear, or the needle yields",
    GapAxis.DWELL: "the time of a dwell: the reading changes while the needle rests",
    GapAxis.PERIOD: "position, periodically: a screw, a gear, a guide",
}

STOPS = {
    RoundOutcome.ACCEPTED: "accepted",
    RoundOutcome.WEAK: "below the threshold",
    RoundOutcome.CHANCE: "too likely by chance",
    RoundOutcome.TIE: "tied with another effect",
    RoundOutcome.NO_TRANSFER: "refuted by the held-out trials",
    RoundOutcome.SMALL: "too small beside the first effect",
    RoundOutcome.NAMELESS: "an alternative does better beside the other effects",
    RoundOutcome.ENOUGH: "the largest number of names is reached",
}
"""Outcome of a round in words."""

_TITLES = {
    Verdict.NONE: "no effect is missing that these data could show",
    Verdict.UNDERPOWERED: "no gap, but these data could hide a relevant effect",
    Verdict.INCOMPLETE: "{names}, and another effect",
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
    """Yield the result in sentences."""
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
    level = (found.joint.likelihood if found.joint else found.selection.base).heterogeneity_sd
    yield (
        f"All parameters of the model were first fitted to each trial, so that a wrong parameter is not called a "
        f"missing effect. The estimated heterogeneity of the tissue is {level:.0%}."
    )


def _begun(text: str) -> str:
    return text[:1].upper() + text[1:]


def advice(found: Diagnosis) -> Iterator[str]:
    """Yield what to do next."""
    for why in found.checked.lacks.values():
        yield f"Missing data: {why}."
    match found.verdict:
        case Verdict.NAMED:
            yield "Use model.toml beside this page from now on: it contains the named effects."
        case Verdict.INCOMPLETE:
            yield "Diagnose again with more trials of other motions: no effect explains the remaining gap."
        case Verdict.AMBIGUOUS if found.lacks_data:
            yield "The best effect may be right: record the missing data, and diagnose again with all recordings."
        case Verdict.AMBIGUOUS:
            yield f"Record the motion below, which separates these effects: {', '.join(found.decision.tied)}."
        case Verdict.UNKNOWN:
            yield "Look at the map and at the trials below; add a known cause as an effect file."
            yield "Record the motion below, which shows most of the gap, and diagnose again."
        case Verdict.UNDERPOWERED:
            yield "The table of detection limits lists what may be hidden; the motion below lowers the limits."
        case Verdict.IMPLAUSIBLE:
            yield "Check the units, the sensor and the kind of model first."
        case _:
            pass
    for remark in found.remarks:
        yield f"Remark: {remark}" + "." * (remark[-1:] not in "?!.")
