"""The stages: check, calibrate, screen, decide, verify; each a function of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from needleplan.artifacts import digest
from needleplan.diagnosis.amounts import found_effects
from needleplan.diagnosis.calibrate import Calibration, Case, calibrate, measured_of
from needleplan.diagnosis.channels import measurand_of
from needleplan.diagnosis.check import Checked, Lack, check_data, scatter
from needleplan.diagnosis.decide import Decision, decide
from needleplan.diagnosis.diagnosis import Diagnosis
from needleplan.diagnosis.library import Library
from needleplan.diagnosis.localise import Localisation, localise
from needleplan.diagnosis.noise import Noise, fit_axes, together
from needleplan.diagnosis.select import Selection, select
from needleplan.diagnosis.space import LEVELS, Space
from needleplan.diagnosis.unknown import Described, describe
from needleplan.diagnosis.verdict import Gates, Verdict
from needleplan.errors import Mistake, ModelError
from needleplan.models import Channel, Model, simulate
from needleplan.models.effects import AugmentedModel, effects_of
from needleplan.signals import Record

__all__ = ["diagnose"]

_OTHER = 5.0
"""Factor between readings and model beyond which they are not of one needle."""

_WORSE = 1.1
"""Of the RMS that the base alone leaves: an effect that leaves more mends nothing."""


def diagnose(
    model: Model,
    recordings: Sequence[Record],
    *,
    library: Library | None = None,
    gates: Gates | None = None,
    seed: int = 0,
) -> Diagnosis:
    """Find where `model` and `recordings` disagree, what is missing, how much of it, and whether that is enough.

    `recordings` are trials with the roles train, holdout (another motion) and noise (the sensor alone).
    A `library` keeps what is computed for motions, and may be shared by data sets of one needle; by default it holds
    all effects of the model's channel. Raises DataError for data of which nothing can be said, ModelError for a model
    whose channel has no effects, or that has effects already.
    """
    gates = gates or measurand_of(model.channel).gates
    if isinstance(model, AugmentedModel):
        model = _plain(model)
    library = library or Library(effects_of(model.channel), model)
    if not library.effects:
        raise ModelError(Mistake("channel", model.channel, "has no effects that could be looked for"), model.name)
    checked = _of_this_needle(check_data(recordings, model.channel), model)
    calibration = calibrate(model, checked.training, checked.held_out, _noise(model, checked))
    selection = select(calibration, library, gates, seed=seed)
    hidden = [each.noise_multiple for each in selection.smallest if each.visible]
    decision = decide(selection, gates, seen=float(np.quantile(hidden, 0.75)) if hidden else float("inf"))
    decision = _limited(_helpful(decision, selection, calibration), checked)
    found = found_effects(selection) if decision.named else ()
    remarks = (*checked.remarks, *_strange(model, calibration))
    if (selection.joint.space if selection.joint else selection.base).level >= LEVELS[-1]:
        remarks += (
            f"the tissue was taken to vary by {LEVELS[-1]:.0%} from place to place, the most that is considered: this "
            "model is far from what was measured, or the noise is more than was taken for it",
        )
    place = _localisation(decision, selection, calibration, seed)
    parents = "".join(sorted(each.digest or digest(each["time_s"].tobytes()) for each in recordings))
    return Diagnosis(
        decision, model, checked, calibration, selection, found, selection.smallest, gates,
        place, _described(decision, selection, calibration, place, gates), remarks,
        digest(f"{model!r} {parents} {decision!r} {[each.added for each in found]!r}"),
    )  # fmt: skip


def _plain(model: AugmentedModel) -> Model:
    names = ", ".join(each.name for each in model.effects)
    rule = f"has effects already ({names}); diagnose its base, or take them out first"
    raise ModelError(Mistake("effect", names, rule), model.name)


def _of_this_needle(checked: Checked, model: Model) -> Checked:
    """Return what was checked, with what lacks where readings are of another size than the model's.

    Calibration mends that, and what fits then is a difference from another needle than the one that was asked about.
    """
    given = np.concatenate([simulate(model, each.motion()).output.ravel() for each in checked.training])
    measured = np.concatenate([measured_of(each, model.channel) for each in checked.training])
    ratio = float(np.sqrt(np.nanmean(measured**2)) / max(float(np.sqrt(np.mean(given**2))), 1e-12))
    if 1 / _OTHER < ratio < _OTHER:
        return checked
    why = (
        f"the readings are {ratio:.2g} times as large as the model says (RMS): another needle or tissue, or a wrong "
        "unit? Identify the base from recordings of this needle first"
    )
    return replace(checked, lacks={**checked.lacks, Lack.NEEDLE: why})


def _noise(model: Model, checked: Checked) -> Noise:
    if checked.noise:
        return fit_axes([[each[name] for each in checked.noise] for name in model.channel.columns])
    # Without a record of it, noise is what changes from sample to sample: twice differenced, motion is gone.
    found = []
    for name in model.channel.columns:
        sd = float(np.median([scatter(each[name]) for each in checked.training])) or 1e-9
        found.append(Noise(np.zeros(0), sd, sd))
    return together(found)


def _localisation(decision: Decision, selection: Selection, calibration: Calibration, seed: int) -> Localisation:
    """Return where the gap lies; where a base imitates what is missing, beside the base as it was believed to be."""
    quiet = decision.verdict in (Verdict.NONE, Verdict.UNDERPOWERED)
    if quiet or not selection.believed:
        return localise(selection.base, calibration.training, seed=seed)
    return localise(Space([case.block for case in selection.believed]), selection.believed, seed=seed)


def _described(
    decision: Decision, selection: Selection, calibration: Calibration, place: Localisation, gates: Gates
) -> Described | None:
    if calibration.given.channel is not Channel.FORCE:  # its formulas are of forces
        return None
    if decision.verdict is Verdict.UNKNOWN:
        rival = selection.steps[0].rivals[0]
        return describe(selection.base, calibration.training, calibration.held_out, rival, place, gates)
    if decision.verdict is Verdict.INCOMPLETE and selection.joint:
        rival, joint = selection.steps[-1].rivals[0], selection.joint
        return describe(joint.space, joint.cases, (), rival, localise(joint.space, joint.cases), gates)
    return None


def _helpful(decision: Decision, selection: Selection, calibration: Calibration) -> Decision:
    """Return the verdict, UNKNOWN where the base alone comes nearer to what was measured than with what was found.

    Tissue that may vary takes up anything in the end, a wrong effect among it.
    """
    if not decision.named or selection.joint is None:
        return decision
    alone, both = _left_rms(calibration.training), _left_rms(selection.joint.cases)
    if both <= _WORSE * alone:
        return decision
    text = (
        f"beside tissue that varies by {selection.joint.space.level:.0%} the best of the known effects would be "
        f"{' and '.join(decision.named)}, but the model alone comes nearer to what was measured"
    )
    return Decision(Verdict.UNKNOWN, (), (), selection.steps[0].rivals[0].axis, decision.explained, text)


def _left_rms(cases: Sequence[Case]) -> float:
    return float(np.sqrt(np.nanmean(np.concatenate([case.measured - case.predicted for case in cases]) ** 2)))


def _limited(decision: Decision, checked: Checked) -> Decision:
    """Return the verdict that the data can carry: without noise, held-out motion or a second trial, no name is sure."""
    if decision.verdict not in (Verdict.NAMED, Verdict.INCOMPLETE) or not checked.lacks:
        return decision
    fits = "fits" if len(decision.named) == 1 else "fit"
    lack = ", ".join(f"no {lack}" for lack in checked.lacks)
    text = f"{' and '.join(decision.named)} {fits} best, but these data cannot carry a name: {lack}"
    return Decision(Verdict.AMBIGUOUS, (), decision.named, decision.axis, decision.explained, text)


def _strange(model: Model, calibration: Calibration) -> list[str]:
    """Return what is odd about the calibrated base: parameters at their bounds, or far from those of the file."""
    found = []
    for name in calibration.free:
        what, given, now = model.parameters()[name], getattr(model, name), getattr(calibration.model, name)
        if now in (what.lower, what.upper) or (given * now > 0 and not 0.2 < now / given < 5):
            found.append(
                f"{name} is {now:.3g} {what.unit} in these recordings, and {given:.3g} in the model: another needle or "
                "tissue, or wrong units?"
            )
    lags = [case.lag_s for case in calibration.training]
    if max(lags) > 0.03:
        found.append(f"the readings are {max(lags) * 1e3:.0f} ms late: are the clocks of sensor and robot in step?")
    return found
