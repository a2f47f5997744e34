"""Tissues, needles and bases of the lab twin that hide something from a plan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from needleplan.simulation import Effects, Entry, Layer, Setup, Shaft

__all__ = ["HIDDEN", "Hidden", "laboratory"]

_WANDER = 5e-4
_TRACKER_MM = 0.1
_FLEXIBLE_N_MM2 = 1.5e4


@dataclass(frozen=True)
class Hidden:
    """What a lab hides: `hide` puts it into a lab that is as planned."""

    name: str
    title: str
    hide: Callable[[Setup], Setup]


def laboratory(curvature_per_mm: float, entry: Entry | None = None) -> Setup:
    """Return a lab that bends as planned, with a tracker of 0.1 mm and a heading that wanders a little."""
    effects = Effects(heading_noise_rad_sqrt_mm=_WANDER, tracker_noise_mm=_TRACKER_MM)
    return Setup(
        plan_curvature_per_mm=curvature_per_mm, entry=entry or Entry(), effects=effects,
        shaft=Shaft(torsional_stiffness_n_mm2=_FLEXIBLE_N_MM2),
    )  # fmt: skip


def _layers(*pieces: tuple[float, float]) -> Callable[[Setup], Setup]:
    def hide(setup: Setup) -> Setup:
        bend = setup.plan_curvature_per_mm
        return replace(setup, layers=tuple(Layer(begin, share * bend) for begin, share in pieces))

    return hide


def _twisting(setup: Setup) -> Setup:
    return replace(setup, effects=replace(setup.effects, torsional_friction_n=0.3))


def _tilted(setup: Setup) -> Setup:
    return replace(setup, entry=replace(setup.entry, heading_rad=setup.entry.heading_rad + 0.04))


HIDDEN: tuple[Hidden, ...] = (
    Hidden("soft_layer", "from 25 mm on the path bends 25 % less", _layers((25.0, 0.75))),
    Hidden("stiff_layer", "from 35 mm on the path bends 35 % more", _layers((35.0, 1.35))),
    Hidden("guiding_skin", "over the first 10 mm the path bends half as much", _layers((0.01, 0.5), (10.0, 1.0))),
    Hidden("torsion", "the tissue holds the shaft: at 60 mm the tip is 12 degrees behind the base", _twisting),
    Hidden("misaligned_base", "the needle goes in 2.3 degrees beside the planned direction", _tilted),
)
