"""A short formula for what no effect explains: products of a few terms, found one after the other (L0).

It describes, and explains nothing: other formulas that do as well are named beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from needleplan.diagnosis.calibrate import Case
from needleplan.diagnosis.space import Space
from needleplan.diagnosis.verdict import Gates
from needleplan.signals import Array, Motion

__all__ = ["Formula", "FormulaTerm", "Product", "find_formula", "grammar"]

_MOST = 3
_SHORTEST_MM = 0.6
_COARSE, _FINE = 28, 4
"""Waves: how many, and how many for each that the depth can tell apart."""


@dataclass(frozen=True)
class _Along:
    """What a formula depends on, along a motion; rows of one shape."""

    depth_mm: Array
    velocity_mm_s: Array
    sign: Array
    time_s: Array
    force_n: Array

    @classmethod
    def of(cls, motion: Motion, force: Array) -> _Along:
        rows = np.maximum(motion.depth_mm, 0.0), motion.velocity_mm_s, motion.direction, motion.time_s, force
        return cls(*(np.asarray(row, float) for row in rows))


@dataclass(frozen=True)
class Product:
    """A product of terms: an expression of Python in the names of `_Along`, and a function."""

    text: str
    function: Callable[[_Along], Array]
    places: int
    """How many numbers were looked for within it."""

    def values(self, motion: Motion, force: Array) -> Array:
        """Return it along a motion, shape (samples,); `force` is that of the model."""
        return self.function(_Along.of(motion, force))


@dataclass(frozen=True)
class FormulaTerm:
    """One product of a formula: what it is multiplied with (N, and what the product is in), and its balance."""

    text: str
    size: float
    balance: float


@dataclass(frozen=True)
class Formula:
    """A sum of products, what it gains (twice the log likelihood), and what becomes of it in another motion."""

    products: tuple[Product, ...]
    factors: tuple[float, ...]
    balances: tuple[float, ...]
    """Of each product over those before it."""

    gain: float
    share: float
    """Of what the best smooth function gains."""

    transfer: float | None
    """Kept over promised on the held-out trials; None without any."""

    alike: tuple[str, ...]
    """First products that do nearly as well."""

    @property
    def terms(self) -> tuple[FormulaTerm, ...]:
        """The products with their factors."""
        rows = zip(self.products, self.factors, self.balances, strict=True)
        return tuple(FormulaTerm(each.text, factor, balance) for each, factor, balance in rows)

    @property
    def text(self) -> str:
        """The formula, an expression of Python."""
        pairs = zip(self.factors, self.products, strict=True)
        return " + ".join(f"{factor:.6g} * {each.text}" for factor, each in pairs)

    def values(self, motion: Motion, force: Array) -> Array:
        """Return the formula along a motion, shape (samples,); `force` is that of the model."""
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
    """Return all products: a power of depth or time or the force, one of speed or a wave, with or without direction.

    Waves are as close to each other as the depth can tell apart, where `fine_waves`, or else a few; `steps_mm` and
    `steps_s` are places and times where something may begin.
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
    space: Space,
    cases: Sequence[Case],
    held_out: Sequence[Case],
    gates: Gates,
    smooth_gain: float,
    products: Sequence[Product],
) -> Formula | None:
    """Return the formula that explains most, each product through the gate of an effect; None where none passes."""
    columns = [case.whiten(_columns(products, case)) for case in cases]
    prices = np.array([1 + each.places for each in products]) * float(np.log(space.samples))
    needed = gates.balance_varied if space.level > gates.varied else gates.balance
    chosen: list[int] = []
    alike: tuple[str, ...] = ()
    level = np.array([space.level])  # that of the base: what varies is not what is looked for
    now, gain = Space(space.blocks, level), 0.0
    kept: list[float] = []
    while len(chosen) < _MOST:
        gains, _ = now.scores(columns).gains()
        balances = gains - prices
        best = int(balances.argmax())
        if balances[best] < max(needed, gates.further * gain):
            break
        if not chosen:
            near = np.flatnonzero(balances > balances[best] - gates.lead)
            alike = tuple(products[each].text for each in near[np.argsort(-balances[near])] if each != best)
        gain += float(gains[best])
        chosen.append(best)
        kept.append(float(balances[best]))
        now = Space([
            replace(block, shared=np.column_stack([block.shared, each[:, chosen]]))
            for block, each in zip(space.blocks, columns, strict=True)
        ], level)  # fmt: skip
    if not chosen:
        return None
    matrix, target = space.normal([each[:, chosen] for each in columns], space.best)
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-12))
    factors = np.linalg.solve(matrix / np.outer(scale, scale), target / scale) / scale
    taken = tuple(products[each] for each in chosen)
    share = min(gain / max(smooth_gain, 1e-12), 1.0)
    found = Formula(taken, tuple(map(float, factors)), tuple(kept), gain, share, None, alike)
    return replace(found, transfer=_transfer(found, held_out))


def _transfer(found: Formula, held_out: Sequence[Case]) -> float | None:
    if not held_out:
        return None
    space = Space([case.block for case in held_out])
    scores = space.scores([case.whiten(found.values(case.motion, case.output)[:, None]) for case in held_out])
    slope, curvature = float(scores.slope[space.best, 0]), float(scores.curvature[space.best, 0])
    return (2 * slope - curvature) / curvature if curvature > 0 else None


def _columns(products: Sequence[Product], case: Case) -> Array:
    return np.column_stack([each.values(case.motion, case.output) for each in products])


_Term = tuple[str, Callable[[_Along], Array], int]


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
