"""Baseline that an experienced user would write: value iteration in numba, on the same compressed sparse rows."""

import numba
import numpy as np
from contest import Answer, Prepare, Solve
from problem import Problem


@numba.njit
def alternating(offsets, successors, probabilities, costs, discount, threshold, limit):  # type: ignore[no-untyped-def]
    """Gauss-Seidel sweeps, alternately forwards and backwards, until all changes are below `threshold`."""
    values, sweeps, change = np.zeros(len(costs) // 2), 0, np.inf
    while change >= threshold and sweeps < limit:
        change = 0.0
        for index in range(len(values)):
            state = index if sweeps % 2 == 0 else len(values) - 1 - index
            best = np.inf
            for row in range(2 * state, 2 * state + 2):
                expected = 0.0
                for entry in range(offsets[row], offsets[row + 1]):
                    expected += probabilities[entry] * values[successors[entry]]
                best = min(best, costs[row] + discount * expected)
            change = max(change, abs(best - values[state]))
            values[state] = best
        sweeps += 1
    return values, sweeps


@numba.njit(parallel=True)
def jacobi(offsets, successors, probabilities, costs, discount, threshold, limit):  # type: ignore[no-untyped-def]
    """Plain (Jacobi) value iteration on all cores, with the stop rule of `alternating`."""
    values, sweeps, change = np.zeros(len(costs) // 2), 0, np.inf
    new = np.zeros_like(values)
    while change >= threshold and sweeps < limit:
        change = 0.0
        for state in numba.prange(len(values)):
            best = np.inf
            for row in range(2 * state, 2 * state + 2):
                expected = 0.0
                for entry in range(offsets[row], offsets[row + 1]):
                    expected += probabilities[entry] * values[successors[entry]]
                best = min(best, costs[row] + discount * expected)
            change = max(change, abs(best - values[state]))
            new[state] = best
        values, new = new, values
        sweeps += 1
    return values, sweeps


def prepare(kernel_name: str) -> Prepare:
    """Return the function that prepares a solver with the kernel of this name; preparing it compiles the kernel."""

    def compiled(problem: Problem) -> Solve:
        kernel = {"alternating": alternating, "jacobi": jacobi}[kernel_name]
        arrays = (problem.row_offsets, problem.successors, problem.probabilities, problem.costs)

        def solve(limit: int = 10_000) -> Answer:
            values, sweeps = kernel(*arrays, problem.discount, problem.threshold, limit)
            return Answer(lambda: values, {"sweeps": sweeps})

        solve(limit=1)
        return solve

    return compiled
