"""A gap without a name, described: its course along an axis, a formula that is no physics, a file to give it a name.

The course is that of the smooth function that explains most, and says nothing beyond what the data visited.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from needleplan.diagnosis.calibrate import Case
from needleplan.diagnosis.measurand import Axis
from needleplan.diagnosis.rivals import RivalScore, bases
from needleplan.diagnosis.space import Space
from needleplan.models.effects import presliding_of
from needleplan.models.sliding import slid
from needleplan.signals import Array

__all__ = ["Described", "FormulaTerm", "describe"]

_BINS = 14
_MOST_TERMS = 3
_BALANCE = 10.0


@dataclass(frozen=True)
class FormulaTerm:
    """One product of a descriptive formula."""

    text: str
    size: float
    balance: float


@dataclass(frozen=True)
class Described:
    """The course of the gap along its axis (mean and sd in each bin), and a sparse formula."""

    axis: Axis
    unit: str
    places: tuple[float, ...]
    values: tuple[float, ...]
    sds: tuple[float, ...]
    formula: tuple[FormulaTerm, ...]

    def effect_file(self, name: str = "my_effect") -> str:
        """Return the source of an effect that works and that a person can edit: its words are still to be written."""
        terms = " + ".join(f"{each.size:.4g} * {each.text}" for each in self.formula) or "0"
        return _TEMPLATE.format(name=name, axis=self.axis, formula=terms)


def describe(space: Space, cases: Sequence[Case], rival: RivalScore) -> Described:
    """Describe the gap that the base of `space` leaves along the axis of the competitor that leads."""
    found = bases(cases)
    same = [each for name, each in found.items() if name == rival.name] or [
        each for each in found.values() if each.axis is rival.axis
    ]
    axis, unit, along = _axis(rival.axis, cases)
    places: tuple[float, ...] = ()
    values: tuple[float, ...] = ()
    sds: tuple[float, ...] = ()
    if same:
        raw = same[0].columns
        matrix, target = space.normal([c.whiten(each) for c, each in zip(cases, raw, strict=True)], space.best)
        covariance = np.linalg.pinv(matrix, rcond=1e-7, hermitian=True)
        course = np.concatenate(raw) @ (covariance @ target)
        spread = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", np.concatenate(raw), covariance, np.concatenate(raw)), 0))
        edges = np.linspace(along.min(), along.max(), _BINS + 1)
        which = np.clip(np.searchsorted(edges, along, side="right") - 1, 0, _BINS - 1)
        used = [index for index in range(_BINS) if (which == index).any()]
        places = tuple(float(along[which == index].mean()) for index in used)
        values = tuple(float(course[which == index].mean()) for index in used)
        sds = tuple(float(spread[which == index].mean()) for index in used)
    return Described(axis, unit, places, values, sds, tuple(_formula(space, cases)))


def _axis(axis: Axis, cases: Sequence[Case]) -> tuple[Axis, str, Array]:
    if axis is Axis.SPEED:
        return axis, "mm/s", np.concatenate([np.abs(case.motion.velocity_mm_s) for case in cases])
    if axis is Axis.FORCE:
        return axis, "N", np.concatenate([case.output for case in cases])
    if axis in (Axis.TIME, Axis.HOLD):
        return axis, "s", np.concatenate([case.motion.time_s for case in cases])
    return axis, "mm", np.concatenate([case.motion.depth_mm for case in cases])


def _grammar(case: Case) -> dict[str, Array]:
    """Return products of a few simple quantities, (samples,) each; scaled to be of the order of one."""
    motion = case.motion
    depth, velocity = np.clip(motion.depth_mm, 0, None), motion.velocity_mm_s
    sign = slid(motion, presliding_of(case.model))
    simple = {"1": np.ones_like(depth), "depth_mm": depth, "time_s": motion.time_s, "force_n": case.output}
    odd = {"1": np.ones_like(depth), "sign": sign, "velocity_mm_s": velocity}
    odd |= {
        f"sign * exp(-abs(velocity_mm_s) / {scale:g})": sign * np.exp(-np.abs(velocity) / scale) for scale in (1.0, 4.0)
    }
    found = {f"{a} * {b}": x * y for a, x in simple.items() for b, y in odd.items()}
    return found | {"force_n ** 2": case.output**2, "depth_mm ** 2 * sign": depth**2 * sign}


def _formula(space: Space, cases: Sequence[Case]) -> list[FormulaTerm]:
    """Return products that are taken one after the other as long as each pays for itself."""
    tables = [_grammar(case) for case in cases]
    names = list(tables[0])
    columns = [
        case.whiten(np.column_stack([each[name] for name in names])) for case, each in zip(cases, tables, strict=True)
    ]
    price, chosen, before = float(np.log(space.samples)), list[int](), 0.0
    steps: list[float] = []
    while len(chosen) < _MOST_TERMS:
        gains = [
            -np.inf if index in chosen else space.basis_gains([each[:, [*chosen, index]] for each in columns])
            for index in range(len(names))
        ]
        best = int(np.argmax(gains))
        balance = gains[best] - before - 2 * price
        if balance < _BALANCE:
            break
        chosen.append(best)
        steps.append(float(balance))
        before = gains[best]
    if not chosen:
        return []
    matrix, target = space.normal([each[:, chosen] for each in columns], space.best)
    sizes = np.linalg.lstsq(matrix, target, rcond=None)[0]
    return [FormulaTerm(names[i], float(size), step) for i, size, step in zip(chosen, sizes, steps, strict=True)]


_TEMPLATE = '''"""An effect that has no name yet: write what it is, and give it one.

Found along: {axis}. The formula describes it inside of the data, and is no physics.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from needleplan.models import Channel, Model, Parameter, parameter
from needleplan.models.effects import SIZE, Effect, Enters, Family, Term, WithTerm
from needleplan.signals import Array, Motion


@dataclass(frozen=True, kw_only=True)
class Shape(Term):
    name: ClassVar[str] = "{name}"
    order: ClassVar[int] = 0  # how many numbers it remembers
    size: float = parameter("", -100, 100, "multiple of the formula", typical=1.0)

    def initial(self, motion: Motion) -> Array:
        return np.zeros(0)

    def rate(self, state: Array, motion: Motion) -> Array:
        return state

    def states(self, motion: Motion, start: Array) -> Array:
        return np.zeros((0, len(motion)))

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:
        depth_mm, velocity_mm_s = np.maximum(motion.depth_mm, 0), np.asarray(motion.velocity_mm_s)
        time_s, sign, force_n = motion.time_s, motion.direction, plain
        return 0 * (time_s + sign + force_n + depth_mm + velocity_mm_s) + {formula}


class Found(Effect):
    name = "{name}"
    title = "to be written"
    family = Family.TISSUE
    enters = Enters.SHAFT
    channel = Channel.FORCE
    parameters: Mapping[str, Parameter] = Shape.parameters()
    equation = "{formula}"
    meaning = "to be written: what the lab would have to look for"
    source = "to be written"

    def apply(self, model: Model, values: Mapping[str, float]) -> Model:
        return WithTerm(model, Shape(**values)) if values[SIZE] else model
'''
"""What `effect_file` fills in."""
