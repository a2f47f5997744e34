"""The catalogue: every effect on a grid of depths, times and speeds, with the sensitivity of the output to it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from needleplan.artifacts import CallRepr, digest
from needleplan.diagnosis._constants import GRID_MARGIN, KEPT_BYTES, KEPT_MOTIONS, PARAMETER_FACTOR
from needleplan.errors import Mistake, ModelError
from needleplan.models import Estimate, Model, Scale
from needleplan.models.effects import (
    SIZE,
    AddedEffect,
    AugmentedModel,
    Effect,
    Reach,
    WrapEffect,
    effect_columns,
    effect_named,
)
from needleplan.signals import Array, Motion

__all__ = [
    "CatalogueEntry",
    "DetectionLimit",
    "FittedEffect",
    "Library",
    "base_of",
    "require_effects",
    "with_effects",
]


@dataclass(frozen=True)
class CatalogueEntry(CallRepr):
    """One effect with the grid of parameter values at which it is screened."""

    effect: Effect
    grid: tuple[Mapping[str, float], ...]
    first: int
    """Index of the entry's first column in the sensitivities of all entries. Equal grids share their columns."""

    @cached_property
    def words(self) -> str:
        """Phenomenon and grid as text, the key of the cached sensitivities.

        Effects that differ only in parameters with one value per trial have the same key and sensitivities.
        """
        effect = self.effect
        return f"{effect.wrapper.__name__ if isinstance(effect, WrapEffect) else effect.name} {self.grid}"

    @property
    def last(self) -> int:
        """Index after the entry's last column in the sensitivities of all entries (exclusive end)."""
        return self.first + len(self.grid)

    @property
    def sign(self) -> int:
        """Permitted sign of the amplitude: +1, -1, or 0 if both signs are permitted."""
        amplitude = self.effect.parameters[SIZE]
        return 1 if amplitude.lower >= 0 else -1 if amplitude.upper <= 0 else 0

    def excludes(self, other: Effect) -> bool:
        """Return whether another effect is the same phenomenon, such as breathing with or without a phase by trial."""
        mine = self.effect
        both = isinstance(mine, WrapEffect) and isinstance(other, WrapEffect) and mine.wrapper is other.wrapper
        return both and mine.name != other.name

    def bounds(self) -> dict[str, tuple[float, float]]:
        """Return the search range of each parameter, which is slightly larger than the range of the grid.

        Left out are the amplitude, angles (which are periodic), parameters that are not on the grid, and parameters of
        the scale LINEAR with one grid value.
        """
        names = [
            name for name, parameter in self.effect.parameters.items()
            if name != SIZE and parameter.unit != "rad" and any(name in point for point in self.grid)
        ]  # fmt: skip
        ranges = {}
        for name in names:
            values = sorted({point[name] for point in self.grid})
            if self.effect.parameters[name].scale is Scale.LOG:
                ranges[name] = (values[0] / GRID_MARGIN, values[-1] * GRID_MARGIN)
            else:
                step = values[1] - values[0] if len(values) > 1 else 0.0
                ranges[name] = (values[0] - step, values[-1] + step)
        return {name: ends for name, ends in ranges.items() if ends[0] < ends[1]}


@dataclass
class Library(CallRepr):
    """Effects to look for, with a cache of their sensitivities; recordings of the same motion share the cache.

    Above a gigabyte, the cache forgets the motions that were used longest ago.
    """

    effects: Sequence[Effect]
    nominal: Model
    _kept: dict[str, dict[str, Array]] = field(default_factory=dict, repr=False)  # by motion, then by effect

    def entries(self, motions: Sequence[Motion]) -> tuple[CatalogueEntry, ...]:
        """Return the catalogue entries of all effects that can be added to the nominal base model.

        The parameter grid of an entry spans the depths, speeds and times of the motions. Entries with the same
        phenomenon and the same grid share their sensitivity columns.
        """
        reach = Reach.of(motions)
        found: dict[str, CatalogueEntry] = {}
        every: list[CatalogueEntry] = []
        for effect in self.effects:
            grid = tuple(effect.grid(reach)) if effect.suits(self.nominal) else ()
            if grid:
                entry = CatalogueEntry(effect, grid, sum(len(each.grid) for each in found.values()))
                first = found.setdefault(entry.words, entry).first
                every.append(replace(entry, first=first))
        return tuple(every)

    def sensitivities(self, model: Model, motion: Motion, entries: Sequence[CatalogueEntry]) -> Array:
        """Return the sensitivity of the output to the amplitude of each candidate.

        The sensitivities are those of the nominal model with parameters multiplied by powers of two, to be near
        `model`. Data sets of one needle therefore use the same cached values.

        Parameters
        ----------
        model
            Base model near which the sensitivities hold.
        motion
            Motion of the needle, of `samples` samples.
        entries
            Effects with their grids, from `entries`; together they have m columns.

        Returns
        -------
        Array
            Change of the output per amplitude of each column, shape (axes * samples, m), in units of the channel per
            unit of the amplitude. Read-only.

        Examples
        --------
        >>> from needleplan.diagnosis import Library
        >>> from needleplan.models import ShaftAndTip
        >>> from needleplan.models.effects import effect_named
        >>> from needleplan.signals import insertion_cycles
        >>> base = ShaftAndTip(friction=0.012, cutting=0.4, onset_mm=4.0, presliding_mm=0.05)
        >>> library, motion = Library([effect_named("bias")], base), insertion_cycles(50.0, 5.0)
        >>> bool((library.sensitivities(base, motion, library.entries([motion])) == 1).all())
        True
        """
        near = _rounded_model(model, self.nominal)
        rows = motion.time_s, motion.depth_mm, motion.velocity_mm_s, motion.angle_rad
        place = digest(b"".join(row.tobytes() for row in rows))
        entries = list({entry.first: entry for entry in entries}.values())
        keys = [f"{near} {entry.words}" for entry in entries]
        whole = " ".join(keys)
        kept = self._kept[place] = self._kept.pop(place, {})  # the motion that was used last is the last one
        if whole not in kept:
            for key, each in zip(keys, entries, strict=True):
                if key not in kept:
                    kept[key] = effect_columns(each.effect, near, motion, each.grid)
            kept[whole] = stacked = np.column_stack([kept[key] for key in keys])
            stacked.flags.writeable = False
            ends = np.cumsum([len(entry.grid) for entry in entries])
            kept |= zip(keys, np.split(stacked, ends[:-1], axis=1), strict=True)  # views of one array
            self._forget()
        return kept[whole]

    def _forget(self) -> None:
        """Forget motions until the cache is small enough, or has those of one diagnosis."""
        arrays = [(place, array) for place, kept in self._kept.items() for array in kept.values() if array.base is None]
        size = sum(array.nbytes for _, array in arrays)
        for place in [*self._kept][:-KEPT_MOTIONS]:
            if size <= KEPT_BYTES:
                break
            size -= sum(array.nbytes for other, array in arrays if other == place)
            del self._kept[place]


def base_of(model: Model) -> tuple[Model, tuple[FittedEffect, ...]]:
    """Return the model without its effects, and these effects with their values."""
    if not isinstance(model, AugmentedModel):
        return model, ()
    effects = [FittedEffect(effect_named(effect.name), effect.values, given=True) for effect in model.effects]
    return model.base, tuple(effects)


def require_effects(model: Model, library: Library) -> None:
    """Raise ModelError if the library is empty."""
    if not library.effects:
        raise ModelError(Mistake("channel", model.channel, "has no effects to look for"), model.name)


def _rounded_model(model: Model, nominal: Model) -> Model:
    """Return `nominal` with its free parameters multiplied by powers of two, to be near their values in `model`."""
    values = {}
    for name, what in model.parameters().items():
        given, nominal_value = getattr(model, name), getattr(nominal, name)
        if what.free and given * nominal_value > 0:
            near = nominal_value * PARAMETER_FACTOR ** round(
                math.log(given / nominal_value) / math.log(PARAMETER_FACTOR)
            )
            values[name] = min(max(near, what.lower), what.upper)
    return nominal.with_values(**values)


@dataclass(frozen=True)
class FittedEffect(CallRepr):
    """An effect with parameter values; a diagnosis adds estimates, RMS and share."""

    effect: Effect
    values: Mapping[str, float]
    """Value of each parameter, the amplitude (`SIZE`) included."""

    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Search range of parameters, which a fit does not leave: outside, the effect may act like another effect."""

    own: tuple[Mapping[str, float], ...] = ()
    """By trial, the parameters with a separate value for every trial; `values` holds the values of the first trial."""

    estimates: Mapping[str, Estimate] = field(default_factory=dict)
    """Parameters with 95 % intervals."""

    rms: float = 0.0
    """RMS of the effect's output in all trials, in the channel's unit."""

    share: float = 0.0
    """Squared amplitude in standard deviations, as a share of the sum over all effects."""

    given: bool = False
    """Whether the given model has the effect already: it is then in every hypothesis, and in the references too."""

    def in_trial(self, number: int) -> FittedEffect:
        """Return the effect with the values of one trial; a trial that was not fitted has those of the first one."""
        return replace(self, values={**self.values, **dict(*self.own[number : number + 1])}, own=())

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.effect.name

    @property
    def added(self) -> AddedEffect:
        """The effect in the form that model files store."""
        return AddedEffect(self.effect.name, self.values, self.estimates, "", self.effect.version)


@dataclass(frozen=True)
class DetectionLimit(CallRepr):
    """Detection limit of an effect: the amplitude above which it would be named at half of its grid points."""

    effect: str
    amplitude: float
    unit: str
    rms: float
    """RMS of the effect's output in the training data at this amplitude, in the channel's unit."""

    noise_multiple: float  # `rms` in units of the noise RMS
    visible: bool
    """Whether the effect is visible; False if the base model absorbs it."""

    at: Mapping[str, float]
    """Grid point for which the limit holds."""


def with_effects(model: Model, effects: Sequence[FittedEffect]) -> Model:
    """Return the model with the effects added, a delay of the sensor last: it delays all that the sensor sees."""
    for effect in sorted(effects, key=lambda each: each.effect.is_lag):
        model = effect.effect.apply(model, effect.values)
    return model
