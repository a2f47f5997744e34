"""Model II of chapter 2: f2 and alpha are fixed, taken from Model I, and beta is identified (eqs. 2.3, 2.4)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from needleplan.models.force.base import DepthForce
from needleplan.models.parameter import constant

__all__ = ["ForceModel2"]


@dataclass(frozen=True)
class ForceModel2(DepthForce):
    """The force-depth model with fixed f2 and alpha.

    Up to the scale of z it is Model I with alpha fixed and f2 / f1 free: nothing that Model I could not do
    (`needleplan.models.force.gauge`). That it did better in the thesis is a matter of the estimator.
    """

    name: ClassVar[str] = "force_model_2"

    f2: float = constant("N s", -1e3, 1e3, "g at the surface less g far from it; fixes the scale of z")
    alpha: float = constant("1/mm", 1e-4, 1e1, "rate of decay with depth of what is special at the surface")
