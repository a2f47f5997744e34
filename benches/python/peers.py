"""Solvers of other projects, as contestants.

Each gets its preferred input format, good options, and the equivalent of the thesis' stop rule (Bellman residual below
(1 - discount) * tolerance). Most of them maximise rewards, so their costs are negated.
"""

from itertools import pairwise
from typing import Any

import numpy as np
from contest import Answer, Prepare, Solve
from problem import Problem


def quantecon(method: str) -> Prepare:
    """QuantEcon.py: state-action pairs, one scipy matrix; `epsilon` is set so that its stop rule gives the residual."""

    def prepare(problem: Problem) -> Solve:
        from quantecon.markov import DiscreteDP
        from scipy.sparse import csr_matrix

        pairs = np.arange(2 * problem.states)
        mdp = DiscreteDP(-problem.costs, csr_matrix(problem.matrix), problem.discount, pairs // 2, pairs % 2)
        scale = 2 if method == "value_iteration" else 1
        epsilon = scale * problem.discount * problem.tolerance

        def solve() -> Answer:
            solved = mdp.solve(method=method, epsilon=epsilon, max_iter=10_000)
            sweeps = solved.num_iter if method == "value_iteration" else solved.num_iter * (1 + solved.k)
            return Answer(lambda: -solved.v, {"sweeps": sweeps})

        return solve

    return prepare


def mdpsolver(algorithm: str, update: str = "standard", parallel: bool = False) -> Prepare:
    """`mdpsolver`: nested lists. One run per process, as a second solve would start from the values of the first."""

    def prepare(problem: Problem) -> Solve:
        from mdpsolver import model as new_model

        probabilities, columns = _nested(problem)
        model = new_model()
        model.mdp(
            discount=problem.discount,
            rewards=(-problem.costs.reshape(-1, 2)).tolist(),
            tranMatProbs=probabilities,
            tranMatColumns=columns,
        )

        def solve() -> Answer:
            model.solve(algorithm=algorithm, update=update, tolerance=problem.tolerance, parallel=parallel)
            return Answer(lambda: -np.array(model.getValueVector()), {"own_seconds": model.getRuntime() / 1000})

        return solve

    return prepare


def _nested(problem: Problem) -> tuple[list[list[list[float]]], list[list[list[int]]]]:
    """Return probabilities and columns as [state][action][entry]."""
    offsets = problem.row_offsets.tolist()
    nested = []
    for flat in (problem.probabilities.tolist(), problem.successors.tolist()):
        rows = [flat[begin:end] for begin, end in pairwise(offsets)]
        nested.append([rows[row : row + 2] for row in range(0, len(rows), 2)])
    return nested[0], nested[1]


def mdptoolbox(problem: Problem) -> Solve:
    """`pymdptoolbox` (a pre-release): one scipy matrix per action; three of its functions must be replaced.

    They need too much memory or time at this size: `isStochastic` makes a states x states array, `isNonNegative` makes
    a sparse matrix dense, and the bound on the number of iterations slices every column of every matrix. The
    replacements make the same tests on the stored numbers, and set a fixed limit of iterations. The solver stops by the
    span of the change, so its values may differ from the true ones by a constant.
    """
    from mdptoolbox import mdp, util

    def is_stochastic(matrix: Any) -> bool:
        return bool(np.abs(np.asarray(matrix.sum(axis=1)).ravel() - 1).max() <= 1e-9)

    def is_non_negative(matrix: Any) -> bool:
        return bool((matrix.data >= 0).all())

    def bound_iterations(solver: Any, _epsilon: float) -> None:
        solver.max_iter = 10_000

    util.isStochastic = is_stochastic
    util.isNonNegative = is_non_negative
    mdp.ValueIteration._boundIter = bound_iterations
    rewards = -problem.costs.reshape(-1, 2)
    epsilon = problem.discount * problem.tolerance
    solver = mdp.ValueIteration(problem.matrices, rewards, problem.discount, epsilon=epsilon)

    def solve() -> Answer:
        solver.V, solver.iter = np.zeros(problem.states), 0
        solver.run()
        return Answer(lambda: -np.array(solver.V), {"sweeps": solver.iter})

    return solve


def storm(problem: Problem) -> Solve:
    """`stormpy` 2: the discounted total cost by value iteration with an absolute precision, one thread."""
    import stormpy
    from stormpy import environments, models
    from stormpy.datastructures import SparseMatrixBuilder

    matrix = problem.matrix.copy()
    matrix.sort_indices()
    rows = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
    builder = SparseMatrixBuilder[float](
        rows=matrix.shape[0],
        columns=problem.states,
        entries=matrix.nnz,
        has_custom_row_grouping=True,
        row_groups=problem.states,
    )
    groups = range(0, matrix.shape[0], 2)
    builder.add_next_values(rows.tolist(), matrix.indices.tolist(), matrix.data.tolist(), list(groups))
    labeling = models.StateLabeling(problem.states)
    labeling.add_label("init")
    labeling.add_label_to_state("init", 0)
    costs = models.SparseRewardModel[float](optional_state_action_reward_vector=problem.costs.tolist())
    parts = models.SparseModelComponents[float](
        transition_matrix=builder.build(), state_labeling=labeling, reward_models={"cost": costs}
    )
    mdp = models.SparseMdp[float](parts)
    formula = stormpy.parse_properties(f'R{{"cost"}}min=? [ Cdiscount={problem.discount} ]')[0]
    environment = environments.Environment()
    min_max = environment.solver().min_max()
    min_max.method = environments.MinMaxMethod.VALUE_ITERATION
    min_max.precision = stormpy.Rational(str(problem.tolerance))
    min_max.relative_termination_criterion = False

    def solve() -> Answer:
        result = stormpy.model_checking(mdp, formula, environment=environment)
        return Answer(lambda: np.array(result.get_value_vector()))

    return solve
