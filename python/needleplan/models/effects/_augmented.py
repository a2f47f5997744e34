"""A model with added effects and the origin of each effect, as stored in a model file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from needleplan.artifacts import CallRepr
from needleplan.errors import Mistake, ModelError
from needleplan.models._base import Model, WrappingModel
from needleplan.models._simulate import simulate
from needleplan.models.effects._base import SIZE, Enters
from needleplan.models.effects._tip_catalogue import effect_named
from needleplan.signals import Array, Motion

if TYPE_CHECKING:
    from needleplan.models._estimates import Estimate

__all__ = ["AddedEffect", "AugmentedModel", "with_effect"]


@dataclass(frozen=True)
class AddedEffect(CallRepr):
    """An effect with parameter values, as part of a model.

    `values` contains at least every free parameter. `estimates` holds the fitted values with intervals. `found_by` is
    the digest of the diagnosis that found the effect. The constructor raises ModelError if a value is missing, unknown
    or out of range.
    """

    name: str
    values: Mapping[str, float]
    estimates: Mapping[str, Estimate] = field(default_factory=dict)
    found_by: str = ""
    version: str = "1"

    def __post_init__(self) -> None:
        effect = effect_named(self.name)
        parameters = effect.parameters
        mistakes = [
            Mistake(key, "", f"is not a parameter of {self.name}") for key in self.values if key not in parameters
        ]
        mistakes += [
            Mistake(key, "", "is missing")
            for key, parameter in parameters.items()
            if parameter.free and key not in self.values
        ]
        values = {key: parameters[key].in_range(value) if isinstance(value, int | float) else None
                  for key, value in self.values.items() if key in parameters}  # fmt: skip
        mistakes += [
            Mistake(key, f"{self.values[key]}", parameters[key].range_rule())
            for key, near in values.items()
            if near is None
        ]
        if mistakes:
            raise ModelError(mistakes, f"effect {self.name}")
        object.__setattr__(self, "values", {key: float(near) for key, near in values.items() if near is not None})


@dataclass(frozen=True)
class AugmentedModel(WrappingModel):
    """A model with effects, in the given order; a delay of the sensor comes last, because it delays all others.

    `plant` is the same model without the effects of the sensor (`Enters.SENSOR`), which change the measurement only.
    """

    base: Model
    effects: tuple[AddedEffect, ...] = ()

    @property
    def name(self) -> str:  # type: ignore[override]
        """Kind of the base model and names of the effects, joined by "+"."""
        return "+".join([self.base.name, *(effect.name for effect in self.effects)])

    @cached_property
    def whole(self) -> Model:
        """The base model with all effects of an amplitude other than 0."""
        model = self.base
        for effect in sorted(self.effects, key=lambda added: effect_named(added.name).is_lag):
            model = effect_named(effect.name).apply(model, effect.values) if effect.values[SIZE] else model
        return model

    @cached_property
    def plant(self) -> Model:
        """The model without the effects of the sensor, which gives the true quantity instead of the measured one."""
        remaining = tuple(effect for effect in self.effects if effect_named(effect.name).enters is not Enters.SENSOR)
        return AugmentedModel(self.base, remaining) if remaining else self.base

    def initial_state(self, motion: Motion) -> Array:
        """Return the state at rest, shape (n,)."""
        return self.whole.initial_state(motion)

    def derivative(self, state: Array, motion: Motion) -> Array:
        """Return the rates of change of the state, shape (n, ...)."""
        return self.whole.derivative(state, motion)

    def output(self, state: Array, motion: Motion) -> Array:
        """Return the measured quantity in the shape of `Model.output`."""
        return self.whole.output(state, motion)

    def integrate(self, motion: Motion, start: Array) -> Array:
        """Return the states, shape (n, samples)."""
        return np.asarray(simulate(self.whole, motion, start).states)

    def values(self) -> dict[str, float]:
        """Return the parameters of the base model, and those of the effects as `effect.parameter`."""
        added = {f"{effect.name}.{key}": value for effect in self.effects for key, value in effect.values.items()}
        return self.base.values() | added


def with_effect(model: Model, added: AddedEffect | Sequence[AddedEffect]) -> AugmentedModel:
    """Return the model with one or several effects added. Raises ModelError for an effect of another channel."""
    more = (added,) if isinstance(added, AddedEffect) else tuple(added)
    wrong = [
        Mistake("effect", each.name, f"is of the channel {effect_named(each.name).channel}, not {model.channel}")
        for each in more
        if effect_named(each.name).channel is not model.channel
    ]
    if wrong:
        raise ModelError(wrong, model.name)
    if isinstance(model, AugmentedModel):
        return AugmentedModel(model.base, (*model.effects, *more))
    return AugmentedModel(model, more)
