"""LuGre friction on tissue that gives way: Models II and III of chapter 3 under the tissue motion of chapter 4."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np

from needleplan.models.friction import AveragedLuGre, Beta, LumpedLuGre, OutputForm, Profile, StribeckFriction
from needleplan.models.friction.lugre import LuGre
from needleplan.models.parameter import constant, parameter
from needleplan.models.tissue.coupling import MovingTissue
from needleplan.models.tissue.stepping import FrictionLaw
from needleplan.signals import Motion

__all__ = ["AveragedOnTissue", "LuGreLaw", "LumpedOnTissue"]


@dataclass(frozen=True, kw_only=True)
class LumpedOnTissue(StribeckFriction, MovingTissue):
    """Model II on Kelvin-Voigt tissue: what is fitted instead of a slow observer."""

    name: ClassVar[str] = "lumped_lugre_on_tissue"
    sigma1: float = parameter("s/mm", 1e-5, 1e3, "damping of the bristles")

    def friction(self) -> LumpedLuGre:
        """Return Model II."""
        return LumpedLuGre(**{each.name: getattr(self, each.name) for each in fields(LumpedLuGre)})

    def law(self, motion: Motion) -> FrictionLaw:
        """Return the friction on plain numbers."""
        return LuGreLaw(self.friction(), motion)


@dataclass(frozen=True, kw_only=True)
class AveragedOnTissue(StribeckFriction, MovingTissue):
    """Models III-A and III-B on Kelvin-Voigt tissue; see `AveragedLuGre` for the choices."""

    name: ClassVar[str] = "averaged_lugre_on_tissue"
    sigma1: float = parameter("s/mm", 1e-5, 1e3, "damping of the bristles")
    exponent: float = constant("", 0, 20, "lambda: how bending grows along the patch", default=5.0)
    profile: Profile = Profile.ISOSCELES
    beta: Beta = Beta.TRANSPORT

    def friction(self) -> AveragedLuGre:
        """Return Model III."""
        chosen = {each.name: getattr(self, each.name) for each in fields(AveragedLuGre) if each.name != "form"}
        return AveragedLuGre(**chosen, form=OutputForm.CONSISTENT)

    def law(self, motion: Motion) -> FrictionLaw:
        """Return the friction on plain numbers."""
        return LuGreLaw(self.friction(), motion)


class LuGreLaw:
    """LuGre friction with the consistent output, one number at a time: what `PointwiseLaw` gives, 50 times as fast."""

    coefficients: Callable[[int, float], tuple[float, float]]
    force: Callable[[int, float, float, float], float]

    def __init__(self, friction: LuGre, motion: Motion) -> None:
        sigma0, sigma1, sigma2 = friction.sigma0, friction.sigma1, friction.sigma2
        mu_c, drop, alpha, gamma = friction.mu_c, friction.mu_s - friction.mu_c, friction.alpha, friction.gamma
        normal = friction.total_normal_force_n(motion).tolist()
        inside = (motion.depth_mm > 0).tolist()
        transport = [_transport(friction, motion, sign) for sign in (1.0, -1.0)]
        exp = math.exp

        def coefficients(sample: int, w: float) -> tuple[float, float]:  # noqa: ARG001
            speed = w if w > 0 else -w
            return w, sigma0 * speed / (mu_c + drop * exp(-alpha * speed))

        def general(sample: int, w: float) -> tuple[float, float]:
            if not inside[sample]:
                forcing, rate = friction.coefficients(motion[sample])
                return float(forcing), float(rate)
            speed = w if w > 0 else -w
            level = mu_c + drop * exp(-alpha * speed**gamma)
            return w, sigma0 * speed / level - transport[w < 0][sample] * speed

        def force(sample: int, w: float, bending: float, bending_rate: float) -> float:
            result: float = normal[sample] * (sigma0 * bending + sigma1 * bending_rate + sigma2 * w)
            return result

        plain = all(inside) and gamma == 1 and not any(map(any, transport))
        self.coefficients = coefficients if plain else general
        self.force = force


def _transport(friction: LuGre, motion: Motion, sign: float) -> list[float]:
    """Return what the transport along the patch adds to z'/z for a velocity of 1 mm/s in the direction of `sign`."""
    velocity = np.full(len(motion), sign)
    moved = Motion(motion.time_s, motion.depth_mm, velocity, velocity, motion.angle_rad)
    return [float(each) for each in friction.transport_per_s(moved)]
