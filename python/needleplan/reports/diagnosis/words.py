"""A verdict in the words of a laboratory."""

from __future__ import annotations

from collections.abc import Iterator

from needleplan.diagnosis import Axis, Diagnosis, Verdict
from needleplan.diagnosis.step import Stop

__all__ = ["STOPS", "advice", "answer", "title_of"]

_ALONG = {
    Axis.TIME: "time: something changes from some moment on, or slowly",
    Axis.DEPTH: "depth: something depends on where the tip is",
    Axis.SPEED: "speed: something depends on how fast the needle moves",
    Axis.FORCE: "force: the reading is not in proportion to the force, or the needle gives way",
    Axis.HOLD: "rest: something happens while the needle stands still",
    Axis.PERIOD: "position, again and again: a screw, a gear, a guide",
}

STOPS = {
    Stop.ACCEPTED: "taken",
    Stop.WEAK: "below the threshold",
    Stop.CHANCE: "chance does as well too often",
    Stop.TIE: "another does as well",
    Stop.NO_TRANSFER: "does not hold in another motion",
    Stop.SMALL: "too small beside the first",
    Stop.NAMELESS: "what has no name does better beside the others",
    Stop.ENOUGH: "no more are looked for",
}
"""How a round ended."""

_TITLES = {
    Verdict.NONE: "nothing is missing that these data could show",
    Verdict.UNDERPOWERED: "nothing was seen, but these data could not have shown everything that matters",
    Verdict.INCOMPLETE: "{names}, and something else",
    Verdict.AMBIGUOUS: "something is missing, and these data cannot tell what",
    Verdict.UNKNOWN: "something is missing, and it is none of the known effects",
    Verdict.IMPLAUSIBLE: "{names} fits best, but would have to be larger than it can be",
}


def title_of(found: Diagnosis) -> str:
    """Return the verdict as a title."""
    names = " and ".join(each.effect.title for each in found.effects)
    text = _TITLES.get(found.verdict, "what is missing: {names}").format(names=names or "an effect")
    return f"Diagnosis: {text}"


def answer(found: Diagnosis, unit: str) -> Iterator[str]:
    """Return what was found, sentence by sentence."""
    decision, noise = found.decision, found.calibration.noise.rms
    yield f"Verdict: {decision.verdict}. {_begun(decision.because)}."
    for each in found.effects:
        size = each.added.estimates["size"]
        yield (
            f"{_begun(each.effect.title)}: {each.effect.meaning.rstrip('.')}. Size {size.value:.3g} {size.unit} "
            f"(95 %: {size.low:.3g} to {size.high:.3g}); it adds {each.rms:.3g} {unit} RMS to the training data, "
            f"{each.rms / noise:.2g} times the noise."
        )
    after = found.verified
    if found.effects and after:
        yield (
            f"In the held-out trials, to which only the base was fitted, the model left {after.before_rms:.3g} {unit} "
            f"RMS before, and {after.after_rms:.3g} {unit} with what was named; the noise is "
            f"{after.floor_rms:.3g} {unit}."
        )
    if decision.axis:
        along = _ALONG.get(decision.axis, str(decision.axis))
        yield f"What has no name lies along {along}."
    level = (found.joint.space if found.joint else found.selection.base).level
    yield (
        f"Every parameter of the model was fitted to every trial first, so that nothing is called missing that another "
        f"value would mend; the tissue was taken to vary by {level:.0%} from place to place."
    )


def _begun(text: str) -> str:
    return text[:1].upper() + text[1:]


def advice(found: Diagnosis) -> Iterator[str]:
    """Return what to do next."""
    for why in found.checked.lacks.values():
        yield f"Lacking: {why}."
    match found.verdict:
        case Verdict.NAMED:
            yield "Use model.toml beside this page from now on: it is the model with what was named."
        case Verdict.INCOMPLETE:
            yield "Diagnose again with more and other motions: what is left is too small or too unlike to be named."
        case Verdict.AMBIGUOUS if found.lacks_data:
            yield "What fits best may be right: record what lacks, and diagnose again with all of it."
        case Verdict.AMBIGUOUS:
            yield f"Make the motion below, which tells these apart: {', '.join(found.decision.tied)}."
        case Verdict.UNKNOWN:
            yield "Look at the map and at the trials below; a cause that is known can be added as an effect of its own."
            yield "Make the motion below, which shows most of the gap, and diagnose again."
        case Verdict.UNDERPOWERED:
            yield "The table of smallest effects says what could hide; the motion below makes it shorter."
        case Verdict.IMPLAUSIBLE:
            yield "Check units, the sensor and the kind of model before believing any name."
        case _:
            pass
    for remark in found.remarks:
        yield f"Remark: {remark}" + "." * (remark[-1:] not in "?!.")
