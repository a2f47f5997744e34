"""The solver for anybody's finite Markov decision process: see `needleplan.planning._mdp`."""

from needleplan.planning._mdp import Dependencies, Solution, TabularMdp, dependencies, solve, value_iteration

__all__ = ["Dependencies", "Solution", "TabularMdp", "dependencies", "solve", "value_iteration"]
