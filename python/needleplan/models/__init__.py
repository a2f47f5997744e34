"""The mechanics: axial force, friction, tissue motion and deflection as one family of models.

Units: mm, N, s, rad. See `needleplan.models.base` for what a model is.
"""

from needleplan.models.base import Channel, LinearStateModel, Model, SelfIntegratingModel
from needleplan.models.bicycle import Bicycle, arc_step
from needleplan.models.deflection import InsertionForce, SpatialBeam, TipPath
from needleplan.models.fit import Estimate, Fit, FitStatus, fit
from needleplan.models.force import ForceModel1, ForceModel2
from needleplan.models.friction import (
    AveragedLuGre,
    Beta,
    ForceParts,
    Karnopp,
    LumpedLuGre,
    OutputForm,
    Profile,
    QuasiStatic,
    cutting_force,
    distributed,
    into_fresh_tissue,
)
from needleplan.models.in_plane import InPlane, in_plane
from needleplan.models.insertion import ShaftAndTip
from needleplan.models.intervals import Intervals, bootstrap_intervals, profile_intervals
from needleplan.models.model_file import ModelFile, Parent
from needleplan.models.needle import Needle
from needleplan.models.parameter import Parameter, Scale, constant, parameter
from needleplan.models.registry import KINDS, kind_of
from needleplan.models.residuals import Finding, ljung_box, residual_findings
from needleplan.models.simulate import Trajectory, simulate
from needleplan.models.spatial import TipFrame
from needleplan.models.steered import SpatialBicycle, SteeredModel
from needleplan.models.tissue import AveragedOnTissue, LumpedOnTissue, MovingTissue, fit_on_tissue, tune_slow_observer
from needleplan.models.torsion import Torsion

__all__ = [
    "KINDS",
    "AveragedLuGre",
    "AveragedOnTissue",
    "Beta",
    "Bicycle",
    "Channel",
    "Estimate",
    "Finding",
    "Fit",
    "FitStatus",
    "ForceModel1",
    "ForceModel2",
    "ForceParts",
    "InPlane",
    "InsertionForce",
    "Intervals",
    "Karnopp",
    "LinearStateModel",
    "LumpedLuGre",
    "LumpedOnTissue",
    "Model",
    "ModelFile",
    "MovingTissue",
    "Needle",
    "OutputForm",
    "Parameter",
    "Parent",
    "Profile",
    "QuasiStatic",
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
    "bootstrap_intervals",
    "constant",
    "cutting_force",
    "distributed",
    "fit",
    "fit_on_tissue",
    "in_plane",
    "into_fresh_tissue",
    "kind_of",
    "ljung_box",
    "parameter",
    "profile_intervals",
    "residual_findings",
    "simulate",
    "tune_slow_observer",
]
