"""The scenario: anatomy, target, needle, tip noise, grid, objective and solver, read from and written to TOML."""

from needleplan.scenario.choices import Method, Priority, Transition
from needleplan.scenario.identified import Identified, identified
from needleplan.scenario.parts import (
    Grid,
    Layer,
    Motion,
    Needle,
    Objective,
    Obstacle,
    Solver,
    Target,
    Tissue,
    Workspace,
)
from needleplan.scenario.pieces import Piece, pieces_of, within
from needleplan.scenario.scenario import Scenario
from needleplan.scenario.shipped import shipped

__all__ = [
    "Grid",
    "Identified",
    "Layer",
    "Method",
    "Motion",
    "Needle",
    "Objective",
    "Obstacle",
    "Piece",
    "Priority",
    "Scenario",
    "Solver",
    "Target",
    "Tissue",
    "Transition",
    "Workspace",
    "identified",
    "pieces_of",
    "shipped",
    "within",
]
