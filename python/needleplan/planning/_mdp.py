"""The solver for any finite Markov decision process.

It minimises the expected discounted cost V(s) = min_a [c(s, a) + discount * sum_s' P(s' | s, a) V(s')].
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.artifacts import CallRepr, ShortRepr
from needleplan.config import Choice, Integer, Maybe, Number
from needleplan.errors import MdpError, Mistake
from needleplan.extras.progress_bar import progress_bar, solve_text
from needleplan.planning._lattice import Progress, Stats, compiled_call, require_callable, stats_of
from needleplan.planning._mdp_input import argument, labels_of, numbers
from needleplan.planning._mdp_problem import TabularMdp
from needleplan.scenario import Priority

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["Dependencies", "Solution", "dependencies", "require_mdp", "solve", "solved_by", "value_iteration"]


class _MdpMethod(StrEnum):
    """Algorithm that solves a tabular MDP."""

    AUTO = "auto"
    POLICY = "pi"
    MODIFIED = "mpi"
    SWEEP = "sweep"
    PPVI = "ppvi"
    VALUE_ITERATION = "vi"


@dataclass(frozen=True, eq=False)
class Solution(ShortRepr):
    """The solution of a Markov decision process.

    Attributes
    ----------
    values : ndarray of float64, shape (S,)
        Optimal expected costs, or rewards if the process has rewards.
    policy : ndarray of uint32, shape (S,)
        Number of the best action in every state.
    stats : Stats
        How the solve went; `stats.error_bound` bounds the error of every value.
    method : str
        The method that computed the values: that of the argument, or the choice of "auto" ("sweep" or "pi").

    Examples
    --------
    >>> import needleplan as npl
    >>> forever = npl.mdp.TabularMdp([[[1.0]]], costs=[[1.0]], discount=0.5)
    >>> npl.mdp.solve(forever, tolerance=1e-9).values.round(6)
    array([2.])
    """

    values: NDArray[np.float64]
    policy: NDArray[np.uint32]
    stats: Stats
    method: str = "auto"


def solve(
    mdp: TabularMdp,
    *,
    method: str = _MdpMethod.AUTO,
    start: ArrayLike | None = None,
    labels: ArrayLike | None = None,
    priority: str = Priority.H2,
    tolerance: float = 0.01,
    max_sweeps: int | None = None,
    time_limit_s: float | None = None,
    threads: int | None = None,
    progress: Progress | bool | None = None,
) -> Solution:
    """Solve a Markov decision process.

    Parameters
    ----------
    mdp : TabularMdp
        The process.
    method : {"auto", "pi", "mpi", "sweep", "ppvi", "vi"}, default "auto"
        "pi": policy iteration, by strongly connected components in order. "mpi": the same with 20 sweeps for every
        evaluation of a policy (modified policy iteration). "sweep": directional sweeps. "ppvi": prioritized-partitioned
        value iteration. "vi": plain value iteration. "auto": if the process has 16,384 states or more and the rows of
        most repeat, as on a lattice, up to 16 directional sweeps; if they do not suffice, components in order, where a
        policy is evaluated by 4 sweeps, or by solving its equations where sweeps converge slowly.
    start : array_like of float, shape (S,), optional
        Values from which to start, for the methods "auto", "pi" and "mpi". Without it, 0.
    labels : array_like of int, shape (S,), optional
        Number of the partition of every state.
    priority : {"H1", "H2", "bound"}, default "H2"
        Priority of a partition, for the method "ppvi".
    tolerance : float, default 0.01
        Largest error of a value. The solve ends with the status "converged" once `stats.error_bound` is at most this,
        or with "precision_limit" if rounding does not allow it.
    max_sweeps : int, optional
        Number of sweeps after which the solve ends in any case.
    time_limit_s : float, optional
        Time in s by which the solve ends: no sweep but the first begins after which it would probably end later.
    threads : int, optional
        Number of threads, from 1 to 1024. Without it, one per processor core.
    progress : callable or bool, optional
        As for `plan`: True shows a bar; a function is called with sweeps, residual and threshold at most every 0.05 s,
        and at the end. An exception that it raises abandons the solve; StopIteration ends it with the values so far and
        the status "interrupted".

    Returns
    -------
    Solution
        Values, policy and statistics.

    Raises
    ------
    MdpError
        If an argument is wrong.

    Examples
    --------
    >>> import needleplan as npl
    >>> wait, repair = [[0.9, 0.1], [0.0, 1.0]], [[1.0, 0.0], [1.0, 0.0]]
    >>> machine = npl.mdp.TabularMdp([wait, repair], costs=[[0.0, 5.0], [2.0, 5.0]], discount=0.9)
    >>> solution = npl.mdp.solve(machine, tolerance=1e-9)
    >>> solution.policy, solution.values.round(3)
    (array([0, 1], dtype=uint32), array([4.128, 8.716]))
    """
    require_mdp(mdp)
    if not isinstance(progress, bool):
        require_callable(progress, MdpError)
    chosen = argument("method", Choice(_MdpMethod), method)
    if start is not None and chosen in (_MdpMethod.SWEEP, _MdpMethod.PPVI, _MdpMethod.VALUE_ITERATION):
        raise MdpError(Mistake("start", repr(start), 'needs the method "auto", "pi" or "mpi"'))
    with progress_bar(progress is True) as show:
        return solved_by(
            mdp,
            mdp.compiled,
            method=chosen,
            start=None if start is None else np.ascontiguousarray(mdp.sign * numbers("start", start)),
            labels=None if labels is None else labels_of(labels, mdp.states),
            priority=argument("priority", Choice(Priority), priority).value,
            tolerance=argument("tolerance", Number(above=0), tolerance),
            max_sweeps=argument("max_sweeps", Maybe(Integer(0, 2**31 - 1)), max_sweeps),
            time_limit_s=argument("time_limit_s", Maybe(Number("s", at_least=0)), time_limit_s),
            threads=argument("threads", Maybe(Integer(1, 1024)), threads),
            progress=(lambda *state: show(solve_text(*state))) if isinstance(progress, bool) else progress,
        )


def solved_by(
    mdp: TabularMdp, compiled: Any, *, method: _MdpMethod | str = _MdpMethod.AUTO, **options: Any
) -> Solution:
    """Solve a compiled process with the actions of `mdp`, and return the solution in the units of `mdp`."""
    began = perf_counter()
    solved = compiled_call(MdpError, compiled.solve, method=str(method), **options)
    stats = stats_of(solved, mdp.states, perf_counter() - began)
    if method == _MdpMethod.AUTO:
        method = _MdpMethod.SWEEP if stats.order else _MdpMethod.POLICY
    values = mdp.sign * solved["values"] + 0.0 if mdp.rewards else solved["values"]
    return Solution(values, mdp.actions_of(solved["policy"]), stats, str(method))


def value_iteration(
    mdp: TabularMdp, *, tolerance: float = 0.01, max_sweeps: int | None = None, progress: Progress | bool | None = None
) -> Solution:
    """Solve a Markov decision process by plain value iteration, the reference for the other methods.

    Parameters
    ----------
    mdp : TabularMdp
        The process.
    tolerance : float, default 0.01
        Largest error of a value.
    max_sweeps : int, optional
        Number of sweeps after which the solve ends in any case.
    progress : callable or bool, optional
        As for `solve`.

    Returns
    -------
    Solution
        Values, policy and statistics.

    Raises
    ------
    MdpError
        If an argument is wrong.

    Examples
    --------
    >>> import needleplan as npl
    >>> forever = npl.mdp.TabularMdp([[[1.0]]], costs=[[1.0]], discount=0.5)
    >>> npl.mdp.value_iteration(forever, tolerance=1e-9).values.round(6)
    array([2.])
    """
    return solve(mdp, method=_MdpMethod.VALUE_ITERATION, tolerance=tolerance, max_sweeps=max_sweeps, progress=progress)


@dataclass(frozen=True, eq=False)
class Dependencies(CallRepr):
    """Dependency maps of states and partitions (Table 6.1 of the thesis).

    Attributes
    ----------
    states : tuple of ndarray of uint32
        For every state, the states that have an action leading to it (SDS).
    partitions : tuple of dict
        For every partition, the partitions that depend on it (PDP), each with its states that depend on it (SDP). A
        partition depends on itself if a step can stay inside.

    Examples
    --------
    >>> import needleplan as npl
    >>> forth = npl.mdp.TabularMdp([[[0.0, 1.0], [0.0, 1.0]]], costs=[[1.0], [1.0]], discount=0.5)
    >>> npl.mdp.dependencies(forth, labels=[0, 1]).states[1]
    array([0, 1], dtype=uint32)
    """

    states: tuple[NDArray[np.uint32], ...]
    partitions: tuple[dict[int, NDArray[np.uint32]], ...]


def dependencies(mdp: TabularMdp, labels: ArrayLike) -> Dependencies:
    """Return the dependency maps of a Markov decision process whose states are divided into partitions.

    Parameters
    ----------
    mdp : TabularMdp
        The process.
    labels : array_like of int, shape (S,)
        Number of the partition of every state.

    Returns
    -------
    Dependencies
        The maps of states and of partitions.

    Raises
    ------
    MdpError
        If `labels` does not hold one whole number per state.

    Examples
    --------
    >>> import needleplan as npl
    >>> forth = npl.mdp.TabularMdp([[[0.0, 1.0], [0.0, 1.0]]], costs=[[1.0], [1.0]], discount=0.5)
    >>> sorted(npl.mdp.dependencies(forth, labels=[0, 1]).partitions[1])
    [0, 1]
    """
    require_mdp(mdp)
    maps = compiled_call(MdpError, mdp.compiled.dependencies, labels_of(labels, mdp.states))
    pairs = np.split(maps["sdp"], maps["sdp_offsets"][1:-1])
    spans = zip(maps["pdp_offsets"][:-1].tolist(), maps["pdp_offsets"][1:].tolist(), strict=True)
    return Dependencies(
        states=tuple(np.split(maps["sds"], maps["sds_offsets"][1:-1])),
        partitions=tuple({int(maps["pdp"][pair]): pairs[pair] for pair in range(*span)} for span in spans),
    )


def require_mdp(mdp: object) -> None:
    """Raise MdpError unless `mdp` is a TabularMdp."""
    if not isinstance(mdp, TabularMdp):
        raise MdpError(Mistake("mdp", repr(mdp), "must be a TabularMdp"))
