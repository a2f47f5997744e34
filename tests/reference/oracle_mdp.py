"""A slow, plain twin of the planner: the stochastic MDP of a bevel-tip needle, solved by value iteration.

It shares no code with the package. It exists to be read beside the definition and to be believed:

* Grid points x = i*dx, y = j*dy that cover the workspace, headings theta_k = k*alpha with alpha = 2*pi/headings,
  bevel b in {-1, +1}.
* Action 0 inserts (b' = b), action 1 rotates and inserts (b' = -b). A step is an arc of length L = rho*alpha, or
  `step_mm`, that turns by phi = L/rho:
  x' = x + rho*b'*(sin(theta + b'*phi) - sin(theta)),  y' = y - rho*b'*(cos(theta + b'*phi) - cos(theta)),
  with the rho of the grid point (`radius_at`).
* Action 2, if the scenario has it, is a straight step (b' = b): the same L, the radius rho/q, hence phi = q*L/rho.
  q = 0 is a line.
* The points of the arc at t = 1/S, ..., 1 are tested in order: outside the closed workspace, inside or on a polygon,
  within the target radius. The first event ends the execution.
* "nearest": otherwise the tip lands on the nearest grid point; an obstacle point is a collision, a target point the
  target. "interpolated": otherwise the value is bilinear in x and y, where an obstacle corner carries the collision
  cost, a corner outside the grid the exit cost and a target corner 0.
* The heading index becomes k + b' + m, where m has the probabilities `tip_noise` = [P(0), P(+-1), P(+-2)]. A turn or
  a noise step that is no whole number of headings is split over whole ones (`heading_spread`).
* V(s) = min over actions of stage cost + discount * E V(s').
* Success of a policy: the same chain with 1 at the target, 0 at failures, no discount. With "interpolated", the success
  where a step ends is read as `tests/reference/oracle_success.py` says.

`build` follows every arc once, for the new bevel: both actions of both bevels read the same arcs. Straight steps have
an `Mdp` of their own (`Mdp.straight`). `explicit` writes the same chain out as arrays over states, actions and taps.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial, reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray
from oracle_arc import (
    BEVELS,
    FREE,
    GOAL,
    GOES_ON,
    OBSTACLE,
    TARGET,
    Floats,
    Ints,
    Kinds,
    Problem,
    bilinear_corners,
    follow_arc,
    heading_spread,
    length_at,
    limits_from,
    nearest_index,
    point_event,
    price_at,
)
from oracle_success import interpolated_success


@dataclass(frozen=True)
class Mdp:
    """What one arc does from every grid state. Axes [x, y, heading, new bevel], plus [corner] where there is one.

    A corner is a flat grid index i*ny + j; nx*ny stands for "outside the grid". "nearest" has one corner, weight 1.
    """

    problem: Problem
    kind: Kinds  # [nx, ny]
    ending: Kinds
    corner: Ints
    weight: Floats
    tie_mm: float  # smallest distance of an end point from the halfway line between two grid points
    insertion: Floats  # cost of the length of a step, by the grid point where it starts; axes [x, y, 1, 1]
    spread: dict[int, float]  # headings by which bevel +1 turns -> probability; bevel -1 turns to the other side
    end: tuple[Floats, Floats]  # x and y where the arc ends
    straight: "Mdp | None" = None  # the same for straight steps; its new bevel is the old one


@dataclass(frozen=True)
class Solution:
    """Axes [x, y, heading, bevel]. `gap`: second smallest minus smallest Q; 0 at absorbing points and if V is inf."""

    values: Floats
    policy: NDArray[np.uint8]
    gap: Floats
    success: Floats
    q: Floats  # [..., action]
    residual: float
    sweeps: int


def build(problem: Problem) -> Mdp:
    """Follow the arc from every grid point, heading and new bevel."""
    x1, y1 = np.arange(problem.nx) * problem.dx, np.arange(problem.ny) * problem.dy
    points = np.broadcast_arrays(x1[:, None], y1[None, :])
    # The grid covers the workspace. A last grid line beyond the edge is the edge for the steps that start there.
    kind = point_event(problem, *points, limits_from(problem, *points))
    theta, bevel = np.arange(problem.headings) * problem.alpha, np.array(BEVELS)
    grids = np.meshgrid(x1, y1, theta, bevel, indexing="ij")
    ending, x_end, y_end = follow_arc(problem, *grids)
    if problem.interpolated:
        corner, weight = bilinear_corners(problem, x_end, y_end)
    else:
        i, j = nearest_index(x_end, problem.dx), nearest_index(y_end, problem.dy)
        i, j = np.clip(i, 0, problem.nx - 1), np.clip(j, 0, problem.ny - 1)
        ending = np.where(ending == GOES_ON, kind[i, j], ending)
        corner, weight = (i * problem.ny + j)[..., None], np.ones((*i.shape, 1))
    goes_on = ending == GOES_ON
    tie = np.minimum(
        np.abs(x_end / problem.dx % 1.0 - 0.5) * problem.dx, np.abs(y_end / problem.dy % 1.0 - 0.5) * problem.dy
    )
    insertion = (price_at(problem, *points) * length_at(problem, *points))[:, :, None, None]
    tie_mm, spread = float(tie[goes_on].min(initial=np.inf)), heading_spread(problem)
    straight = None if problem.straight is None else build(problem.straight)
    return Mdp(problem, kind, ending, corner, weight, tie_mm, insertion, spread, (x_end, y_end), straight)


def with_noise(mdp: Mdp, table: Floats) -> Floats:
    """E table after the heading has changed, by the heading before and the new bevel."""
    turned = np.zeros(table.shape)
    for new, bevel in enumerate(BEVELS):
        for headings, p in mdp.spread.items():  # index k + bevel * headings at k
            turned[..., new] += p * np.roll(table[..., new], -bevel * headings, axis=2)
    return turned


def success_after(mdp: Mdp, table: Floats) -> Floats:
    """The success after an arc, axes [x, y, heading, new bevel]."""
    problem = mdp.problem
    k = np.arange(problem.headings)[None, None, :, None]
    new = np.array((0, 1))[None, None, None, :]
    read = interpolated_success(
        problem, mdp.kind != OBSTACLE, with_noise(mdp, table), mdp.end, (k, new), k * problem.alpha
    )
    return np.where(mdp.ending == GOES_ON, read, mdp.ending == TARGET)


def expectation(mdp: Mdp, table: Floats, outside: float, at_ending: Floats) -> Floats:
    """E table(s') after an arc, axes [x, y, heading, new bevel]; `at_ending[e]` is the result of the event e."""
    problem = mdp.problem
    turned = with_noise(mdp, table)
    cells = turned.reshape(problem.nx * problem.ny, problem.headings, 2)
    cells = np.concatenate([cells, np.full((1, problem.headings, 2), outside)])
    k, new = np.meshgrid(np.arange(problem.headings), (0, 1), indexing="ij")
    result = np.zeros(mdp.ending.shape)
    for c in range(mdp.corner.shape[-1]):
        result += mdp.weight[..., c] * cells[mdp.corner[..., c], k, new]
    return np.where(mdp.ending == GOES_ON, result, at_ending[mdp.ending])


def with_absorbing(mdp: Mdp, table: Floats, obstacle: float, goal: float) -> Floats:
    """Fill in the value of the absorbing grid points."""
    kind = mdp.kind[:, :, None, None]
    return np.where(kind == OBSTACLE, obstacle, np.where(kind == GOAL, goal, table))


def by_action(mdp: Mdp, of_steps: Callable[[Mdp], NDArray[Any]], rotation: float = 0.0) -> NDArray[Any]:
    """[..., action] from a number of each step by its new bevel: insert, rotate (plus `rotation`), straight."""
    insert = of_steps(mdp)
    actions = [insert, insert[..., ::-1] + rotation if rotation else insert[..., ::-1]]
    return np.stack(actions if mdp.straight is None else [*actions, of_steps(mdp.straight)], axis=-1)


def action_values(mdp: Mdp, values: Floats) -> Floats:
    """Q[..., action]: action 0 keeps the bevel, action 1 reverses it and pays the rotation, action 2 is straight."""
    problem = mdp.problem
    outside = problem.exit if problem.interpolated else 0.0

    def of_steps(steps: Mdp) -> Floats:
        failure = np.array([0.0, problem.exit, problem.collision, 0.0])[steps.ending]
        return steps.insertion + failure + problem.discount * expectation(steps, values, outside, np.zeros(4))

    return by_action(mdp, of_steps, problem.rotation)


class NotConverged(RuntimeError):
    """The iteration did not converge within its sweeps."""


def success_of(mdp: Mdp, policy: NDArray[np.uint8], residual: float = 1e-10, max_sweeps: int = 100_000) -> Floats:
    """Probability of reaching the target under any policy: the smallest solution, iterated up from zero."""
    success = with_absorbing(mdp, np.zeros(policy.shape), 0.0, 1.0)
    reaches = np.array([0.0, 0.0, 0.0, 1.0])
    for _ in range(max_sweeps):
        if mdp.problem.interpolated:
            onward = by_action(mdp, partial(success_after, table=success))
        else:
            onward = by_action(mdp, partial(expectation, table=success, outside=0.0, at_ending=reaches))
        chosen = np.take_along_axis(onward, policy[..., None].astype(np.int64), axis=-1)[..., 0]
        after = with_absorbing(mdp, chosen, 0.0, 1.0)
        change, success = float(np.max(np.abs(after - success))), after
        if change <= residual:
            return success
    raise NotConverged(f"success after {max_sweeps} sweeps: {change}")


def may_end(mdp: Mdp) -> NDArray[np.bool_]:
    """States from which some policy ends with probability one; without discount all others cost infinitely much.

    Nearest transitions have traps: steps shorter than half a cell never leave it. Largest set R such that from every
    state of R an end can be reached by actions whose successors all lie in R.
    """
    allowed = np.ones(mdp.ending.shape, dtype=bool)
    while True:
        leaves = leaving(mdp, allowed)
        reached, grown = np.zeros_like(allowed), with_absorbing(mdp, np.zeros(allowed.shape), 1.0, 1.0) > 0.0
        while np.any(grown != reached):
            reached = grown
            ends = partial(expectation, table=np.where(reached, 1.0, 0.0), outside=1.0, at_ending=np.ones(4))
            grown = reached | np.any(~leaves & (by_action(mdp, ends) > 0.0), axis=-1)
        if np.array_equal(reached, allowed):
            return allowed
        allowed = reached


def leaving(mdp: Mdp, allowed: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The actions, [..., action], that may lead out of a set of states."""
    outside = partial(expectation, table=np.where(allowed, 0.0, 1.0), outside=0.0, at_ending=np.zeros(4))
    return by_action(mdp, outside) > 0.0


def solve(mdp: Mdp, residual: float = 1e-10, max_sweeps: int = 100_000) -> Solution:
    """Plain value iteration (Jacobi) from zero, until a sweep changes no value by more than `residual`."""
    problem = mdp.problem
    obstacle = problem.collision if problem.interpolated else 0.0
    finite = may_end(mdp) if problem.discount == 1.0 else np.ones(mdp.ending.shape, dtype=bool)
    forbidden = leaving(mdp, finite)
    values = with_absorbing(mdp, np.zeros(mdp.ending.shape), obstacle, 0.0)
    change, sweeps = np.inf, 0
    while change > residual:
        if sweeps == max_sweeps:
            raise NotConverged(f"values after {max_sweeps} sweeps: {change}")
        q = np.where(forbidden, np.inf, action_values(mdp, values))
        least = reduce(np.minimum, np.moveaxis(q, -1, 0))  # q.min(axis=-1), which takes ten times as long
        after = with_absorbing(mdp, np.where(finite, least, 0.0), obstacle, 0.0)
        change, values, sweeps = float(np.max(np.abs(after - values))), after, sweeps + 1
    free = (mdp.kind == FREE)[:, :, None, None]
    policy = (np.argmin(q, axis=-1) * free).astype(np.uint8)
    gap, ordered = np.zeros(values.shape), np.sort(q, axis=-1)
    np.subtract(ordered[..., 1], ordered[..., 0], out=gap, where=free & finite)
    values = np.where(finite, values, np.inf)
    return Solution(values, policy, gap, success_of(mdp, policy, max_sweeps=max_sweeps), q, change, sweeps)
