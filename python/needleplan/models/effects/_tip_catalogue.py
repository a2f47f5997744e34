"""Catalogue of the effects of the path of the tip, and the registry of all effects by name.

The registry holds the effects of this package, the plug-ins that other packages declare under the entry point
`needleplan.effects`, and the effects of registered files. An entry point names an instance of a subclass of `Effect`,
or a subclass whose constructor takes no arguments.
"""

from __future__ import annotations

import runpy
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from importlib import metadata

import numpy as np

import needleplan.models.effects._tip as tip
from needleplan.config import suggestion
from needleplan.errors import Mistake, ModelError
from needleplan.models._base import Channel
from needleplan.models._parameter import Scale
from needleplan.models.effects._base import SIZE, Effect, Enters, Family, Reach
from needleplan.models.effects._catalogue import FORCE_EFFECTS
from needleplan.models.effects._described import WrapEffect
from needleplan.models.effects._further_catalogue import FURTHER_FORCE_EFFECTS
from needleplan.models.effects._tip import Altered

__all__ = ["GROUP", "TIP_EFFECTS", "effect_named", "effects_of", "known_effects", "register_file"]

Grid = Callable[[Reach], Mapping[str, Sequence[float] | np.ndarray]]
_THESIS = "Needle steering thesis, "
# Directions of the search grid, rad; a negative amplitude covers the other half.
_HALF_ROUND = np.arange(12) * np.pi / 12


def _nowhere(reach: Reach) -> dict[str, Sequence[float]]:  # noqa: ARG001
    return {}


def _around(reach: Reach) -> dict[str, np.ndarray]:  # noqa: ARG001
    return {"direction_rad": _HALF_ROUND}


def _layers(reach: Reach) -> dict[str, np.ndarray]:
    return {"depth_mm": np.arange(max(reach.depth_mm[0], 0) + 4, max(reach.depth_mm[1] - 4, 5), 2.0)}


def _of(
    name: str, title: str, family: Family, enters: Enters, equation: str, meaning: str, source: str,
    wrapper: type[Altered], looked_for: Grid = _nowhere,
) -> Effect:  # fmt: skip
    return WrapEffect(
        name, title, family, enters, equation, meaning, source, looked_for, channel=Channel.TIP, wrapper=wrapper
    )


TIP_EFFECTS: tuple[Effect, ...] = (
    _of("curvature_layer", "layer in which the path bends otherwise", Family.CUTTING, Enters.TIP,
        "k (1 + size step(l - depth))",
        "From some depth on the tip is in other tissue, in which it bends more or less.",
        _THESIS + "2.1, 5 and 7.2", tip.CurvatureLayer, _layers),
    _of("curvature_speed", "curvature that depends on the speed", Family.CUTTING, Enters.TIP,
        "k (1 + size ((v / 5 mm/s)^power - 1) / power), power = 1",
        "Tissue gives way less to a fast needle: the path bends more, or less, the faster it goes in.",
        _THESIS + "5", tip.SpeedCurvature),
    _of("entry_rupture", "curvature at the entry", Family.CUTTING, Enters.TIP,
        "k (1 + size exp(-l / length))",
        "The skin ruptures, or guides the needle: just behind the entry the path bends otherwise.",
        _THESIS + "5.4.2", tip.EntryRupture, lambda reach: {"length_mm": (1.0, 2.0, 4.0, 8.0, 16.0)}),  # noqa: ARG005
    _of("torsional_lag", "tip that turns less than the base", Family.NEEDLE, Enters.SHAFT,
        "|phi_tip - phi_base| <= size l",
        "The tissue holds the shaft when it is turned, and the needle twists: the tip is behind the base.",
        _THESIS + "1.2 and 6.5", tip.TwistedNeedle,
        lambda reach: {SIZE: (5e-4, 2e-3, 8e-3, 0.032)}),  # noqa: ARG005
    _of("pre_bend", "needle that is bent", Family.NEEDLE, Enters.SHAFT,
        "(kn, kb) += size (cos, sin)(phi_tip + direction)",
        "The needle was bent before it went in; the bend turns with the tip.",
        _THESIS + "5", tip.PreBend, _around),
    _of("gravity", "weight of the needle", Family.NEEDLE, Enters.SHAFT,
        "(kn, kb) += size (0, -1) exp(-l / fading)",
        "The needle sags outside and goes in bent downwards, along -z, wherever the bevel looks.",
        "beam theory: sag of a cantilever under its weight", tip.Sagging,
        lambda reach: {"fading_mm": (20.0, 60.0, 180.0, 2000.0)}),  # noqa: ARG005
    _of("misalignment", "base that is not aligned", Family.DRIVE, Enters.SHAFT,
        "dp/dl (0) = t + size (0, cos, sin)(direction)",
        "The needle goes in along another direction than the robot thinks.",
        _THESIS + "5", tip.Misalignment, _around),
    _of("tissue_drift", "tissue that drifts", Family.TISSUE, Enters.TISSUE,
        "p += size t (0, cos, sin)(direction)",
        "The tissue moves slowly aside, and the needle in it.",
        _THESIS + "1.2", tip.DriftingTissue, _around),
    _of("target_respiration", "breathing that moves the tip", Family.TISSUE, Enters.TISSUE,
        "p += size cos(pi f t + phase / 2)^4 (0, cos, sin)(direction)",
        "The tissue, target and needle in it, moves with the breath.",
        "Lujan et al., Med. Phys. 26 (1999) 715", tip.BreathingTarget,
        lambda reach: {  # noqa: ARG005
            "frequency_hz": np.arange(0.12, 0.46, 0.02), "phase_rad": np.arange(6) * np.pi / 3,
            "direction_rad": _HALF_ROUND[::3],
        }),
    _of("coil_offset", "coil beside the axis", Family.SENSOR, Enters.SENSOR,
        "y = p + size (cos n + sin b)(phi + direction)",
        "The coil of the tracker is not on the axis: when the needle turns, it goes round.",
        "geometry", tip.CoilOffset, _around),
    _of("coil_behind", "coil behind the tip", Family.SENSOR, Enters.SENSOR,
        "y = p - size (t - t(0))",
        "The coil of the tracker is not at the tip but somewhere behind it, on the path.",
        "geometry", tip.CoilBehind),
    _of("tracker_bias", "tracker that shows all beside", Family.SENSOR, Enters.SENSOR,
        "y = p + size (0, cos, sin)(direction)",
        "The frame of the tracker is shifted against that of the robot.",
        "registration", tip.TrackerBias, _around),
    _of("tracker_distortion", "bent field of the tracker", Family.SENSOR, Enters.SENSOR,
        "y = p + size (x / 100 mm)^2 (0, cos, sin)(direction)",
        "Metal near the tracker bends its field: the further away, the further aside places are shown.",
        "Franz et al., IEEE Trans. Med. Imaging 33 (2014) 1702", tip.TrackerDistortion, _around),
)  # fmt: skip
"""The effects of the path of the tip, in the order of display."""


GROUP = "needleplan.effects"
"""Group of the entry points that declare plug-ins."""


@lru_cache(maxsize=1)
def known_effects() -> dict[str, Effect]:
    """Return all effects by name, including plug-ins and registered files.

    Raises ModelError if a plug-in is not an `Effect` with the parameter `size`, or has the name of another effect.
    """
    effects = {each.name: each for each in (*FORCE_EFFECTS, *FURTHER_FORCE_EFFECTS, *TIP_EFFECTS)}
    for point in metadata.entry_points(group=GROUP):
        made = point.load()
        effect = made() if isinstance(made, type) else made
        if not isinstance(effect, Effect) or SIZE not in effect.parameters:
            raise ModelError(Mistake(point.name, str(made), f"must be an Effect with a parameter {SIZE}"), GROUP)
        if effect.name in effects:
            raise ModelError(Mistake(point.name, effect.name, "is the name of another effect"), GROUP)
        effects[effect.name] = effect
    return effects


def register_file(path: str) -> Effect:
    """Execute a Python file, register the effect that the file defines as `EFFECT`, and return the effect.

    `EFFECT` is an instance or a subclass of `Effect`. The effect is registered in this process only. Raises ModelError
    if the file cannot be read or executed, or if `EFFECT` is missing, lacks the parameter `size`, has the name of
    another effect, or does not allow the amplitude 0.
    """
    mistakes: list[Mistake] = []
    try:
        made = runpy.run_path(path).get("EFFECT")
        effect = made() if isinstance(made, type) else made
        if not isinstance(effect, Effect) or SIZE not in effect.parameters:
            mistakes.append(Mistake("EFFECT", "", f"must be defined as an Effect with a parameter {SIZE}"))
        elif effect.name in known_effects() and known_effects()[effect.name] is not effect:
            mistakes.append(Mistake("EFFECT", effect.name, "is the name of another effect"))
        elif effect.parameters[SIZE].scale is not Scale.LINEAR:
            rule = f"its {SIZE} must allow 0: declare {SIZE} with a typical value"
            mistakes.append(Mistake("EFFECT", effect.name, rule))
        else:
            known_effects()[effect.name] = effect
            return effect
    except OSError as error:
        mistakes.append(Mistake("", "", f"cannot be read: {error.strerror}"))
    except (Exception, SystemExit) as error:  # the file may raise anything
        line = f"{type(error).__name__}: {error}"
        raise ModelError(Mistake("EFFECT", "", f"cannot be created: {line}"), path) from error
    raise ModelError(mistakes, path)


def effects_of(channel: Channel, *, further: bool = False) -> tuple[Effect, ...]:
    """Return the effects on models of a channel, which include those with `Effect.further` only if asked for."""
    return tuple(
        effect for effect in known_effects().values() if effect.channel is channel and (further or not effect.further)
    )


def effect_named(name: str) -> Effect:
    """Return an effect by name. Raises ModelError, with a suggestion, for an unknown name."""
    known = known_effects()
    if name in known:
        return known[name]
    raise ModelError(Mistake("effect", name, f"must be one of {', '.join(sorted(known))}{suggestion(name, known)}"))
