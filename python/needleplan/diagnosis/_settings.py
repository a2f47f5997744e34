"""The constants of the posterior: value, unit, effect and reason of each, in one frozen dataclass."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

from needleplan.artifacts import CallRepr
from needleplan.config import ConfigTable, Number, ruled
from needleplan.diagnosis._constants import FORMULA_SDS
from needleplan.errors import DataError

__all__ = ["Setting", "Settings"]


# Ranges of the constants by unit; those of other units are 0 or larger.
_RANGES = {"probability": Number(above=0, at_most=1 - 1e-9), "odds": Number(at_least=1), "Hz": Number("Hz", above=0)}


def _constant(value: float, unit: str, effect: str, reason: str) -> float:
    """Return a dataclass field whose metadata describe the constant."""
    declared = ruled(_RANGES.get(unit, Number(at_least=0)))
    return field(default=value, metadata={**declared.metadata, "unit": unit, "effect": effect, "reason": reason})


@dataclass(frozen=True)
class Setting(CallRepr):
    """One constant as reports print it."""

    name: str
    value: float
    unit: str
    effect: str
    reason: str


@dataclass(frozen=True)
class Settings(ConfigTable, key="Settings", error=DataError):
    """Constants of model, priors and verdict. `described` lists them with unit, effect and reason.

    Raises DataError with every value outside its range.
    """

    law_tolerance: float = _constant(
        0.07, "share of the amplitude", "standard deviation of an effect's random function of depth, time and speed",
        "formulas of the library are lumped laws, 5 to 10 % off",
    )  # fmt: skip
    law_along_axis: float = _constant(
        0.15,
        "share of the amplitude",
        "the same along the effect's own axis, such as the speed of viscous friction",
        "two usual laws of one effect, such as exponential and Gaussian Stribeck friction, differ by 10 to 30 %",
    )
    reversal_law: float = _constant(
        0.15, "share of the force swing",
        "standard deviation of the base's law of reversal, before it decays with the travel",
        "0.10 and 0.15 have the largest evidence on nulls with four other laws",
    )  # fmt: skip
    base_law: float = _constant(
        0.05, "share of the force", "standard deviation of the base's laws of friction and cutting force",
        "the largest evidence on nulls with other base laws, and half the cost of 0.1 where the laws are the model's",
    )  # fmt: skip
    entry_law: float = _constant(
        0.2, "share of the force", "standard deviation of the cutting force near the onset of the base",
        "the evidence on nulls with other base laws differs by less than 1 between 0.1 and 0.3",
    )  # fmt: skip
    trial_tolerance: float = _constant(
        0.05, "share of the amplitude", "standard deviation of an effect's amplitude between trials",
        "tissue parameters scatter between insertions",
    )  # fmt: skip
    heterogeneity: float = _constant(
        0.08, "share", "scale of the half-normal prior of the tissue's heterogeneity", "tissue varies by some percent"
    )
    any_effect: float = _constant(
        0.5, "probability", "prior of at least one missing effect", "neither answer is preferred"
    )
    further_cause: float = _constant(
        0.1, "probability",
        "prior of one more effect, if there is one already; also that of a gap that no effect of the library explains",
        "effects that the data cannot show must not dilute the others; the library lists the usual causes",
    )  # fmt: skip
    named: float = _constant(
        0.9,
        "probability",
        "marginal posterior from which an effect is named, and posterior from which nothing is missing",
        "one wrong answer in ten at the limit",
    )
    rate_hz: float = _constant(
        60.0,
        "Hz",
        "recordings are averaged to at most this rate",
        "effects act over 0.1 s and longer; time of computation",
    )
    relevant: float = _constant(
        1.0, "noise RMS", "RMS from which a missing effect matters", "smaller ones do not change a plan"
    )

    other_law: float = _constant(
        20.0, "odds", "odds from which a law of the base is said to differ from the model's",
        "one false remark in twenty at the limit",
    )  # fmt: skip
    visible_law: float = _constant(
        0.5, "noise RMS", "deviation of such a law from which a fit computes sensitivities beside it",
        "smaller deviations change the sensitivities by less than the noise",
    )  # fmt: skip

    @property
    def formula_share(self) -> float:
        """Share of another effect's gain (nats) below which an effect may be an error of its formula, equation (9)."""
        return (FORMULA_SDS * self.law_along_axis) ** 2

    def described(self) -> tuple[Setting, ...]:
        """Return every constant with unit, effect and reason."""
        return tuple(
            Setting(each.name, getattr(self, each.name), *(each.metadata[key] for key in ("unit", "effect", "reason")))
            for each in fields(self)
        )
