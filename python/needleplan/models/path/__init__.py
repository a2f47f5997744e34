"""Paths of a bevel tip: the bicycle model in the plane and in 3D, and the twist of the needle.

| name | meaning |
|---|---|
| `Bicycle`, `arc_step` | the path in a plane as a model, and one exact arc of it |
| `BicycleByDepth` | the path in a plane with a curvature that changes with the depth |
| `TipFrame` | position and orientation of the tip in 3D; takes exact arcs |
| `SteeredModel`, `SpatialBicycle` | the 3D path as a model: the abstract base class, and circular arcs |
| `ImagePlane` | image plane of an ultrasound probe, in which the tip is seen |
| `path_displacement` | displacement of a 3D path by a small additional curvature |
| `Torsion`, `dragged` | how far the tip lags behind the base when the needle is rotated |
| `TwistedShaft` | slipping and stuck parts of the shaft, torque at the base, release by insertion |
"""

from needleplan.models.path._by_depth import BetweenDepths, Bicycle, BicycleByDepth, arc_step
from needleplan.models.path._displacement import bevel_direction, fixed_direction, path_displacement
from needleplan.models.path._frame import TipFrame, Vector, axes_of, quaternion_of, quaternions_along
from needleplan.models.path._image_plane import ImagePlane
from needleplan.models.path._steered import SpatialBicycle, SteeredModel
from needleplan.models.path._twist import Torsion, TwistedShaft, dragged

__all__ = [
    "BetweenDepths",
    "Bicycle",
    "BicycleByDepth",
    "ImagePlane",
    "SpatialBicycle",
    "SteeredModel",
    "TipFrame",
    "Torsion",
    "TwistedShaft",
    "Vector",
    "arc_step",
    "axes_of",
    "bevel_direction",
    "dragged",
    "fixed_direction",
    "path_displacement",
    "quaternion_of",
    "quaternions_along",
]
