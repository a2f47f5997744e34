"""The exact symmetry of the force-depth model: nobody has ever measured the scale of z.

For every c > 0::

    (beta, f1, f2, sigma0, sigma1, z) -> (beta/c, c f1, c f2, c sigma0, c sigma1, z/c)

leaves the force as it is: z' keeps its form, as sigma0/g does not change, and sigma0 z, sigma1 beta and
sigma1 sigma0 z/g do not either. sigma2 and alpha stay. So the seven numbers are six, and no data can tell all seven.
Model I takes one away by fixing beta, Model II by fixing f2. Compare parameters of two identifications only after
`with_gauge` has brought both to the same beta.
"""

from __future__ import annotations

from typing import TypeVar

from needleplan.errors import Mistake, ModelError
from needleplan.models.force.base import DepthForce
from needleplan.signals import Array

__all__ = ["regauged", "regauged_state", "with_gauge"]

_Force = TypeVar("_Force", bound=DepthForce)


def regauged(model: _Force, c: float) -> _Force:
    """Return the model with the scale of z changed by 1/c; its forces are those of `model`.

    Raises ModelError where c is not positive, or a parameter would leave its range.
    """
    if not c > 0:
        raise ModelError(Mistake("c", f"{c}", "must be positive"), model.name)
    scaled = {name: c * getattr(model, name) for name in ("f1", "f2", "sigma0", "sigma1")}
    return model.with_values(beta=model.beta / c, **scaled)


def regauged_state(state: Array, c: float) -> Array:
    """Return the state, of any shape, that belongs to `regauged(model, c)`."""
    return state / c


def with_gauge(model: _Force, beta: float) -> _Force:
    """Return the model with the same forces whose beta (1/(mm s)) is the given one. Raises ModelError as `regauged`."""
    if not beta > 0:
        raise ModelError(Mistake("beta", f"{beta}", "must be positive"), model.name)
    return regauged(model, model.beta / beta)
