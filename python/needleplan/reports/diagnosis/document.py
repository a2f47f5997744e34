"""The content of `diagnosis.json` (schema: docs/reference/diagnosis.schema.json) and of `traces.h5`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from needleplan.artifacts import FORMATS, FileKind, digest, json_values, version
from needleplan.diagnosis import Curves, Diagnosis, FittedEffect, NextTrials, ranked_hypotheses
from needleplan.models import Model
from needleplan.reports.diagnosis.motion_file import motion_files
from needleplan.reports.diagnosis.traces import TrialTrace, trace_bytes, traces_of
from needleplan.reports.diagnosis.words import advice, answer, title_of
from needleplan.signals import UNITS, Role

__all__ = ["MOST_HYPOTHESES", "SCHEMA", "document_of", "held_out_rms", "whole_document"]

SCHEMA = FORMATS[FileKind.DIAGNOSIS]
"""Key `schema` of `diagnosis.json`."""

MOST_HYPOTHESES = 12
"""Number of hypotheses in document and report; "nothing" may be a further one."""


def whole_document(found: Diagnosis, next_: NextTrials | None) -> tuple[dict[str, Any], bytes]:
    """Return the content of `diagnosis.json`, and that of `traces.h5`, whose digest the document holds."""
    traces = traces_of(found)
    content = trace_bytes(found.given.channel, found.digest, traces, next_.motions[0].motion if next_ else None)
    document = document_of(found, traces, next_)
    return document | {"traces": {"file": "traces.h5", "digest": digest(content)}}, content


def document_of(found: Diagnosis, traces: Sequence[TrialTrace], next_: NextTrials | None) -> dict[str, Any]:
    """Return the content of `diagnosis.json` without the key `traces`; NaN and infinity become None."""
    decision, noise, best, budget = found.decision, found.calibration.noise, found.named, found.budget
    document = {
        "schema": SCHEMA,
        "made_by": f"needleplan {version()}",
        "digest": found.digest,
        "channel": str(found.given.channel),
        "unit": UNITS[found.given.channel.columns[0]],
        "model": found.given.name,
        "verdict": str(found.verdict),
        "because": decision.because,
        "probability": decision.probability,
        "names": list(found.names),
        "axis": str(decision.axis) if decision.axis else None,
        "tied": [list(each) for each in decision.tied],
        "family": list(decision.family),
        "hypotheses": [
            {**asdict(hypothesis), "words": hypothesis.words}
            for hypothesis in ranked_hypotheses(found, MOST_HYPOTHESES)
        ],
        "effects": [_effect(found, effect) for effect in found.effects],
        "likely": [_effect(found, each) for each in found.likely],
        "lacks": {str(lack): why for lack, why in found.checked.lacks.items()},
        "remarks": list(found.remarks),
        "budget": {
            "unit": budget.unit, "noise_rms": budget.noise_rms, "trials": budget.trials,
            **{name: [asdict(stage) for stage in budget.stages(role)]
               for name, role in (("all", ""), ("training", "train"), ("held_out", "holdout"))},
        },
        "findings": [asdict(finding) for finding in found.findings],
        "parameters": [asdict(parameter) for parameter in found.parameters],
        "noise": {"rms": noise.rms, "order": noise.order, "weights": noise.weights.tolist(),
                  "variance_ratio": best.noise_variance},
        "heterogeneity": found.heterogeneity,
        "tissue": found.tissue,
        "base": {name: asdict(each) for name, each in found.estimates().items()},
        "trials": [
            {
                "trial": trial.record.trial, "role": str(trace.role),
                "samples": len(trial.record), "digest": trial.record.digest,
                "parameters": {name: getattr(trial.model, name) for name in trial.model.parameters()},
                "lag_s": trial.lag_s,
            }
            for trial, trace in zip(best.trials, traces, strict=True)
        ],
        "held_out": held_out_rms(found),
        "where": [asdict(each) for each in found.where],
        "described": _course(found.course) if found.course else None,
        "smallest": [asdict(limit) for limit in found.detection_limits],
        "next_motion": _next(next_, found.given) if next_ else None,
        "settings": [asdict(each) for each in found.settings.described()],
        "words": {"title": title_of(found), "answer": list(answer(found)), "advice": list(advice(found, next_))},
    }  # fmt: skip
    return dict(json_values(document))


def held_out_rms(found: Diagnosis) -> dict[str, float] | None:
    """Return residual RMS of the held-out trials before and after, that of the noise, and the closed share of the gap.

    The first two are those of the gap budget, after other parameters and after the effects. None without held-out
    trials or effects. The share is of effects that were fitted to the training trials alone.
    """
    stages = {stage.name: stage.rms for stage in found.budget.stages(Role.HOLDOUT)}
    if not found.shows_effects or "effects" not in stages:
        return None
    return {
        "before_rms": stages["parameters"], "after_rms": stages["effects"],
        "floor_rms": found.calibration.noise.rms, "shrink": found.shrink,
    }  # fmt: skip


def _effect(found: Diagnosis, each: FittedEffect) -> dict[str, Any]:
    facts = ("name", "title", "family", "enters", "equation", "meaning", "source")
    return {name: str(getattr(each.effect, name)) for name in facts} | {
        "parameters": {name: asdict(value) for name, value in each.estimates.items()},
        "rms": each.rms, "share": each.share, "probability": found.marginals.get(each.name, 0.0),
    }  # fmt: skip


def _course(course: Curves) -> dict[str, Any]:
    return {
        "axis": str(course.axis), "unit": course.unit, "prior_sd": course.prior_sd,
        "curves": [
            {name: getattr(curve, name).tolist() for name in ("places", "mean", "sd", "inside")} | {"way": curve.way}
            for curve in course.curves
        ],
    }  # fmt: skip


def _next(next_: NextTrials, model: Model) -> dict[str, Any]:
    files = motion_files(next_, model)
    return {
        "question": next_.question, "why": next_.why, "role": str(next_.role), "bits": next_.bits,
        "repeated_bits": next_.repeated_bits, "open_bits": next_.open_bits,
        "motions": [
            {"name": motion.name, "about": motion.about,
             "file": files[motion.name].name if motion.name in files and files[motion.name].text else None,
             "problem": files[motion.name].problem if motion.name in files else "",
             "duration_s": float(motion.motion.time_s[-1] - motion.motion.time_s[0])}
            for motion in next_.motions
        ],
        "considered": [{"name": name, "bits": bits} for name, bits in next_.considered],
    }  # fmt: skip
