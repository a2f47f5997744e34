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
from needleplan.planning._mdp_reachability import Reachability, reachability

__all__ = [
    "AverageCost",
    "Dependencies",
    "FiniteHorizon",
    "Reachability",
    "Solution",
    "TabularMdp",
    "average_cost",
    "dependencies",
    "evaluate",
    "finite_horizon",
    "q_values",
    "reachability",
    "solve",
    "value_iteration",
]
