"""Model I of chapter 2: beta is a fixed normalisation, everything else is identified (eqs. 2.1, 2.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from needleplan.models.force.base import DepthForce
from needleplan.models.parameter import constant

__all__ = ["ForceModel1"]


@dataclass(frozen=True)
class ForceModel1(DepthForce):
    """The force-depth model with fixed beta.

    The thesis calls beta0 "a normalized constant" and gives no value; none is needed, as every value gives the same
    forces (`needleplan.models.force.gauge`). The default keeps f1, f2 and sigma0 at the size printed for Model II.
    """

    name: ClassVar[str] = "force_model_1"

    beta: float = constant("1/(mm s)", 1e-7, 1e3, "rate of z per depth; fixes the scale of z", default=0.02)
