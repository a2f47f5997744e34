"""The solver for anybody's finite Markov decision process: see `needleplan.planning.mdp`."""

from needleplan.planning.mdp import Solution, TabularMdp, solve, value_iteration

__all__ = ["Solution", "TabularMdp", "solve", "value_iteration"]
