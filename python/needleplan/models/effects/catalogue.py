"""The effects of the axial force: what each means, and where it is looked for."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from needleplan.errors import Mistake, ModelError
from needleplan.models.base import Channel, Model
from needleplan.models.effects import cutting, sensor, shaft
from needleplan.models.effects.base import SIZE, Effect, Enters, Family, Reach, Term, WithTerm
from needleplan.models.effects.lagging import Lagging
from needleplan.models.effects.tissue import BreathingTissue, GivingTissue, SlowTurning, breathing_forces
from needleplan.models.insertion import ShaftAndTip
from needleplan.models.parameter import Parameter, parameters_of
from needleplan.models.simulate import simulate
from needleplan.signals import Array, Motion

__all__ = ["FORCE_EFFECTS", "TermEffect", "WrapEffect", "presliding_of"]

Grid = Callable[[Reach], Mapping[str, Sequence[float] | Array] | Sequence[Mapping[str, float]]]
"""The axes of a grid, or all of its places."""

Nearby = Callable[[Mapping[str, float], Reach, float], list[dict[str, float]]]
_THESIS = "Needle steering thesis, "


@dataclass(frozen=True)
class _Described(Effect):
    """The words of an effect, and its grid as a function of what the motions visit."""

    name: str
    title: str
    family: Family
    enters: Enters
    equation: str
    meaning: str
    source: str
    looked_for: Grid = lambda reach: {}  # noqa: ARG005
    tried: Nearby = lambda values, reach, scale: []  # noqa: ARG005
    channel: Channel = Channel.FORCE
    repeats: bool = False
    is_lag: bool = False
    beside: tuple[type[Model], ...] = ()
    """The models that it can be added to; empty for any."""

    def suits(self, model: Model) -> bool:
        """Whether it can be added to a model."""
        inner = model
        while not isinstance(inner, self.beside) and hasattr(inner, "base"):
            inner = inner.base
        return not self.beside or isinstance(inner, self.beside)

    def grid(self, reach: Reach) -> list[dict[str, float]]:
        """Return the product of the axes of the grid."""
        axes = self.looked_for(reach)
        if not isinstance(axes, Mapping):
            return [dict(each) for each in axes]
        return [dict(zip(axes, map(float, each), strict=True)) for each in product(*axes.values())]

    def nearby(self, values: Mapping[str, float], reach: Reach, scale: float) -> list[dict[str, float]]:
        """Return what to try, within the bounds of the parameters."""
        bounds = self.parameters
        return [
            {name: min(max(value, bounds[name].lower), bounds[name].upper) for name, value in each.items()}
            for each in self.tried(values, reach, scale)
        ]


@dataclass(frozen=True)
class TermEffect(_Described):
    """An effect that is a term."""

    term: type[Term] = cutting.Puncture

    @property
    def parameters(self) -> Mapping[str, Parameter]:  # type: ignore[override]
        """Size, and where, when or how fast."""
        return {name: what for name, what in self.term.parameters().items() if what.free}

    def apply(self, model: Model, values: Mapping[str, float]) -> Model:
        """Return the model with the term; the model itself at size 0."""
        return WithTerm(model, self._term(model, values)) if values.get(SIZE, 0.0) else model

    def columns(self, model: Model, motion: Motion, grid: Sequence[Mapping[str, float]]) -> Array:
        """Return the shape of the term; the same memories are integrated once."""
        plain = simulate(model, motion).output
        memories: dict[tuple[float, ...], Array] = {}
        found = np.empty((len(motion), len(grid)))
        for index, values in enumerate(grid):
            term = self._term(model, {**values, SIZE: 1.0})
            key = tuple(values[name] for name in _REMEMBERED.get(self.name, ()))
            if key not in memories:
                memories[key] = term.states(motion, term.initial(motion))
            found[:, index] = term.shape(memories[key], motion, plain)
        return found

    def _term(self, model: Model, values: Mapping[str, float]) -> Term:
        constants = (name for name, what in self.term.parameters().items() if not what.free)
        known = {name: _of_base(model, name) for name in constants}
        return self.term(**{name: value for name, value in known.items() if value is not None}, **values)


_REMEMBERED = {
    "relaxation": ("time_s", "recovery_mm"),
}
"""The parameters on which a memory depends."""


@dataclass(frozen=True)
class WrapEffect(_Described):
    """An effect that puts something around the model: `wrapper(base=model, size=..., ...)`."""

    wrapper: type[Model] = Lagging

    @property
    def parameters(self) -> Mapping[str, Parameter]:  # type: ignore[override]
        """Size, and where, when or how fast."""
        return parameters_of(self.wrapper)

    def apply(self, model: Model, values: Mapping[str, float]) -> Model:
        """Return the model, wrapped; the model itself at size 0."""
        if not values.get(SIZE, 0.0):
            return model
        if self.beside and not isinstance(model, self.beside):
            return self._inside(model, values)
        made: Model = self.wrapper(base=model, **values)  # type: ignore[call-arg]
        return made

    def columns(self, model: Model, motion: Motion, grid: Sequence[Mapping[str, float]]) -> Array:
        """Return what the output gains for a unit of size; of many breaths about the plain base, all at once."""
        names = set(self.parameters)
        if not (
            self.wrapper is BreathingTissue
            and isinstance(model, ShaftAndTip)
            and all(each.keys() == names and each[SIZE] for each in grid)
        ):
            return super().columns(model, motion, grid)
        gained = breathing_forces(model, motion, grid) - simulate(model, motion).output
        return np.asarray((gained / np.array([[each[SIZE]] for each in grid])).T)

    def _inside(self, model: Model, values: Mapping[str, float]) -> Model:
        """Return a model that has effects already with this one put around its innermost base."""
        if not self.suits(model):
            wanted = " or ".join(each.name for each in self.beside)
            raise ModelError(Mistake("effect", self.name, f"can be added to {wanted} only"), type(model).__name__)
        inner: Any = model
        whole: Model = dataclasses.replace(inner, base=self.apply(inner.base, values))
        return whole


def presliding_of(model: Model) -> float:
    """Return the travel over which friction turns round in a model (mm), 0.05 where it does not say."""
    return _of_base(model, "presliding_mm") or 0.05


def _of_base(model: Model, name: str) -> float | None:
    """Return a parameter of a model, or of the one that it is put around; None where none has it."""
    while not hasattr(model, name) and hasattr(model, "base"):
        model = model.base
    value = getattr(model, name, None)
    return None if value is None else float(value)


def _depths(step_mm: float) -> Callable[[Reach], np.ndarray]:
    return lambda reach: np.arange(max(reach.depth_mm[0], 0) + 2 * step_mm, reach.depth_mm[1] - step_mm, step_mm)


def _speeds(reach: Reach) -> np.ndarray:
    low, high = max(reach.speed_mm_s[0], 1e-2), max(reach.speed_mm_s[1], 2e-2)
    return np.geomspace(0.3 * low, max(0.5 * high, 0.6 * low), 8)


def _breaths(reach: Reach) -> list[dict[str, float]]:
    """Return breaths that show in rests, and those that turn the movement round even where the needle advances."""
    slowest = max(reach.speed_mm_s[0], 1e-2)
    found = []
    for frequency_hz in np.arange(0.12, 0.5, 0.03):
        turning = slowest / (_STEEPEST * 2 * np.pi * frequency_hz)
        sizes = [0.02, 0.1, *(min(share * turning, 30.0) for share in (1.15, 1.8, 3.5))]
        found += [
            {"frequency_hz": frequency_hz, "phase_rad": phase, "rest": 1.0, SIZE: size}
            for phase, size in product(np.arange(6) * np.pi / 3, sizes)
        ]
    return found


_STEEPEST = 0.65
"""Greatest velocity of a breath, in parts of way times angular frequency."""


def _other_breaths(values: Mapping[str, float], reach: Reach, scale: float) -> list[dict[str, float]]:
    """Return breaths with another frequency, whose phase is told in the middle of a trial, phase and way."""
    if not values[SIZE]:
        return []
    begin, apart = values["phase_rad"], 0.3 / reach.duration_s
    middle = np.pi * reach.duration_s
    reached = (-2, -1, 0, 1, 2) if scale == 1 else (-1, 0, 1)
    steps = product((0.5, 1.0, 2.0), reached, reached)
    found = [
        {
            **values,
            SIZE: values[SIZE] * share**scale,
            "frequency_hz": values["frequency_hz"] + scale * faster * apart,
            "phase_rad": begin + scale * 0.45 * later - middle * scale * faster * apart,
        }
        for share, later, faster in steps
    ]
    dwells = product((-1.0, 0.0), np.arange(6) * np.pi / 3) if scale == 1 else ()
    return found + [{**values, "rest": rest, "phase_rad": begin + later} for rest, later in dwells]


FORCE_EFFECTS: tuple[Effect, ...] = (
    TermEffect(
        "puncture", "puncture of a membrane", Family.CUTTING, Enters.TIP,
        "F += size exp((L - depth)/bulge) until the tip first reaches depth",
        "A membrane, capsule or crust bulges before the tip and breaks: the force rises, and drops at once.",
        _THESIS + "2.5.1 and 7.2",
        lambda reach: {"depth_mm": _depths(0.6)(reach), "bulge_mm": (0.7, 2.0, 5.0)},
        term=cutting.Puncture,
    ),
    TermEffect(
        "cutting_layer", "layer that is harder to cut", Family.CUTTING, Enters.TIP,
        "F += size step((L - depth)/width) while the tip is pushed in",
        "From some depth on the tip meets other tissue, which takes more or less to cut.",
        _THESIS + "2.1 and 7.2",
        lambda reach: {"depth_mm": _depths(1.0)(reach), "width_mm": (0.5, 2.0)},
        term=cutting.CuttingLayer,
    ),
    TermEffect(
        "fresh_cutting", "cutting in fresh tissue only", Family.CUTTING, Enters.TIP,
        "F -= size F_tip (1 - exp(-(L_max - L)/margin)) while the tip is pushed in",
        "Where the tip has been before it does not cut again.",
        _THESIS + "3.4.2",
        lambda reach: {"margin_mm": (0.1, 0.5, 2.0)},  # noqa: ARG005
        term=cutting.FreshCutting,
    ),
    TermEffect(
        "cutting_with_depth", "cutting that grows with depth", Family.CUTTING, Enters.TIP,
        "F += size L while the tip is pushed in",
        "The deeper the tip, the more it takes to cut.",
        _THESIS + "3.4.2",
        term=cutting.CuttingWithDepth,
    ),
    TermEffect(
        "friction_layer", "layer that rubs more", Family.FRICTION, Enters.SHAFT,
        "F += size (L - depth) on the part of the shaft beyond depth",
        "From some depth on the shaft is in other tissue, which rubs more or less.",
        _THESIS + "2.1 and 7.2",
        lambda reach: {"depth_mm": _depths(1.0)(reach)},
        term=shaft.FrictionLayer,
    ),
    TermEffect(
        "stribeck", "friction that depends on low speed (Stribeck)", Family.FRICTION, Enters.SHAFT,
        "F += size F_shaft exp(-|v|/speed)",
        "Friction is higher when the needle goes slowly.",
        _THESIS + "(3.2) and 3.4.3",
        lambda reach: {"speed_mm_s": _speeds(reach)},
        term=shaft.Stribeck,
    ),
    TermEffect(
        "viscous", "viscous friction", Family.FRICTION, Enters.SHAFT,
        "F += size L v", "Friction grows in proportion to the speed.", _THESIS + "(3.1) and chapter 5",
        term=shaft.Viscous,
    ),
    WrapEffect(
        "bristle", "hysteresis before sliding", Family.FRICTION, Enters.SHAFT,
        "z' = (v - |v| z)/(presliding + size)",
        "After a reversal the force turns round over a longer travel than the model knows: tissue sticks to "
        "the needle and bends before it slides.",
        "Dahl, AIAA J. 14 (1976) 1675",
        lambda reach: {SIZE: np.geomspace(0.03, 6.0, 10)},  # noqa: ARG005
        wrapper=SlowTurning,
        beside=(ShaftAndTip,),
    ),
    TermEffect(
        "relaxation", "force that relaxes at rest", Family.TISSUE, Enters.SHAFT,
        "F (1 - size q), q' = (1 - q)/time - q |v|/recovery",
        "While the needle rests the force sinks; after a little travel it is there again.",
        _THESIS + "2.2 and 3.4.3",
        lambda reach: {"time_s": np.geomspace(0.1, 12.0, 8), "recovery_mm": (0.05, 0.4)},  # noqa: ARG005
        term=shaft.Relaxation,
    ),
    WrapEffect(
        "tissue_motion", "tissue that moves with the needle", Family.TISSUE, Enters.TISSUE,
        "lag u' = size z - u, z' = (w - |w| z)/presliding, w = v - u'",
        "The tissue is held by a spring and a damper: it goes with the needle before the needle slides in it.",
        _THESIS + "chapter 4",
        lambda reach: {SIZE: np.geomspace(0.1, 5.0, 10), "lag_s": (0.02, 0.08, 0.25, 0.8)},  # noqa: ARG005
        wrapper=GivingTissue,
        beside=(ShaftAndTip, SlowTurning),
    ),
    TermEffect(
        "path_damage", "path that wears with sliding", Family.TISSUE, Enters.SHAFT,
        "F -= size F_shaft/L int_0^L (1 - exp(-slid(x)/sliding)) dx",
        "Tissue along which the shaft has slid, there and back, rubs less.",
        _THESIS + "3.4.2 and 3.4.3",
        lambda reach: {"sliding_mm": (10.0, 40.0, 160.0)},  # noqa: ARG005
        term=shaft.PathDamage,
    ),
    TermEffect(
        "bump", "bump at one place", Family.TISSUE, Enters.SHAFT,
        "F += size exp(-((L - depth)/width)^2), against the movement",
        "Something at one place, such as an air bubble or a fibre, resists each time the tip passes it.",
        _THESIS + "2.5.2 and 3.4.1",
        lambda reach: {"depth_mm": _depths(1.0)(reach), "width_mm": (0.7, 1.5, 3.0)},
        term=shaft.Bump,
        repeats=True,
    ),
    TermEffect(
        "bias", "bias of the force sensor", Family.SENSOR, Enters.SENSOR,
        "y = F + size", "The sensor was not set to zero.", _THESIS + "2.5.2",
        term=sensor.Bias,
    ),
    TermEffect(
        "drift", "drift of the force sensor", Family.SENSOR, Enters.SENSOR,
        "y = F + size t", "The zero of the sensor moves evenly during each trial.", _THESIS + "2.5.2",
        term=sensor.Drift,
    ),
    TermEffect(
        "thermal_drift", "force sensor that warms up", Family.SENSOR, Enters.SENSOR,
        "y = F + size (1 - exp(-t/time))", "The zero of the sensor moves to another value while it warms up.",
        _THESIS + "2.5.1",
        lambda reach: {"time_s": np.geomspace(reach.duration_s / 12, reach.duration_s / 3, 5)},
        term=sensor.ThermalDrift,
    ),
    TermEffect(
        "gain_error", "gain of the force sensor", Family.SENSOR, Enters.SENSOR,
        "y = (1 + size) F", "The sensor shows forces too large, or too small; friction and cutting take it up.",
        _THESIS + "2.5.2",
        term=sensor.GainError,
    ),
    TermEffect(
        "inertia", "inertia of what hangs on the sensor", Family.DRIVE, Enters.SENSOR,
        "y = F + size a", "The sensor accelerates the holder as well as the needle.", _THESIS + "3.4.2",
        term=sensor.Inertia,
    ),
    WrapEffect(
        "latency", "reading that is late", Family.SENSOR, Enters.SENSOR,
        "y = F(t - size), by 256 lags of size/256 in a row", "The force arrives later than the position.",
        _THESIS + "appendix A",
        wrapper=Lagging,
        is_lag=True,
    ),
    WrapEffect(
        "respiration", "breathing", Family.TISSUE, Enters.TISSUE,
        "v - u', L - u with u = size/2 (sin a - rest/2 cos(a)^2 + rest), a = 2 pi f t + phase",
        "The tissue moves along the needle by itself, with the breath.", _THESIS + "1.2 and 2.1; Lujan et al., 1999",
        _breaths,
        _other_breaths,
        wrapper=BreathingTissue,
    ),
)  # fmt: skip
"""In the order in which they are shown."""
