"""Mechanical models of needle insertion: axial force, friction, tissue motion, deflection and the path of the tip.

All models have one interface. `simulate` drives a model along a motion, `fit` identifies its parameters from records,
and `residual_findings` examines a fit. Units are mm, N, s and rad.

| package | models |
|---|---|
| `needleplan.models.force` | axial force as a function of depth (chapter 2 of the thesis), force that relaxes |
| `needleplan.models.friction` | friction along the shaft (chapter 3), cutting at the tip |
| `needleplan.models.tissue` | friction on tissue that moves with the needle (chapter 4) |
| `needleplan.models.deflection` | bending of the needle in tissue (chapter 5) |
| `needleplan.models.path` | path of a bevel tip in the plane and in 3D (chapter 6) |
| `needleplan.models.effects` | effects that can be added to a model |
"""

import needleplan.extras.lab  # noqa: F401  # raises MissingLibraryError
from needleplan.artifacts import Parent
from needleplan.models._base import Channel, LinearStateModel, Model, SelfIntegratingModel
from needleplan.models._estimates import Estimate, Fit, FitStatus
from needleplan.models._fit import fit
from needleplan.models._in_plane import InPlane, in_plane
from needleplan.models._kinds import KINDS, kind_of
from needleplan.models._parameter import Parameter, Scale, constant, parameter
from needleplan.models._residuals import Finding, findings_of, ljung_box, residual_findings
from needleplan.models._simulate import Trajectory, simulate
from needleplan.models.deflection import InsertionForce, LayeredShape, NeedleShaft, SpatialBeam, TipPath
from needleplan.models.force import ForceModel1, ForceModel2, RelaxingForce
from needleplan.models.friction import (
    AveragedLuGre,
    Beta,
    DirectionalKarnopp,
    ForceParts,
    Karnopp,
    LumpedLuGre,
    OutputForm,
    Profile,
    QuasiStatic,
    ShaftAndTip,
    cutting_force,
    distributed,
    into_fresh_tissue,
)
from needleplan.models.model_file import ModelFile
from needleplan.models.path import (
    BetweenDepths,
    Bicycle,
    BicycleByDepth,
    SpatialBicycle,
    SteeredModel,
    TipFrame,
    Torsion,
    arc_step,
)
from needleplan.models.tissue import AveragedOnTissue, LumpedOnTissue, MovingTissue, fit_on_tissue, tune_slow_observer
from needleplan.signals import recurrence

__all__ = [
    "KINDS",
    "AveragedLuGre",
    "AveragedOnTissue",
    "Beta",
    "BetweenDepths",
    "Bicycle",
    "BicycleByDepth",
    "Channel",
    "DirectionalKarnopp",
    "Estimate",
    "Finding",
    "Fit",
    "FitStatus",
    "ForceModel1",
    "ForceModel2",
    "ForceParts",
    "InPlane",
    "InsertionForce",
    "Karnopp",
    "LayeredShape",
    "LinearStateModel",
    "LumpedLuGre",
    "LumpedOnTissue",
    "Model",
    "ModelFile",
    "MovingTissue",
    "NeedleShaft",
    "OutputForm",
    "Parameter",
    "Parent",
    "Profile",
    "QuasiStatic",
    "RelaxingForce",
    "Scale",
    "SelfIntegratingModel",
    "ShaftAndTip",
    "SpatialBeam",
    "SpatialBicycle",
    "SteeredModel",
    "TipFrame",
    "TipPath",
    "Torsion",
    "Trajectory",
    "arc_step",
    "constant",
    "cutting_force",
    "distributed",
    "findings_of",
    "fit",
    "fit_on_tissue",
    "in_plane",
    "into_fresh_tissue",
    "kind_of",
    "ljung_box",
    "parameter",
    "recurrence",
    "residual_findings",
    "simulate",
    "tune_slow_observer",
]
