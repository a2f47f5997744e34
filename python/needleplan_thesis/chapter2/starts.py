"""Starts that are wrong by factors: phi(0) within +-500 % of the estimate, as section 2.5.2 has it."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from needleplan.estimation import JointForce
from needleplan.models.force import DepthForce
from needleplan.signals import insertion_cycles

__all__ = ["corners"]


def corners(model: DepthForce, factor: float, count: int, seed: int = 0) -> Iterator[DepthForce]:
    """Return `count` models whose free parameters are each wrong by `factor` or its inverse, f2 excepted.

    f1 is wrong in its distance from the bound that keeps g positive.
    """
    joint = JointForce(model)
    x = joint.initial(model, insertion_cycles(1.0, 1.0))
    random = np.random.default_rng(seed)
    may = np.array([0.0, *(0.0 if name == "f2" else 1.0 for name in joint.free)])
    for _ in range(count):
        signs = random.choice([-1.0, 1.0], x.size)
        made = joint.model(x + math.log(factor) * signs * may)
        assert isinstance(made, DepthForce)
        yield made
