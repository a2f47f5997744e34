"""The scenario: anatomy, target, needle, tip noise, grid, objective and solver, stored as TOML."""

from needleplan.scenario._curvature_map import PlaneCurvatureMap
from needleplan.scenario._identified import CurvaturePiece, EntryPose, Identified, identified, pieces_of, within
from needleplan.scenario._obstacle import Obstacle
from needleplan.scenario._parts import (
    Grid,
    Layer,
    Method,
    Needle,
    Objective,
    Priority,
    Solver,
    Target,
    TipMotion,
    Tissue,
    Transition,
    Workspace,
)
from needleplan.scenario._scenario import Scenario
from needleplan.scenario._shipped import ShippedScenario, shipped
from needleplan.scenario._svg import read_svg
from needleplan.scenario._template import template

__all__ = [
    "CurvaturePiece",
    "EntryPose",
    "Grid",
    "Identified",
    "Layer",
    "Method",
    "Needle",
    "Objective",
    "Obstacle",
    "PlaneCurvatureMap",
    "Priority",
    "Scenario",
    "ShippedScenario",
    "Solver",
    "Target",
    "TipMotion",
    "Tissue",
    "Transition",
    "Workspace",
    "identified",
    "pieces_of",
    "read_svg",
    "shipped",
    "template",
    "within",
]
