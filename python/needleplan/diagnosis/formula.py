"""Description of a gap that no effect explains: its curves, and a sparse formula found by greedy selection.

The formula is a sum of products of elementary terms. The formula describes the gap, but states no cause. Products that
fit nearly as well are listed too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from needleplan.diagnosis._verdict import DiagnosisDecision, Verdict
from needleplan.diagnosis.alternatives import AlternativeModel
from needleplan.diagnosis.calibration import CalibratedTrial, Calibration
from needleplan.diagnosis.channels import GapAxis
from needleplan.diagnosis.gap import Curve, Curves, Localisation, curves_along, localise
from needleplan.diagnosis.likelihood import Gates, JointLikelihood
from needleplan.diagnosis.selection import Selection
from needleplan.models import Channel
from needleplan.signals import Array, Motion

__all__ = [
    "Formula",
    "FormulaTerm",
    "GapDescription",
    "Product",
    "describe_gap",
    "describe_unexplained",
    "find_formula",
    "grammar",
]

# Largest number of products in a formula.
_MOST = 3
# Shortest wavelength (mm) of a wave along the depth.
_SHORTEST_MM = 0.6
# Number of wavelengths on the coarse grid; on the fine grid, number of wavelengths per resolvable one.
_COARSE, _FINE = 28, 4


@dataclass(frozen=True)
class _Along:
    """Variables of a formula along a motion, each of shape (samples,)."""

    depth_mm: Array
    velocity_mm_s: Array
    sign: Array
    time_s: Array
    force_n: Array

    @classmethod
    def of(cls, motion: Motion, force: Array) -> _Along:
        rows = np.maximum(motion.depth_mm, 0.0), motion.velocity_mm_s, motion.direction, motion.time_s, force
        return cls(*(np.asarray(row, float) for row in rows))


# A term: Python expression, function, and number of parameters that were searched.
_Term = tuple[str, Callable[[_Along], Array], int]


@dataclass(frozen=True)
class Product:
    """A product of terms, as a function and as a Python expression (`text`) in the attributes of `_Along`."""

    text: str
    function: Callable[[_Along], Array]
    places: int
    """Number of parameters within the product that were searched, such as a wavelength."""

    def values(self, motion: Motion, force: Array) -> Array:
        """Return the value of the product at each sample, shape (samples,); `force` is the output of the model."""
        return self.function(_Along.of(motion, force))


@dataclass(frozen=True)
class FormulaTerm:
    """One product of a formula, with its factor (N per unit of the product) and its BIC gain."""

    text: str
    factor: float
    bic_gain: float


@dataclass(frozen=True)
class Formula:
    """A sum of products, with its likelihood gain and its success on the held-out trials."""

    products: tuple[Product, ...]
    factors: tuple[float, ...]
    bic_gains: tuple[float, ...]
    """BIC gain of each product over the products before it."""

    likelihood_gain: float
    share: float
    """Ratio of `likelihood_gain` to the gain of the best smooth alternative, at most 1."""

    transfer: float | None
    """Ratio of achieved to predicted gain on the held-out trials; None without held-out trials or predicted gain."""

    alike: tuple[str, ...]
    """Expressions of other products that fit nearly as well as the first product."""

    @property
    def terms(self) -> tuple[FormulaTerm, ...]:
        """The products with their factors and BIC gains."""
        rows = zip(self.products, self.factors, self.bic_gains, strict=True)
        return tuple(FormulaTerm(each.text, factor, bic_gain) for each, factor, bic_gain in rows)

    @property
    def text(self) -> str:
        """The formula as a Python expression."""
        pairs = zip(self.factors, self.products, strict=True)
        return " + ".join(f"{factor:.6g} * {each.text}" for factor, each in pairs)

    def values(self, motion: Motion, force: Array) -> Array:
        """Return the value of the formula (N) at each sample, shape (samples,); `force` is the output of the model."""
        parts = [factor * each.values(motion, force) for factor, each in zip(self.factors, self.products, strict=True)]
        return np.asarray(sum(parts), float)


def grammar(
    deepest_mm: float,
    fastest_mm_s: float,
    *,
    fine_waves: bool = False,
    steps_mm: Sequence[float] = (),
    steps_s: Sequence[float] = (),
) -> tuple[Product, ...]:
    """Return all candidate products of a formula.

    A product is a power of depth or time, or the force, times a function of speed; or a wave along the depth, alone or
    times depth; or a step. Each product exists with and without the sign of the velocity. With `fine_waves` the
    wavelengths are as close as the depth range resolves, and waves times depth are left out. `steps_mm` and `steps_s`
    are depths and times of steps.
    """
    one: _Term = ("1", lambda u: np.ones_like(u.depth_mm), 0)
    amounts: list[_Term] = [
        one,
        ("depth_mm", lambda u: u.depth_mm, 0),
        ("depth_mm**2", lambda u: u.depth_mm**2, 0),
        ("force_n", lambda u: u.force_n, 0),
        ("time_s", lambda u: u.time_s, 0),
        ("time_s**2", lambda u: u.time_s**2, 0),
    ]
    rates: list[_Term] = [one, ("abs(velocity_mm_s)", lambda u: np.abs(u.velocity_mm_s), 0)]
    rates += [_slow(float(f"{part * fastest_mm_s:.3g}")) for part in (0.05, 0.1, 0.2, 0.4)]
    count = int(_FINE * deepest_mm / _SHORTEST_MM) if fine_waves else _COARSE
    lengths = 1 / np.linspace(1.5 / deepest_mm, 1 / _SHORTEST_MM, count)
    waves = [_wave(name, float(f"{length:.5g}")) for name, length in product(("sin", "cos"), lengths)]
    steps = [*(_step("depth_mm", place) for place in steps_mm), *(_step("time_s", moment) for moment in steps_s)]
    ways: list[_Term] = [one, ("sign", lambda u: u.sign, 0)]
    amounts_of_waves = amounts[:1] if fine_waves else amounts[:2]
    rows = [*product(amounts, rates, ways), *product(amounts_of_waves, waves, ways), *product([one], steps, ways)]
    return tuple(_product(each) for each in rows)


def find_formula(
    likelihood: JointLikelihood,
    trials: Sequence[CalibratedTrial],
    held_out: Sequence[CalibratedTrial],
    gates: Gates,
    smooth_gain: float,
    products: Sequence[Product],
) -> Formula | None:
    """Return a formula of at most three products; None if no product has the BIC gain that an effect needs.

    The product with the largest BIC gain is added first. `smooth_gain` is the likelihood gain of the best smooth
    alternative.
    """
    sensitivities = [trial.whiten(_product_values(products, trial)) for trial in trials]
    bic_penalties = np.array([1 + each.places for each in products]) * float(np.log(likelihood.samples))
    needed = gates.bic_gain_heterogeneous if likelihood.heterogeneity_sd > gates.heterogeneous_above else gates.bic_gain
    chosen: list[int] = []
    alike: tuple[str, ...] = ()
    heterogeneity_sd = np.array([likelihood.heterogeneity_sd])  # held at the base model's heterogeneity
    now, likelihood_gain = JointLikelihood(likelihood.blocks, heterogeneity_sd), 0.0
    product_gains: list[float] = []
    while len(chosen) < _MOST:
        gains, _ = now.scores(sensitivities).gains()
        bic_gains = gains - bic_penalties
        best = int(bic_gains.argmax())
        if bic_gains[best] < max(needed, gates.further * likelihood_gain):
            break
        if not chosen:
            near = np.flatnonzero(bic_gains > bic_gains[best] - gates.lead)
            alike = tuple(products[each].text for each in near[np.argsort(-bic_gains[near])] if each != best)
        likelihood_gain += float(gains[best])
        chosen.append(best)
        product_gains.append(float(bic_gains[best]))
        now = JointLikelihood([
            replace(whitened, shared=np.column_stack([whitened.shared, each[:, chosen]]))
            for whitened, each in zip(likelihood.blocks, sensitivities, strict=True)
        ], heterogeneity_sd)  # fmt: skip
    if not chosen:
        return None
    matrix, target = likelihood.normal([each[:, chosen] for each in sensitivities], likelihood.best)
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-12))
    factors = np.linalg.solve(matrix / np.outer(scale, scale), target / scale) / scale
    taken = tuple(products[each] for each in chosen)
    share = min(likelihood_gain / max(smooth_gain, 1e-12), 1.0)
    found = Formula(taken, tuple(map(float, factors)), tuple(product_gains), likelihood_gain, share, None, alike)
    return replace(found, transfer=_transfer(found, held_out))


def _transfer(found: Formula, held_out: Sequence[CalibratedTrial]) -> float | None:
    """Return `Formula.transfer`, from the held-out trials."""
    if not held_out:
        return None
    likelihood = JointLikelihood([trial.whitened for trial in held_out])
    scores = likelihood.scores([trial.whiten(found.values(trial.motion, trial.output)[:, None]) for trial in held_out])
    slope, curvature = float(scores.slope[likelihood.best, 0]), float(scores.curvature[likelihood.best, 0])
    return (2 * slope - curvature) / curvature if curvature > 0 else None


def _product_values(products: Sequence[Product], trial: CalibratedTrial) -> Array:
    return np.column_stack([each.values(trial.motion, trial.output) for each in products])


def _slow(speed: float) -> _Term:
    return f"exp(-abs(velocity_mm_s) / {speed:g})", lambda u: np.exp(-np.abs(u.velocity_mm_s) / speed), 1


def _wave(name: str, length: float) -> _Term:
    wave = np.sin if name == "sin" else np.cos
    return f"{name}(2 * pi * depth_mm / {length:g})", lambda u: np.asarray(wave(2 * np.pi * u.depth_mm / length)), 1


def _step(of: str, place: float) -> _Term:
    return f"({of} > {place:g})", lambda u: np.asarray(getattr(u, of) > place, float), 1


def _product(parts: Sequence[_Term]) -> Product:
    text = " * ".join(part[0] for part in parts if part[0] != "1") or "1"

    def function(u: _Along) -> Array:
        found = np.ones_like(u.depth_mm)
        for part in parts:
            found = found * part[1](u)
        return found

    return Product(text, function, sum(part[2] for part in parts))


@dataclass(frozen=True)
class GapDescription:
    """A gap along its axis, as curves and, if a formula passes the gates, as a formula (`sparse`)."""

    axis: GapAxis
    curves: Curves
    sparse: Formula | None
    rms: float
    """RMS (N) of the formula in the training data; without a formula, of the curves at visited nodes; 1 if it is 0."""

    @property
    def unit(self) -> str:
        """Unit of the axis."""
        return self.curves.unit

    @property
    def main(self) -> Curve:
        """The curve with the largest ratio of mean to standard deviation at a visited node."""
        return max(self.curves.curves, key=lambda each: float((np.abs(each.mean / each.sd) * each.inside).max()))

    @property
    def places(self) -> tuple[float, ...]:
        """Values of the axis variable at the visited nodes of the main curve."""
        return tuple(map(float, self.main.places[self.main.inside]))

    @property
    def values(self) -> tuple[float, ...]:
        """Mean (N) of the main curve at `places`."""
        return tuple(map(float, self.main.mean[self.main.inside]))

    @property
    def sds(self) -> tuple[float, ...]:
        """Standard deviation (N) of the main curve at `places`."""
        return tuple(map(float, self.main.sd[self.main.inside]))

    @property
    def formula(self) -> tuple[FormulaTerm, ...]:
        """The products of the formula; empty without a formula."""
        return self.sparse.terms if self.sparse else ()


def describe_gap(
    likelihood: JointLikelihood,
    trials: Sequence[CalibratedTrial],
    held_out: Sequence[CalibratedTrial],
    alternative: AlternativeModel,
    place: Localisation,
    gates: Gates,
) -> GapDescription:
    """Describe the gap that the model of `likelihood` leaves, along the axis of `alternative`.

    `held_out` holds the trials that validate the formula, calibrated with the same model; empty to skip validation.
    """
    products = grammar(
        max(5.0, *(float(trial.motion.depth_mm.max()) for trial in trials)),
        max(float(np.abs(trial.motion.velocity_mm_s).max()) for trial in trials),
        fine_waves=alternative.axis is GapAxis.PERIOD,
        steps_mm=[each.place for each in place.changes if each.axis is GapAxis.DEPTH],
        steps_s=[each.place for each in place.changes if each.axis is GapAxis.TIME],
    )
    formula = find_formula(likelihood, trials, held_out, gates, alternative.likelihood_gain, products)

    def normal(basis: Sequence[Array]) -> tuple[Array, Array]:
        whitened = [trial.whiten(each) for trial, each in zip(trials, basis, strict=True)]
        return likelihood.normal(whitened, likelihood.best)

    curves = curves_along(alternative.axis, trials, normal)
    if formula is not None:
        rows = np.concatenate([formula.values(trial.motion, trial.output) for trial in trials])
    else:
        rows = np.concatenate([each.mean[each.inside] for each in curves.curves])
    return GapDescription(alternative.axis, curves, formula, float(np.sqrt(np.mean(rows**2))) or 1.0)


def describe_unexplained(
    decision: DiagnosisDecision, selection: Selection, calibration: Calibration, place: Localisation, gates: Gates
) -> GapDescription | None:
    """Return the description of a gap that no effect explains.

    Returns None if the verdict is neither UNKNOWN nor INCOMPLETE, or the channel is not the force.
    """
    if calibration.given.channel is not Channel.FORCE:  # formulas describe forces only
        return None
    if decision.verdict is Verdict.UNKNOWN:
        alternative = selection.rounds[0].alternatives[0]
        return describe_gap(selection.base, calibration.training, calibration.held_out, alternative, place, gates)
    if decision.verdict is Verdict.INCOMPLETE and selection.joint:
        alternative, joint = selection.rounds[-1].alternatives[0], selection.joint
        place = localise(joint.likelihood, joint.trials)
        return describe_gap(joint.likelihood, joint.trials, (), alternative, place, gates)
    return None
