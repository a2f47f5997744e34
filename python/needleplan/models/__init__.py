"""The mechanics: axial force, friction, tissue motion and deflection as one family of models.

Units: mm, N, s, rad. See `needleplan.models.base` for what a model is.
"""

from needleplan.models.base import Channel, LinearStateModel, Model
from needleplan.models.fit import Estimate, Fit, FitStatus, fit
from needleplan.models.force import ForceModel1, ForceModel2
from needleplan.models.parameter import Parameter, Scale, constant, parameter
from needleplan.models.simulate import Trajectory, simulate

__all__ = [
    "Channel",
    "Estimate",
    "Fit",
    "FitStatus",
    "ForceModel1",
    "ForceModel2",
    "LinearStateModel",
    "Model",
    "Parameter",
    "Scale",
    "Trajectory",
    "constant",
    "fit",
    "parameter",
    "simulate",
]
