"""Sentences of the report: title, result and advice."""

from __future__ import annotations

from collections.abc import Iterator

from needleplan.diagnosis import Diagnosis, FindingKind, GapAxis, NextTrials, Verdict
from needleplan.signals import UNITS

__all__ = ["advice", "answer", "title_of"]

# Text after "What is missing depends on".
_ALONG = {
    GapAxis.TIME: "time: it changes at some moment, or slowly",
    GapAxis.DEPTH: "depth, the position of the tip",
    GapAxis.SPEED: "the speed of the needle",
    GapAxis.ACCELERATION: "the acceleration of the needle: perhaps what holds it swings, or an amplifier rings",
    GapAxis.FORCE: "the force: perhaps the sensor is nonlinear, or the needle yields",
    GapAxis.DWELL: "the time since the start of a dwell: the reading changes while the needle is at rest",
    GapAxis.PERIOD: "position, periodically: perhaps a screw, a gear or a guide causes it",
}

_TITLES = {
    Verdict.NONE: "no effect is missing that these data could show",
    Verdict.UNDERPOWERED: "nothing found, but these data could hide a relevant effect",
    Verdict.CHANGED: "no effect is missing, but the model has changed: {changed}",
    Verdict.NAMED: "missing effect: {names}",
    Verdict.INCOMPLETE: "missing: {names}, and probably something else",
    Verdict.AMBIGUOUS: "an effect is missing, and these data do not decide which",
    Verdict.UNKNOWN: "something is missing, and no known effect explains it",
    Verdict.IMPLAUSIBLE: "{likely} fits best, but at the end of its range",
}


def title_of(diagnosis: Diagnosis) -> str:
    """Return the title of the report."""
    names = " and ".join(dict.fromkeys(item.effect.title for item in diagnosis.effects))
    likely = " and ".join(dict.fromkeys(item.effect.title for item in diagnosis.likely))
    text = "{likely} fits best, but data are missing" if diagnosis.lacks_data else _TITLES[diagnosis.verdict]
    changed = ", ".join(item.name for item in diagnosis.findings if item.kind is not FindingKind.EFFECT)
    return f"Diagnosis: {text.format(names=names, likely=likely or 'an effect', changed=changed)}"


def answer(diagnosis: Diagnosis) -> Iterator[str]:
    """Yield paragraphs on the gap of the given model, the verdict, the findings, and the effects that close the gap."""
    yield ". ".join(_begun(sentence) for sentence in diagnosis.budget.sentences()) + "."
    decision, noise = diagnosis.decision, diagnosis.calibration.noise.rms
    unit = UNITS[diagnosis.given.channel.columns[0]]
    yield f"Answer: {str(decision.verdict).replace('_', ' ')}. {_begun(decision.because)}."
    for finding in diagnosis.findings:
        if finding.kind in (FindingKind.PARAMETER, FindingKind.LAW) and finding.words != decision.because:
            yield f"Finding, another {finding.kind}: {finding.words}."
    for effect in diagnosis.effects:
        size = effect.estimates["size"]
        yield (
            f"{_begun(effect.effect.title)}: {effect.effect.meaning.rstrip('.')}. "
            f"Amplitude {size.value:.3g} {size.unit} "
            f"(95 %: {size.low:.3g} to {size.high:.3g}); it adds {effect.rms:.3g} {unit} RMS to the readings, "
            f"{effect.rms / noise:.2g} times the noise."
        )
    if diagnosis.effects and diagnosis.shrink == diagnosis.shrink:  # not NaN
        yield (
            f"With effects fitted to the training trials alone, {diagnosis.shrink:.0%} of the gap of the held-out "
            "trials above the noise is closed."
        )
    if decision.axis:
        yield f"What is missing depends on {_ALONG.get(decision.axis, str(decision.axis))}."
    yield (
        "The parameters of the model were fitted to each trial together with the effects, and the laws of the model "
        "may be wrong by some tolerance, so that neither is called a missing effect."
    )


def _begun(text: str) -> str:
    return text[:1].upper() + text[1:]


def _record(next_: NextTrials) -> str:
    """Return the advice to record the next motions. A repetition has no file, so that its trial is named."""
    first, *others = next_.motions
    what = "the motions below" if others else f"{first.repeats} once more" if first.repeats else "the motion below"
    return f"Record {what}, and diagnose again with all recordings."


def advice(diagnosis: Diagnosis, next_: NextTrials | None) -> Iterator[str]:
    """Yield sentences: missing data, then recommended next steps, then the remarks of the diagnosis."""
    for why in diagnosis.checked.lacks.values():
        yield f"Missing data: {why}."
    motion = _record(next_) if next_ else ""
    match diagnosis.verdict:
        case Verdict.NAMED:
            yield "From now on, use model.toml in the folder of this page: it contains the named effects."
        case Verdict.CHANGED if diagnosis.keeps_given:
            yield "Keep the given model: it predicts trials that were not fitted better than the calibrated one."
        case Verdict.CHANGED:
            yield "Use model.toml in the folder of this page, which has the parameters and laws of these recordings."
        case Verdict.INCOMPLETE:
            yield motion or "Diagnose again with more trials of other motions."
        case Verdict.AMBIGUOUS if diagnosis.lacks_data:
            yield "The best effect may be right: record the missing data, and diagnose again with all recordings."
        case Verdict.AMBIGUOUS if diagnosis.decision.other_laws:
            yield (
                "Another motion does not help: the parameters of the base model are fitted to each trial already, and "
                "its law still differs. Replace or extend the law that the remark names in the base model, and "
                "diagnose again."
            )
        case Verdict.AMBIGUOUS:
            yield motion or "Diagnose again with more trials of other motions."
        case Verdict.UNKNOWN:
            yield "Look at the map and at the trials below; add a known cause as an effect file."
            yield motion or "No motion of the list gives information on this gap."
        case Verdict.UNDERPOWERED:
            yield f"The table of detection limits lists what may be hidden. {motion}".strip()
        case Verdict.IMPLAUSIBLE:
            yield "The effect stands for something else. Check the units, the sensor and the kind of model first."
        case _:
            pass
    for remark in diagnosis.remarks:
        yield f"Remark: {remark}" + "." * (remark[-1:] not in "?!.")
