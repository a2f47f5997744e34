"""What a diagnosis says, as a value."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from needleplan.diagnosis.calibrate import Calibration, Case, pooled
from needleplan.diagnosis.check import Checked
from needleplan.diagnosis.decide import Decision
from needleplan.diagnosis.localise import Localisation
from needleplan.diagnosis.minimal import Smallest
from needleplan.diagnosis.refit import Joint
from needleplan.diagnosis.select import Selection
from needleplan.diagnosis.unknown import Described
from needleplan.diagnosis.verdict import Gates, Verdict
from needleplan.diagnosis.verify import Verified
from needleplan.errors import Mistake, ModelError
from needleplan.models import Estimate, Model
from needleplan.models.effects import AddedEffect, Effect, with_effect

__all__ = ["Diagnosis", "FoundEffect"]


@dataclass(frozen=True)
class FoundEffect:
    """An effect that was found: values with 95 % intervals, what it contributes, and its share of the gap."""

    effect: Effect
    added: AddedEffect
    rms: float
    """RMS of what it adds to the training data, in the channel's unit."""

    share: float
    """Of the sum of what each effect brings beside the others."""

    balance: float
    p_value: float | None


@dataclass(frozen=True)
class Diagnosis:
    """Where, what, how much, enough or not; and the model with what was named."""

    decision: Decision
    given: Model
    """The base as it was given."""

    checked: Checked
    calibration: Calibration
    selection: Selection
    effects: tuple[FoundEffect, ...]
    smallest: tuple[Smallest, ...]
    gates: Gates
    localisation: Localisation
    """Where the gap of the calibrated base lies."""

    described: Described | None
    """The gap that has no name, or what is left beside one."""

    remarks: tuple[str, ...] = ()
    digest: str = ""

    @property
    def verdict(self) -> Verdict:
        """How it ends."""
        return self.decision.verdict

    @property
    def names(self) -> tuple[str, ...]:
        """The effects that were named; one that is at several places has one name."""
        return tuple(dict.fromkeys(each.added.name for each in self.effects))

    @property
    def lacks_data(self) -> bool:
        """Whether something fits that these data cannot carry as a name, rather than several effects alike."""
        return self.verdict is Verdict.AMBIGUOUS and self.selection.joint is not None and bool(self.checked.lacks)

    @property
    def joint(self) -> Joint | None:
        """Base and effects, fitted together."""
        return self.selection.joint

    @property
    def verified(self) -> Verified | None:
        """How the named effects did on the held-out trials."""
        return self.selection.verified

    @property
    def base(self) -> Model:
        """The base with the mean of its calibrated parameters, beside the effects where some were named."""
        if not self.effects:
            return self.calibration.model
        return pooled([case.model for case in self._cases], self.calibration.free)

    @property
    def _cases(self) -> tuple[Case, ...]:
        """The training trials, with the base beside the effects where some were named."""
        joint = self.selection.joint
        return joint.cases if joint and self.effects else self.calibration.training

    @property
    def model(self) -> Model:
        """The calibrated base, with the effects where the verdict is NAMED."""
        return self.merged() if self.verdict is Verdict.NAMED else self.calibration.model

    def merged(self, *, anyway: bool = False) -> Model:
        """Return the base with what was found. Raises ModelError unless the verdict is NAMED, or `anyway`."""
        if self.verdict is not Verdict.NAMED and not anyway:
            rule = "only what is named is added to a model without being told to"
            raise ModelError(Mistake("verdict", self.verdict, rule), "diagnosis")
        if not self.effects:
            return self.base
        return with_effect(self.base, [replace(each.added, found_by=self.digest) for each in self.effects])

    def estimates(self) -> dict[str, Estimate]:
        """Return the base's parameters with 95 % intervals of their mean over the training trials."""
        cases = self._cases
        found = {}
        for name in self.calibration.free:
            what = self.given.parameters()[name]
            each = np.array([what.coordinate(getattr(case.model, name)) for case in cases])
            mean = float(each.mean())
            sd = float(each.std(ddof=1) / np.sqrt(len(each))) if len(each) > 1 else float("inf")
            value = float(np.clip(what.value(mean), what.lower, what.upper))
            low, high = (
                (max(what.value(mean - 2 * sd), what.lower), min(what.value(min(mean + 2 * sd, 700.0)), what.upper))
                if np.isfinite(sd) else (what.lower, what.upper)
            )  # fmt: skip
            found[name] = Estimate(value, sd * what.slope(value), low, high, what.unit, sd < 1)
        return found
