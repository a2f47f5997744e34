"""`diagnose`, its result `Diagnosis`, and the document of `diagnosis.json` (schema: docs/reference/diagnosis.md)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from needleplan.artifacts import digest, json_values, version
from needleplan.diagnosis._verdict import (
    DiagnosisDecision,
    Verdict,
    decide,
    estimate_effects,
    limit_to_data,
    reject_if_worse,
)
from needleplan.diagnosis.calibration import (
    CalibratedTrial,
    Calibration,
    calibrate,
    calibration_remarks,
    check_needle,
    mean_model,
)
from needleplan.diagnosis.catalogue import DetectionLimit, FittedEffect, Library, require_base
from needleplan.diagnosis.channels import channel_description
from needleplan.diagnosis.data import CheckedData, check_data, sensor_noise
from needleplan.diagnosis.formula import GapDescription, describe_unexplained
from needleplan.diagnosis.gap import Localisation, localise
from needleplan.diagnosis.joint_fit import HeldOutValidation, JointFit
from needleplan.diagnosis.likelihood import HETEROGENEITY_SDS, LARGEST_HETEROGENEITY, Gates, JointLikelihood
from needleplan.diagnosis.selection import Selection, select_effects
from needleplan.diagnosis.selection_round import SelectionRound
from needleplan.errors import Mistake, ModelError
from needleplan.models import Estimate, Model, mean_estimate
from needleplan.models.effects import effects_of, with_effect
from needleplan.signals import UNITS, Record

__all__ = ["SCHEMA", "Diagnosis", "diagnose", "document_of"]

SCHEMA = "needleplan.diagnosis/1"

# Keys of `diagnosis.json` by attribute, for attributes that were renamed after schema 1 was published.
_KEYS = {
    "achieved": "kept", "amplitude": "size", "bic_gain": "balance", "bic_gain_heterogeneous": "balance_varied",
    "degrees_of_freedom": "freedom", "factor": "size", "held_out_difference": "elsewhere",
    "heterogeneous_above": "varied", "likelihood_gain": "gain", "predicted": "promised",
    "share_of_alternative": "share_of_rival",
}  # fmt: skip


@dataclass(frozen=True)
class Diagnosis:
    """Result of a diagnosis: where the gap is, which effects are missing, their amplitudes, and the corrected model.

    Attributes
    ----------
    decision
        The verdict, its reason (`because`), the tied effects, and the axis of an unexplained gap.
    given, calibration
        The base model as given; the base model calibrated to each trial, and the sensor noise.
    checked
        The recordings by role, and the data that are missing (`lacks`).
    selection
        All rounds with scores, fits and alternatives.
    effects
        The named effects with estimates, 95 % intervals, RMS and share of the gap.
    detection_limits, gates
        For each effect, the smallest amplitude that would have been named; the thresholds of the verdict.
    localisation, described
        Where the gap is; the shape of an unexplained gap, None if no gap is unexplained.
    remarks, digest
        Remarks on recordings and calibration; SHA-256 of model, recordings and result.

    Examples
    --------
    With `found` from the example of `diagnose`, `found.model` is the corrected model:

    >>> found.model.effects[0].name  # doctest: +SKIP
    'viscous'
    """

    decision: DiagnosisDecision
    given: Model

    checked: CheckedData
    calibration: Calibration
    selection: Selection
    effects: tuple[FittedEffect, ...]
    detection_limits: tuple[DetectionLimit, ...]
    gates: Gates
    localisation: Localisation

    described: GapDescription | None

    remarks: tuple[str, ...] = ()
    digest: str = ""

    @property
    def verdict(self) -> Verdict:
        """Verdict of the diagnosis, as `decision.verdict`."""
        return self.decision.verdict

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects, each name once even if the effect occurs at several depths or times."""
        return tuple(dict.fromkeys(each.name for each in self.effects))

    @property
    def lacks_data(self) -> bool:
        """Whether an effect was accepted, but the verdict is AMBIGUOUS and data are missing (`checked.lacks`)."""
        return self.verdict is Verdict.AMBIGUOUS and self.selection.joint is not None and bool(self.checked.lacks)

    @property
    def joint(self) -> JointFit | None:
        """The joint fit of the base model and the accepted effects; None if no effect was accepted."""
        return self.selection.joint

    @property
    def validation(self) -> HeldOutValidation | None:
        """Validation of the accepted effects on the held-out trials; None if effects or held-out trials are missing."""
        return self.selection.validation

    @property
    def base(self) -> Model:
        """The base model with its mean calibrated parameters, which were fitted jointly with `effects`, if any."""
        if not self.effects:
            return self.calibration.model
        return mean_model([trial.model for trial in self._trials], self.calibration.free)

    @property
    def _trials(self) -> tuple[CalibratedTrial, ...]:
        """The training trials with the calibrated base model, which was fitted jointly with `effects`, if any."""
        joint = self.selection.joint
        return joint.trials if joint and self.effects else self.calibration.training

    @property
    def model(self) -> Model:
        """The calibrated base model, with `effects` added if the verdict is NAMED."""
        return self.merged() if self.verdict is Verdict.NAMED else self.calibration.model

    def merged(self, *, anyway: bool = False) -> Model:
        """Return the base model with the effects that were found.

        Parameters
        ----------
        anyway
            Also add effects if the verdict is not NAMED.

        Returns
        -------
        Model
            The base model with its effects, or the base model alone if none was found.

        Raises
        ------
        ModelError
            If the verdict is not NAMED and `anyway` is false.
        """
        if self.verdict is not Verdict.NAMED and not anyway:
            rule = "only named effects are added to a model; use anyway=True (--merge-anyway) to add others"
            raise ModelError(Mistake("verdict", self.verdict, rule), "diagnosis")
        if not self.effects:
            return self.base
        return with_effect(self.base, [replace(each.added, found_by=self.digest) for each in self.effects])

    def estimates(self) -> dict[str, Estimate]:
        """Return the free parameters of the base model: the mean over the training trials and its 95 % interval.

        Returns
        -------
        dict of str to Estimate
            One estimate for each free parameter; with one training trial, its interval is the whole range.
        """
        what = self.given.parameters()
        return {
            name: mean_estimate(what[name], [getattr(trial.model, name) for trial in self._trials])
            for name in self.calibration.free
        }


def diagnose(
    model: Model,
    recordings: Sequence[Record],
    *,
    library: Library | None = None,
    gates: Gates | None = None,
    seed: int = 0,
) -> Diagnosis:
    """Find where a model and recordings disagree, and which effects the model lacks.

    Parameters
    ----------
    model
        The base model, without effects.
    recordings
        Trials with the roles train, holdout (another motion) and noise (the sensor at rest). An effect is named only
        with a noise record, a held-out trial of another motion, and at least two training trials.
    library
        Effects to look for; by default all effects of the model's channel. A library caches sensitivities: pass the
        same library for all data sets of one needle.
    gates
        Thresholds of the verdict; by default those of the channel.
    seed
        Seed of the simulated data from which p-values are computed.

    Returns
    -------
    Diagnosis
        Verdict, named effects with 95 % intervals, gap before and after, and the corrected model.

    Raises
    ------
    DataError
        If the recordings are not usable; the message lists all mistakes.
    ModelError
        If the channel of the model cannot be diagnosed or has no effects, or the model already has effects.

    Examples
    --------
    The data contain viscous friction, which the model lacks:

    >>> import numpy as np
    >>> import needleplan as npl
    >>> from needleplan.diagnosis import Library
    >>> from needleplan.models import ShaftAndTip, simulate
    >>> from needleplan.models.effects import effect_named
    >>> from needleplan.signals import Record, Role, lspb
    >>> base = ShaftAndTip(friction=0.012, cutting=0.4, onset_mm=4.0, presliding_mm=0.05)
    >>> truth = effect_named("viscous").apply(base, {"size": 3e-4})
    >>> random = np.random.default_rng(0)
    >>> def trial(name, role, depths_mm, speeds_mm_s):
    ...     motion = lspb(depths_mm, speeds_mm_s, rate_hz=50)
    ...     force = simulate(truth, motion).output + random.normal(0, 0.02, len(motion))
    ...     columns = {"time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s}
    ...     return Record({**columns, "force_n": force}, name, role)
    >>> still = {"time_s": np.arange(1000) / 50, "force_n": random.normal(0, 0.02, 1000)}
    >>> recordings = [
    ...     trial("first", Role.TRAIN, [-2, 30, 20, 60, -2], [4, 8, 6, 12]),
    ...     trial("second", Role.TRAIN, [-2, 45, 35, 60, -2], [9, 5, 3, 10]),
    ...     trial("third", Role.HOLDOUT, [-2, 20, 60, -2], [10, 4, 8]),
    ...     Record(still, "air", Role.NOISE),
    ... ]
    >>> few = Library([effect_named(name) for name in ("viscous", "stribeck", "bias")], base)
    >>> found = npl.diagnose(base, recordings, library=few)
    >>> print(found.verdict, found.names)
    named ('viscous',)
    >>> size = found.effects[0].estimates["size"]
    >>> size.low < 3e-4 < size.high
    True
    """
    gates = gates or channel_description(model.channel).gates
    library = library or Library(effects_of(model.channel), model)
    require_base(model, library)
    checked = check_needle(check_data(recordings, model.channel), model)
    calibration = calibrate(model, checked.training, checked.held_out, sensor_noise(model, checked))
    selection = select_effects(calibration, library, gates, seed=seed)
    limits = [each.noise_multiple for each in selection.detection_limits if each.visible]
    decision = decide(selection, gates, detection_limit=float(np.quantile(limits, 0.75)) if limits else float("inf"))
    decision = limit_to_data(reject_if_worse(decision, selection, calibration), checked)
    found = estimate_effects(selection) if decision.named else ()
    remarks = (*checked.remarks, *calibration_remarks(model, calibration))
    if (selection.joint.likelihood if selection.joint else selection.base).heterogeneity_sd >= HETEROGENEITY_SDS[-1]:
        remarks += (LARGEST_HETEROGENEITY,)
    # A calibrated base model may imitate the missing effect; the gap then shows only with the base model at its prior.
    held = () if decision.verdict in (Verdict.NONE, Verdict.UNDERPOWERED) else selection.at_prior
    base = JointLikelihood([trial.whitened for trial in held]) if held else selection.base
    place = localise(base, held or calibration.training, seed=seed)
    parents = "".join(sorted(each.digest or digest(each["time_s"].tobytes()) for each in recordings))
    return Diagnosis(
        decision, model, checked, calibration, selection, found, selection.detection_limits, gates,
        place, describe_unexplained(decision, selection, calibration, place, gates), remarks,
        digest(f"{model!r} {parents} {decision!r} {[each.added for each in found]!r}"),
    )  # fmt: skip


def document_of(found: Diagnosis) -> dict[str, Any]:
    """Return the content of `diagnosis.json` as a dictionary of JSON values; NaN and infinity become None."""
    decision, noise = found.decision, found.calibration.noise
    document = {
        "schema": SCHEMA,
        "made_by": f"needleplan {version()}",
        "digest": found.digest,
        "channel": str(found.given.channel),
        "unit": UNITS[found.given.channel.columns[0]],
        "model": found.given.name,
        "verdict": str(decision.verdict),
        "because": decision.because,
        "axis": str(decision.axis) if decision.axis else None,
        "tied": list(decision.tied),
        "explained": decision.explained,
        "effects": [_effect(each) for each in found.effects],
        "lacks": {str(lack): why for lack, why in found.checked.lacks.items()},
        "remarks": list(found.remarks),
        "noise": {"rms": noise.rms, "order": noise.order, "weights": noise.weights.tolist()},
        "heterogeneity": found.selection.base.heterogeneity_sd,
        "base": {name: asdict(each) for name, each in found.estimates().items()},
        "trials": [
            *(_trial(trial, "train") for trial in found.calibration.training),
            *(_trial(trial, "holdout") for trial in found.calibration.held_out),
        ],
        "held_out": _validation(found.validation) if found.validation else None,
        "steps": [_round(each) for each in found.selection.rounds],
        "where": [_entry(each) for each in found.localisation.bins],
        "changes": [_entry(each) | {"axis": str(each.axis)} for each in found.localisation.changes],
        "described": _gap_document(found.described) if found.described else None,
        "smallest": [_entry(each) for each in found.detection_limits],
        "gates": _entry(found.gates),
    }
    return dict(json_values(document))


def _effect(each: FittedEffect) -> dict[str, Any]:
    facts = ("name", "title", "family", "enters", "equation", "meaning", "source")
    return {name: str(getattr(each.effect, name)) for name in facts} | {
        "parameters": {name: asdict(value) for name, value in each.estimates.items()},
        "rms": each.rms, "share": each.share, "balance": each.bic_gain, "p_value": each.p_value,
    }  # fmt: skip


def _gap_document(each: GapDescription) -> dict[str, Any]:
    sparse = each.sparse
    return {
        "axis": str(each.axis),
        "unit": each.unit,
        "prior_sd": each.curves.prior_sd,
        "curves": [
            {name: getattr(curve, name).tolist() for name in ("places", "mean", "sd", "inside")} | {"way": curve.way}
            for curve in each.curves.curves
        ],
        "formula": [_entry(term) for term in each.formula],
        "share": sparse.share if sparse else None,
        "transfer": sparse.transfer if sparse else None,
        "alike": list(sparse.alike) if sparse else [],
    }


def _trial(trial: CalibratedTrial, role: str) -> dict[str, Any]:
    parameters = {name: getattr(trial.model, name) for name in trial.model.parameters()}
    return {
        "trial": trial.record.trial, "role": role, "samples": len(trial.record), "digest": trial.record.digest,
        "parameters": parameters, "lag_s": trial.lag_s,
    }  # fmt: skip


def _round(round_: SelectionRound) -> dict[str, Any]:
    validation = round_.ranked[0].validation if round_.ranked else None
    return {
        "stop": str(round_.outcome),
        "p_value": round_.p_value,
        "candidates": [
            {"name": each.name, "gain": each.likelihood_gain, "balance": each.bic_gain, "values": dict(each.values)}
            for each in round_.screened
        ],
        "fitted": [{"name": each.newest.name, "balance": each.newest.bic_gain} for each in round_.ranked],
        "rivals": [_entry(each) | {"axis": str(each.axis)} for each in round_.alternatives],
        "held_out": _validation(validation) if validation else None,
    }


def _validation(each: HeldOutValidation) -> dict[str, Any]:
    return _entry(each) | {"transfer": each.transfer}


def _entry(value: Any) -> dict[str, Any]:
    """Return the fields of a dataclass instance as a dictionary with the keys of the document."""
    return {_KEYS.get(name, name): each for name, each in asdict(value).items()}
