"""A diagnosis as a document: what `diagnosis.json` holds. The schema is described in docs/reference/diagnosis.md."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from needleplan.artifacts import version
from needleplan.diagnosis.calibrate import Case
from needleplan.diagnosis.diagnosis import Diagnosis, FoundEffect
from needleplan.diagnosis.step import Step
from needleplan.diagnosis.unknown import Described
from needleplan.diagnosis.verify import Verified
from needleplan.models import Estimate
from needleplan.signals import UNITS

__all__ = ["SCHEMA", "document_of"]

SCHEMA = "needleplan.diagnosis/1"


def document_of(found: Diagnosis) -> dict[str, Any]:
    """Return a diagnosis as plain values; numbers that JSON does not have are None."""
    decision = found.decision
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
        "noise": {
            "rms": found.calibration.noise.rms,
            "order": found.calibration.noise.order,
            "weights": found.calibration.noise.weights.tolist(),
        },
        "heterogeneity": found.selection.base.level,
        "base": {name: _estimate(each) for name, each in found.estimates().items()},
        "trials": [
            *(_trial(case, "train") for case in found.calibration.training),
            *(_trial(case, "holdout") for case in found.calibration.held_out),
        ],
        "held_out": _verified(found.verified) if found.verified else None,
        "steps": [_step(each) for each in found.selection.steps],
        "where": [asdict(each) for each in found.localisation.bins],
        "changes": [asdict(each) | {"axis": str(each.axis)} for each in found.localisation.changes],
        "described": _described(found.described) if found.described else None,
        "smallest": [asdict(each) for each in found.smallest],
        "gates": asdict(found.gates),
    }
    plain: dict[str, Any] = _plain(document)
    return plain


def _effect(each: FoundEffect) -> dict[str, Any]:
    effect = each.effect
    return {
        "name": effect.name,
        "title": effect.title,
        "family": str(effect.family),
        "enters": str(effect.enters),
        "equation": effect.equation,
        "meaning": effect.meaning,
        "source": effect.source,
        "parameters": {name: _estimate(value) for name, value in each.added.estimates.items()},
        "rms": each.rms,
        "share": each.share,
        "balance": each.balance,
        "p_value": each.p_value,
    }


def _described(each: Described) -> dict[str, Any]:
    sparse = each.sparse
    return {
        "axis": str(each.axis),
        "unit": each.unit,
        "prior_sd": each.curves.prior_sd,
        "curves": [
            {name: getattr(curve, name).tolist() for name in ("places", "mean", "sd", "inside")} | {"way": curve.way}
            for curve in each.curves.curves
        ],
        "formula": [asdict(term) for term in each.formula],
        "share": sparse.share if sparse else None,
        "transfer": sparse.transfer if sparse else None,
        "alike": list(sparse.alike) if sparse else [],
    }


def _estimate(each: Estimate) -> dict[str, Any]:
    return asdict(each)


def _trial(case: Case, role: str) -> dict[str, Any]:
    return {
        "trial": case.record.trial,
        "role": role,
        "samples": len(case.record),
        "digest": case.record.digest,
        "parameters": {name: getattr(case.model, name) for name in case.model.parameters()},
        "lag_s": case.lag_s,
    }


def _verified(each: Verified) -> dict[str, Any]:
    return asdict(each) | {"transfer": each.transfer}


def _step(step: Step) -> dict[str, Any]:
    return {
        "stop": str(step.stop),
        "p_value": step.p_value,
        "candidates": [
            {"name": each.effect.name, "gain": each.gain, "balance": each.balance, "values": dict(each.values)}
            for each in step.screened
        ],
        "fitted": [{"name": each.name, "balance": each.balance} for each in step.ranked],
        "rivals": [asdict(each) | {"axis": str(each.axis)} for each in step.rivals],
        "held_out": _verified(step.ranked[0].verified) if step.ranked and step.ranked[0].verified else None,
    }


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value
