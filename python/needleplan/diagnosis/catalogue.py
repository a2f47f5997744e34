"""The catalogue: every effect on a grid of depths, times and speeds, scored by the likelihood of the data."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from needleplan.artifacts import digest
from needleplan.diagnosis.calibration import CalibratedTrial, Calibration
from needleplan.diagnosis.likelihood import JointLikelihood
from needleplan.errors import Mistake, ModelError
from needleplan.models import Estimate, Model, Scale
from needleplan.models.effects import SIZE, AddedEffect, AugmentedModel, Effect, Reach, effect_columns
from needleplan.signals import Array, Motion

__all__ = [
    "DETECTION_NONCENTRALITY",
    "CatalogueEntry",
    "DetectionLimit",
    "FittedEffect",
    "Library",
    "allowed_amplitudes",
    "chance_probability",
    "find_detection_limits",
    "local_optima",
    "require_base",
    "screen",
    "whitened_sensitivities",
]

# Grid of base parameters for cached sensitivities: powers of this factor times the nominal value.
_PARAMETER_FACTOR = 2.0
# Factor by which the search range of a parameter exceeds its grid.
_GRID_MARGIN = 1.3
# Least and largest ratio of amplitude to reference amplitude at which a nonlinear effect's sensitivity is valid.
_AMPLITUDE_RATIOS = (0.4, 2.5)
# Ratio of squared amplitude to its variance above which an effect would be named: defines the detection limit.
DETECTION_NONCENTRALITY = 45.0
# Number of simulated data sets without an effect from which a p-value is computed.
_NULL_RUNS = 200


@dataclass(frozen=True)
class CatalogueEntry:
    """One effect with the grid of parameter values at which it is screened."""

    effect: Effect
    grid: tuple[Mapping[str, float], ...]
    first: int
    """Index of the entry's first column in the sensitivities of all entries."""

    @cached_property
    def words(self) -> str:
        """Effect and grid as text: the key of cached sensitivities."""
        return f"{self.effect.name} {self.grid}"

    @property
    def last(self) -> int:
        """Index after the entry's last column in the sensitivities of all entries (exclusive end)."""
        return self.first + len(self.grid)

    @property
    def count(self) -> int:
        """Number of parameters, the amplitude included."""
        return len(self.effect.parameters)

    @property
    def sign(self) -> int:
        """Permitted sign of the amplitude: +1, -1, or 0 if both signs are permitted."""
        what = self.effect.parameters[SIZE]
        return 1 if what.lower >= 0 else -1 if what.upper <= 0 else 0

    @property
    def has_local_optima(self) -> bool:
        """Whether fits may end in local optima: nonlinear in the amplitude, and at least two other parameters."""
        return self.count > 2 and any(SIZE in each for each in self.grid)

    def bounds(self) -> dict[str, tuple[float, float]]:
        """Return the search range of each parameter, which is slightly larger than the range of the grid.

        Left out are the amplitude, angles (which are periodic), parameters that are not on the grid, and parameters of
        the scale LINEAR with one grid value.
        """
        names = [
            name for name, what in self.effect.parameters.items()
            if name != SIZE and what.unit != "rad" and any(name in each for each in self.grid)
        ]  # fmt: skip
        found = {}
        for name in names:
            values = sorted({each[name] for each in self.grid})
            if self.effect.parameters[name].scale is Scale.LOG:
                found[name] = (values[0] / _GRID_MARGIN, values[-1] * _GRID_MARGIN)
            else:
                step = values[1] - values[0] if len(values) > 1 else 0.0
                found[name] = (values[0] - step, values[-1] + step)
        return {name: ends for name, ends in found.items() if ends[0] < ends[1]}

    def reference_amplitudes(self) -> Array:
        """Return the amplitude at which each grid point's sensitivity holds, shape (m,); NaN for linear effects."""
        return np.array([values.get(SIZE, np.nan) for values in self.grid])


@dataclass
class Library:
    """Effects to look for, with a cache of their sensitivities; recordings of the same motion share the cache."""

    effects: Sequence[Effect]
    nominal: Model
    _kept: dict[tuple[str, str], Array] = field(default_factory=dict, repr=False)

    def entries(self, motions: Sequence[Motion]) -> tuple[CatalogueEntry, ...]:
        """Return the entries of all effects that suit `nominal`, with grids over the ranges that the motions cover."""
        reach = Reach.of(motions)
        found: list[CatalogueEntry] = []
        first = 0
        for effect in self.effects:
            grid = tuple(effect.grid(reach)) if effect.suits(self.nominal) else ()
            if grid:
                found.append(CatalogueEntry(effect, grid, first))
                first += len(grid)
        return tuple(found)

    def sensitivities(self, model: Model, motion: Motion, entries: Sequence[CatalogueEntry]) -> Array:
        """Return the sensitivity of the output to the amplitude of each candidate, shape (axes * samples, m).

        The sensitivities are those of the nominal model with parameters multiplied by powers of two, to be near
        `model`. Data sets of one needle therefore use the same cached values. The returned array is read-only.
        """
        near = _rounded_model(model, self.nominal)
        rows = motion.time_s, motion.depth_mm, motion.velocity_mm_s, motion.angle_rad
        place = digest(b"".join(row.tobytes() for row in rows))
        keys = [(place, f"{near} {each.words}") for each in entries]
        whole = (place, f"{near} {' '.join(each.words for each in entries)}")
        if whole not in self._kept:
            for key, each in zip(keys, entries, strict=True):
                if key not in self._kept:
                    self._kept[key] = effect_columns(each.effect, near, motion, each.grid)
            self._kept[whole] = stacked = np.column_stack([self._kept[key] for key in keys])
            stacked.flags.writeable = False
            ends = np.cumsum([len(each.grid) for each in entries])
            self._kept |= zip(keys, np.split(stacked, ends[:-1], axis=1), strict=True)  # views of one array
        return self._kept[whole]


def require_base(model: Model, library: Library) -> None:
    """Raise ModelError if the model has effects already, or if the library is empty."""
    if isinstance(model, AugmentedModel):
        names = ", ".join(each.name for each in model.effects)
        rule = f"already has effects ({names}); diagnose its base model, or remove the effects first"
        raise ModelError(Mistake("effect", names, rule), model.name)
    if not library.effects:
        raise ModelError(Mistake("channel", model.channel, "has no effects to look for"), model.name)


def _rounded_model(model: Model, nominal: Model) -> Model:
    """Return `nominal` with its free parameters multiplied by powers of two, to be near their values in `model`."""
    values = {}
    for name, what in model.parameters().items():
        given, nominal_value = getattr(model, name), getattr(nominal, name)
        if what.free and given * nominal_value > 0:
            near = nominal_value * _PARAMETER_FACTOR ** round(
                math.log(given / nominal_value) / math.log(_PARAMETER_FACTOR)
            )
            values[name] = min(max(near, what.lower), what.upper)
    return nominal.with_values(**values)


@dataclass(frozen=True)
class FittedEffect:
    """An effect with parameter values and statistics.

    Screening sets the gains, the selection sets the p-value and the alternatives, and the verdict sets the intervals.
    """

    effect: Effect
    values: Mapping[str, float]
    """Value of each parameter, the amplitude (`SIZE`) included."""

    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Search range of parameters, which a fit does not leave: outside, the effect may act like another effect."""

    own: tuple[Mapping[str, float], ...] = ()
    """Values of the parameters of which every trial has its own, by trial; `values` holds those of the first trial."""

    likelihood_gain: float = 0.0
    """Twice the log-likelihood gain over the fit without this effect."""

    bic_gain: float = 0.0
    """`likelihood_gain` minus the BIC penalty of the effect's parameters."""

    amplitude_sd: float = math.inf
    """Linearised standard deviation of the amplitude, in its unit."""

    heterogeneity_sd: float = 0.0
    """Heterogeneity standard deviation that maximises the likelihood of the fit with this effect."""

    p_value: float | None = None
    """Probability that data without this effect reach its BIC gain, in the round that accepted it."""

    alternatives: tuple[FittedEffect, ...] = ()
    """Other effects that would explain the data equally well in place of this effect."""

    estimates: Mapping[str, Estimate] = field(default_factory=dict)
    """Parameters with 95 % intervals; empty before the verdict."""

    rms: float = 0.0
    """RMS of the effect's output in the training data, in the channel's unit."""

    share: float = 0.0
    """Ratio of this effect's likelihood gain to the sum of the gains of all effects."""

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


def screen(
    likelihood: JointLikelihood, sensitivities: Sequence[Array], entries: Sequence[CatalogueEntry]
) -> tuple[FittedEffect, ...]:
    """Return each effect at its best grid point, the largest BIC gain first.

    `sensitivities` holds one array of whitened sensitivities per trial, shape (n, m).
    """
    scored = _ScoredEntries.of(likelihood, sensitivities, entries)
    found = [scored.at(each, each.first + int(scored.gains[each.first : each.last].argmax())) for each in entries]
    return tuple(sorted(found, key=lambda each: -each.bic_gain))


def local_optima(
    likelihood: JointLikelihood,
    sensitivities: Sequence[Array],
    entries: Sequence[CatalogueEntry],
    effect: Effect,
    name: str,
) -> tuple[FittedEffect, ...]:
    """Return the best grid point of one effect for each grid value of parameter `name`, the largest BIC gain first."""
    scored = _ScoredEntries.of(likelihood, sensitivities, entries)
    each = next(each for each in entries if each.effect is effect)
    best: dict[float, int] = {}
    for index in range(each.first, each.last):
        value = each.grid[index - each.first][name]
        if value not in best or scored.gains[index] > scored.gains[best[value]]:
            best[value] = index
    return tuple(sorted((scored.at(each, index) for index in best.values()), key=lambda found: -found.bic_gain))


@dataclass(frozen=True)
class _ScoredEntries:
    """Scores of all candidates at allowed amplitudes; `rows` is the best heterogeneity index of each candidate."""

    likelihood: JointLikelihood
    curvature: Array
    amplitudes: Array
    gains: Array
    rows: Array

    @classmethod
    def of(
        cls, likelihood: JointLikelihood, sensitivities: Sequence[Array], entries: Sequence[CatalogueEntry]
    ) -> _ScoredEntries:
        scores = likelihood.scores(sensitivities)
        amplitudes = allowed_amplitudes(scores.amplitudes(), entries)
        return cls(likelihood, scores.curvature, amplitudes, *scores.gains(amplitudes))

    def at(self, each: CatalogueEntry, index: int) -> FittedEffect:
        row = int(self.rows[index])
        curvature = float(self.curvature[row, index])
        values = {**each.grid[index - each.first], SIZE: float(self.amplitudes[row, index])}
        sd = curvature**-0.5 if curvature > 0 else float("inf")
        gain = float(self.gains[index])
        return FittedEffect(
            each.effect, values, likelihood_gain=gain, bic_gain=gain - each.count * self.likelihood.bic_penalty,
            amplitude_sd=sd, heterogeneity_sd=float(self.likelihood.heterogeneity_sds[row]),
        )  # fmt: skip


def allowed_amplitudes(amplitudes: Array, entries: Sequence[CatalogueEntry]) -> Array:
    """Return the amplitudes for each heterogeneity and candidate, shape (t, m), clipped to the bounds of each effect.

    The amplitude of a nonlinear effect is set to 0 if it is far from the amplitude at which the sensitivity holds.
    """
    found = np.array(amplitudes, float)
    for each in entries:
        part = amplitudes[:, each.first : each.last]
        what = each.effect.parameters[SIZE]
        reference_amplitudes = each.reference_amplitudes()
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = part / reference_amplitudes
        least = np.where(
            reference_amplitudes > np.nanmin(reference_amplitudes, initial=np.inf), _AMPLITUDE_RATIOS[0], 0.0
        )  # small amplitudes are nearly linear
        belongs = np.isnan(reference_amplitudes) | ((ratio > least) & (ratio < _AMPLITUDE_RATIOS[1]))
        found[:, each.first : each.last] = np.where(belongs, np.clip(part, what.lower, what.upper), 0.0)
    return found


@dataclass(frozen=True)
class DetectionLimit:
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


def find_detection_limits(
    likelihood: JointLikelihood,
    raw: Sequence[Array],
    sensitivities: Sequence[Array],
    entries: Sequence[CatalogueEntry],
    noise_rms: float,
) -> tuple[DetectionLimit, ...]:
    """Return the detection limit of each effect.

    `raw` and `sensitivities` hold one array per trial: the sensitivities before and after whitening.
    """
    scores = likelihood.scores(sensitivities)
    curvature = scores.curvature[likelihood.best]
    samples = sum(map(len, raw))
    power = np.sqrt(sum(np.einsum("nm,nm->m", each, each) for each in raw) / samples)
    found = []
    for each in entries:
        part = slice(each.first, each.last)
        visible = curvature[part] > 1e-6 * samples * power[part] ** 2 / noise_rms**2
        amplitudes = np.sqrt(DETECTION_NONCENTRALITY / np.maximum(curvature[part], 1e-12))
        middle = int(np.argsort(amplitudes)[len(amplitudes) // 2])
        rms = float(amplitudes[middle] * power[part][middle])
        unit = each.effect.parameters[SIZE].unit
        found.append(
            DetectionLimit(
                each.effect.name, float(amplitudes[middle]), unit, rms, rms / noise_rms, bool(visible[middle]),
                dict(each.grid[middle]),
            )
        )  # fmt: skip
    return tuple(found)


def whitened_sensitivities(
    calibration: Calibration,
    library: Library,
    trials: Sequence[CalibratedTrial],
    entries: Sequence[CatalogueEntry],
    about: Model | None = None,
) -> list[Array]:
    """Return the whitened sensitivities of all candidates, one array per trial, shape (n, m).

    The sensitivities are computed for the model `about`, by default the calibrated model. The candidate of a lag effect
    has the sensitivity of the calibrated lag.
    """
    model = about or calibration.model
    sensitivities = [trial.whiten(library.sensitivities(model, trial.motion, entries)) for trial in trials]
    for each in entries:
        if each.effect.is_lag:  # the effect lengthens the calibrated lag; a second lag in series would differ
            for trial, whitened in zip(trials, sensitivities, strict=True):
                whitened[:, each.first] = trial.lag_sensitivity
    return sensitivities


def chance_probability(
    likelihood: JointLikelihood,
    sensitivities: Sequence[Array],
    entries: Sequence[CatalogueEntry],
    bic_gain: float,
    seed: int,
) -> float:
    """Return the probability that data without an effect reach `bic_gain` with any candidate.

    A Gumbel distribution is fitted to the largest BIC gains of 200 simulated data sets without an effect.
    """
    bic_penalty = likelihood.bic_penalty
    penalty, signs = np.full(sensitivities[0].shape[1], np.inf), np.zeros(sensitivities[0].shape[1])
    for each in entries:
        penalty[each.first : each.last], signs[each.first : each.last] = each.count * bic_penalty, each.sign
    maxima = likelihood.null_maxima(sensitivities, penalty, signs, _NULL_RUNS, seed)
    scale = float(maxima.std(ddof=1)) * np.sqrt(6) / np.pi
    place = float(maxima.mean()) - np.euler_gamma * scale
    return -math.expm1(-math.exp(min((place - bic_gain) / scale, 700.0)))
