"""Segmented anatomies: volumes, labels, the frame of the lattice, and invented phantoms.

World coordinates are RAS mm. Research software: not for use on patients.
"""

from needleplan.anatomy._anatomy import Anatomy
from needleplan.anatomy._breathing import Breathing
from needleplan.anatomy._case import AnatomyCase, CaseChoices, CaseStructure, read_case
from needleplan.anatomy._case_text import case_files, write_case
from needleplan.anatomy._drawing import (
    draw_bodies,
    draw_letters,
    draw_near,
    draw_slice,
    slice_note,
    slice_widths,
    target_slices,
)
from needleplan.anatomy._file import (
    AnatomyFile,
    AnatomyRegions,
    NamedEntry,
    NamedTarget,
    Region,
    SpaceLattice,
    SpaceNeedle,
    SpaceObjective,
    Sphere,
    TissueCurvature,
)
from needleplan.anatomy._frame import SpaceFrame, frame_of, nearest_labels
from needleplan.anatomy._grid import AnatomyGrid, TargetBody, grid_of, grids_of
from needleplan.anatomy._labels import read_color_table, read_volume
from needleplan.anatomy._limits import HalfSpace, SpaceLimits
from needleplan.anatomy._nifti import image_bytes, nifti_bytes
from needleplan.anatomy._phantom import PHANTOMS, phantom_files, write_phantom
from needleplan.anatomy._risk import obstacle_distances
from needleplan.anatomy._roles import StructureRole, role_by_name
from needleplan.anatomy._scenario import SpaceScenario
from needleplan.anatomy._transform import TRANSFORM_ENDINGS, pose_matrix, require_transform_name, transform_bytes
from needleplan.anatomy._volume import LabelVolume
from needleplan.anatomy._voxels import FREE, OBSTACLE, OUTSIDE, TARGET, crossed_voxels, entered_cells, possible_codes

__all__ = [
    "FREE",
    "OBSTACLE",
    "OUTSIDE",
    "PHANTOMS",
    "TARGET",
    "TRANSFORM_ENDINGS",
    "Anatomy",
    "AnatomyCase",
    "AnatomyFile",
    "AnatomyGrid",
    "AnatomyRegions",
    "Breathing",
    "CaseChoices",
    "CaseStructure",
    "HalfSpace",
    "LabelVolume",
    "NamedEntry",
    "NamedTarget",
    "Region",
    "SpaceFrame",
    "SpaceLattice",
    "SpaceLimits",
    "SpaceNeedle",
    "SpaceObjective",
    "SpaceScenario",
    "Sphere",
    "StructureRole",
    "TargetBody",
    "TissueCurvature",
    "case_files",
    "crossed_voxels",
    "draw_bodies",
    "draw_letters",
    "draw_near",
    "draw_slice",
    "entered_cells",
    "frame_of",
    "grid_of",
    "grids_of",
    "image_bytes",
    "nearest_labels",
    "nifti_bytes",
    "obstacle_distances",
    "phantom_files",
    "pose_matrix",
    "possible_codes",
    "read_case",
    "read_color_table",
    "read_volume",
    "require_transform_name",
    "role_by_name",
    "slice_note",
    "slice_widths",
    "target_slices",
    "transform_bytes",
    "write_case",
    "write_phantom",
]
