"""The solver for anybody's finite Markov decision process: see `needleplan.planning._mdp`."""

from needleplan.planning._mdp import Dependencies, Solution, dependencies, solve, value_iteration
from needleplan.planning._mdp_criteria import (
    AverageCost,
    FiniteHorizon,
    average_cost,
    evaluate,
    finite_horizon,
    q_values,
)
from needleplan.planning._mdp_problem import TabularMdp

__all__ = [
    "AverageCost",
    "Dependencies",
    "FiniteHorizon",
    "Solution",
    "TabularMdp",
    "average_cost",
    "dependencies",
    "evaluate",
    "finite_horizon",
    "q_values",
    "solve",
    "value_iteration",
]
