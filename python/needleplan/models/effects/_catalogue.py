"""Catalogue of the effects of the axial force: equation, explanation, source and search grid of each effect."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import product

import numpy as np

import needleplan.models.effects._sensor as sensor
import needleplan.models.effects._shaft as shaft
from needleplan.models.effects._base import SIZE, Effect, Enters, Family, Reach
from needleplan.models.effects._described import TermEffect, WrapEffect
from needleplan.models.effects._tissue import BreathingTissue, GivingTissue, SlowTurning
from needleplan.models.friction import ShaftAndTip

__all__ = ["FORCE_EFFECTS", "other_breaths", "respiration_grid"]

_THESIS = "Needle steering thesis, "


def _depths(step_mm: float) -> Callable[[Reach], np.ndarray]:
    return lambda reach: np.arange(max(reach.depth_mm[0], 0) + 2 * step_mm, reach.depth_mm[1] - step_mm, step_mm)


def _speeds(reach: Reach) -> np.ndarray:
    low, high = max(reach.speed_mm_s[0], 1e-2), max(reach.speed_mm_s[1], 2e-2)
    return np.geomspace(0.3 * low, max(0.5 * high, 0.6 * low), 8)


def respiration_grid(reach: Reach) -> list[dict[str, float]]:
    """Return the search grid of breathing motions.

    Some of the motions are so small that they show only at rest. Others are large enough to reverse the motion of the
    needle relative to the tissue while the needle advances.
    """
    slowest = max(reach.speed_mm_s[0], 1e-2)
    points = []
    for frequency_hz in np.arange(0.12, 0.5, 0.03):
        turning = slowest / (_STEEPEST * 2 * np.pi * frequency_hz)
        sizes = [0.02, 0.1, *(min(share * turning, 30.0) for share in (1.15, 1.8, 3.5))]
        points += [
            {"frequency_hz": frequency_hz, "phase_rad": phase, "rest": 1.0, SIZE: size}
            for phase, size in product(np.arange(6) * np.pi / 3, sizes)
        ]
    return points


# Largest velocity of a breathing motion, as a share of amplitude times angular frequency.
_STEEPEST = 0.65


def other_breaths(values: Mapping[str, float], reach: Reach, scale: float) -> list[dict[str, float]]:
    """Return variants of a breathing motion with other amplitudes, frequencies and phases.

    At scale 1 there are also variants with other dwells. A change of frequency alone keeps the phase at the middle of
    the longest trial. If the amplitude is 0, there are no variants.
    """
    if not values[SIZE]:
        return []
    begin, apart = values["phase_rad"], 0.3 / reach.duration_s
    middle = np.pi * reach.duration_s
    reached = (-2, -1, 0, 1, 2) if scale == 1 else (-1, 0, 1)
    steps = product((0.5, 1.0, 2.0), reached, reached)
    points = [
        {
            **values,
            SIZE: values[SIZE] * share**scale,
            "frequency_hz": values["frequency_hz"] + scale * faster * apart,
            "phase_rad": begin + scale * 0.45 * later - middle * scale * faster * apart,
        }
        for share, later, faster in steps
    ]
    dwells = product((-1.0, 0.0), np.arange(6) * np.pi / 3) if scale == 1 else ()
    return points + [{**values, "rest": rest, "phase_rad": begin + later} for rest, later in dwells]


# Shares of the step by which places are tried, in both directions, and factors of widths.
_PLACES, _WIDTHS = np.arange(-6, 7), (0.5, 1.0, 2.0)
# Step (mm) of these places at scale 1; a burst must be met to a sample, far finer than the search grid.
_PLACE_MM = 0.1


def _other_places(width: str) -> Callable[[Mapping[str, float], Reach, float], list[dict[str, float]]]:
    """Return the function that gives variants of an abrupt change at a depth: other depths, at scale 1 other widths."""

    def variants(values: Mapping[str, float], reach: Reach, scale: float) -> list[dict[str, float]]:  # noqa: ARG001
        widths = _WIDTHS if scale == 1 else (1.0,)
        return [
            {**values, "depth_mm": values["depth_mm"] + scale * _PLACE_MM * place, width: factor * values[width]}
            for place, factor in product(_PLACES, widths)
        ]

    return variants


FORCE_EFFECTS: tuple[Effect, ...] = (
    TermEffect(
        "puncture", "puncture of a membrane", Family.CUTTING, Enters.TIP,
        "F += size exp((L - depth)/bulge) until the tip first reaches depth",
        "A membrane, capsule or crust bulges before the tip and breaks: the force rises, and drops at once.",
        _THESIS + "2.5.1 and 7.2",
        lambda reach: {"depth_mm": _depths(0.6)(reach), "bulge_mm": (0.7, 2.0, 5.0)},
        _other_places("bulge_mm"),
        term=shaft.Puncture,
    ),
    TermEffect(
        "cutting_layer", "layer that is harder to cut", Family.CUTTING, Enters.TIP,
        "F += size step((L - depth)/width) while the tip is pushed in",
        "From some depth on the tip meets other tissue, which takes more or less to cut.",
        _THESIS + "2.1 and 7.2",
        lambda reach: {"depth_mm": _depths(1.0)(reach), "width_mm": (0.5, 2.0)},
        _other_places("width_mm"),
        term=shaft.CuttingLayer,
    ),
    TermEffect(
        "fresh_cutting", "cutting in fresh tissue only", Family.CUTTING, Enters.TIP,
        "F -= size F_tip (1 - exp(-(L_max - L)/margin)) while the tip is pushed in",
        "Where the tip has been before it does not cut again.",
        _THESIS + "3.4.2",
        lambda reach: {"margin_mm": (0.1, 0.5, 2.0)},  # noqa: ARG005
        term=shaft.FreshCutting,
    ),
    TermEffect(
        "cutting_with_depth", "cutting that grows with depth", Family.CUTTING, Enters.TIP,
        "F += size L while the tip is pushed in",
        "The deeper the tip, the more it takes to cut.",
        _THESIS + "3.4.2",
        term=shaft.CuttingWithDepth,
    ),
    TermEffect(
        "cutting_speed", "cutting that depends on the speed", Family.CUTTING, Enters.TIP,
        "F += size F_tip (v / 5 mm/s)^power while the tip is pushed in",
        "Faster cutting takes more force, or less: the work of fracture depends on the rate.",
        "Khadem et al., IEEE Robot. Autom. Lett. 2016, doi 10.1109/LRA.2016.2528301 (abstract read): the cutting force "
        "depends on the speed; the power law is ours",
        lambda reach: {"power": (0.3, 0.6, 1.0)},  # noqa: ARG005
        term=shaft.CuttingSpeed,
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
        "z' = (v - |v| z)/(presliding + size), in a share of the shaft's friction and of the tip's force",
        "After a reversal the force turns round over a longer travel than the model knows: tissue sticks to "
        "the needle, or to parts of it, and bends before it slides.",
        "Dahl, AIAA J. 14 (1976) 1675; the shares are ours",
        lambda reach: {SIZE: np.geomspace(0.03, 6.0, 10), "share": (0.3, 1.0), "tip": (0.0, 1.0)},  # noqa: ARG005
        wrapper=SlowTurning,
        beside=(ShaftAndTip,),
        imitated="presliding_mm",
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
        "lag u' = s z - u, s = size (1 - growth + growth L/50 mm), z' = (w - |w| z)/presliding, w = v - u'",
        "The tissue is held by springs and a damper: it goes with the needle before the needle slides in it.",
        _THESIS + "chapter 4",
        lambda reach: {SIZE: np.geomspace(0.05, 4.8, 6), "lag_s": (0.02, 0.08, 0.25, 0.8), "growth": (0.0, 1.0)},  # noqa: ARG005
        wrapper=GivingTissue,
        beside=(ShaftAndTip, SlowTurning),
        imitated="presliding_mm",
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
        wrapper=sensor.Lagging,
        is_lag=True,
    ),
    WrapEffect(
        "respiration", "breathing", Family.TISSUE, Enters.TISSUE,
        "v - u', L - u with u = size/2 (sin a - rest/2 cos(a)^2 + rest), a = 2 pi f t + phase",
        "The tissue moves along the needle by itself, with the breath.", _THESIS + "1.2 and 2.1; Lujan et al., 1999",
        respiration_grid,
        other_breaths,
        wrapper=BreathingTissue,
    ),
)  # fmt: skip
"""The effects of the axial force, in the order of display."""
