"""The kinds of models that a model file can hold, by `Model.name`.

Add a new model to `MEMBERS`; a test fails if a model is missing.
"""

from __future__ import annotations

from needleplan.config import suggestion
from needleplan.errors import Mistake, ModelError
from needleplan.models._base import Model
from needleplan.models.deflection import InsertionForce, LayeredShape, SpatialBeam, TipPath
from needleplan.models.force import ForceModel1, ForceModel2, RelaxingForce
from needleplan.models.friction import (
    AveragedLuGre,
    DirectionalKarnopp,
    Karnopp,
    LumpedLuGre,
    QuasiStatic,
    ShaftAndTip,
)
from needleplan.models.path import Bicycle, BicycleByDepth, SpatialBicycle
from needleplan.models.tissue import AveragedOnTissue, LumpedOnTissue

__all__ = ["KINDS", "MEMBERS", "kind_of"]

MEMBERS: tuple[type[Model], ...] = (
    AveragedLuGre,
    AveragedOnTissue,
    Bicycle,
    BicycleByDepth,
    DirectionalKarnopp,
    ForceModel1,
    ForceModel2,
    InsertionForce,
    Karnopp,
    LayeredShape,
    LumpedLuGre,
    LumpedOnTissue,
    QuasiStatic,
    RelaxingForce,
    ShaftAndTip,
    SpatialBeam,
    SpatialBicycle,
    TipPath,
)

KINDS: dict[str, type[Model]] = {member.name: member for member in MEMBERS}
"""Model classes by the name of their kind."""


def kind_of(name: str) -> type[Model]:
    """Return the model class of a kind.

    Parameters
    ----------
    name : str
        A key of `KINDS`.

    Returns
    -------
    type
        The class.

    Raises
    ------
    ModelError
        If the kind is unknown; the message suggests the closest one.

    Examples
    --------
    >>> from needleplan.models import kind_of
    >>> kind_of("bicycle").__name__
    'Bicycle'
    """
    if name in KINDS:
        return KINDS[name]
    raise ModelError(Mistake("kind", name, f"must be one of {', '.join(sorted(KINDS))}{suggestion(name, KINDS)}"))
