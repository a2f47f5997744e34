"""A slow, plain twin of the planner: the stochastic MDP of a bevel-tip needle, solved by value iteration.

It shares no code with the package. It exists to be read beside the definition and to be believed:

* Grid points x = i*dx, y = j*dy that cover the workspace, headings theta_k = k*alpha with alpha = 2*pi/headings,
  bevel b in {-1, +1}.
* Action 0 inserts (b' = b), action 1 rotates and inserts (b' = -b). A step is an arc of length rho*alpha:
  x' = x + rho*b'*(sin(theta + b'*alpha) - sin(theta)),  y' = y - rho*b'*(cos(theta + b'*alpha) - cos(theta)),
  with the rho of the grid point (`radius_at`).
* The points of the arc at t = 1/S, ..., 1 are tested in order: outside the closed workspace, inside or on a polygon,
  within the target radius. The first event ends the execution.
* "nearest": otherwise the tip lands on the nearest grid point; an obstacle point is a collision, a target point the
  target. "interpolated": otherwise the value is bilinear in x and y, where an obstacle corner carries the collision
  cost, a corner outside the grid the exit cost and a target corner 0.
* The heading index becomes k + b' + m, where m has the probabilities `tip_noise` = [P(0), P(+-1), P(+-2)].
* V(s) = min over actions of stage cost + discount * E V(s').

`build` follows every arc once, for the new bevel: both actions of both bevels read the same arcs. `explicit` writes
the same chain out as arrays over states, actions and taps.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from oracle_arc import (
    BEVELS,
    FREE,
    GOAL,
    GOES_ON,
    OBSTACLE,
    Floats,
    Ints,
    Kinds,
    Problem,
    bilinear_corners,
    follow_arc,
    limits_from,
    nearest_index,
    point_event,
    price_at,
    radius_at,
)


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


@dataclass(frozen=True)
class Solution:
    """Axes [x, y, heading, bevel]. `gap` is |Q_insert - Q_rotate|; 0 at absorbing points and where values are inf."""

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
    places = np.broadcast_arrays(x1[:, None], y1[None, :])
    insertion = (price_at(problem, *places) * problem.alpha * radius_at(problem, *places))[:, :, None, None]
    return Mdp(problem, kind, ending, corner, weight, float(tie[goes_on].min(initial=np.inf)), insertion)


def expectation(mdp: Mdp, table: Floats, outside: float, at_ending: Floats) -> Floats:
    """E table(s') after an arc, axes [x, y, heading, new bevel]; `at_ending[e]` is the result of the event e."""
    problem = mdp.problem
    over_noise = sum(p * np.roll(table, -m, axis=2) for m, p in problem.noise.items())  # index k + m at k
    cells = np.asarray(over_noise).reshape(problem.nx * problem.ny, problem.headings, 2)
    cells = np.concatenate([cells, np.full((1, problem.headings, 2), outside)])
    k, new = np.meshgrid(np.arange(problem.headings), (0, 1), indexing="ij")
    turned = (k + np.array(BEVELS)[new]) % problem.headings
    result = np.zeros(mdp.ending.shape)
    for c in range(mdp.corner.shape[-1]):
        result += mdp.weight[..., c] * cells[mdp.corner[..., c], turned, new]
    return np.where(mdp.ending == GOES_ON, result, at_ending[mdp.ending])


def with_absorbing(mdp: Mdp, table: Floats, obstacle: float, goal: float) -> Floats:
    """Fill in the value of the absorbing grid points."""
    kind = mdp.kind[:, :, None, None]
    return np.where(kind == OBSTACLE, obstacle, np.where(kind == GOAL, goal, table))


def action_values(mdp: Mdp, values: Floats) -> Floats:
    """Q[..., action]: action 0 keeps the bevel, action 1 reverses it and pays the rotation."""
    problem = mdp.problem
    failure = np.array([0.0, problem.exit, problem.collision, 0.0])[mdp.ending]
    outside = problem.exit if problem.interpolated else 0.0
    onward = problem.discount * expectation(mdp, values, outside, np.zeros(4))
    insert = mdp.insertion + failure + onward
    return np.stack([insert, insert[..., ::-1] + problem.rotation], axis=-1)


def success_of(mdp: Mdp, policy: NDArray[np.uint8], residual: float = 1e-10, max_sweeps: int = 100_000) -> Floats:
    """Probability of reaching the target under any policy: the smallest solution, iterated up from zero."""
    success = with_absorbing(mdp, np.zeros(policy.shape), 0.0, 1.0)
    for _ in range(max_sweeps):
        onward = expectation(mdp, success, 0.0, np.array([0.0, 0.0, 0.0, 1.0]))
        after = with_absorbing(mdp, np.where(policy == 0, onward, onward[..., ::-1]), 0.0, 1.0)
        change, success = float(np.max(np.abs(after - success))), after
        if change <= residual:
            return success
    raise RuntimeError(f"success did not converge: {change}")


def may_end(mdp: Mdp) -> NDArray[np.bool_]:
    """States from which some policy ends with probability one; without discount all others cost infinitely much.

    Nearest transitions have traps: steps shorter than half a cell never leave it. Largest set R such that from every
    state of R an end can be reached by actions whose successors all lie in R.
    """
    allowed = np.ones(mdp.ending.shape, dtype=bool)
    while True:
        leaves = expectation(mdp, np.where(allowed, 0.0, 1.0), 0.0, np.zeros(4)) > 0.0
        reached, grown = np.zeros_like(allowed), with_absorbing(mdp, np.zeros(allowed.shape), 1.0, 1.0) > 0.0
        while np.any(grown != reached):
            reached = grown
            arc = ~leaves & (expectation(mdp, np.where(reached, 1.0, 0.0), 1.0, np.ones(4)) > 0.0)
            grown = reached | arc | arc[..., ::-1]
        if np.array_equal(reached, allowed):
            return allowed
        allowed = reached


def solve(mdp: Mdp, residual: float = 1e-10, max_sweeps: int = 100_000) -> Solution:
    """Plain value iteration (Jacobi) from zero, until a sweep changes no value by more than `residual`."""
    problem = mdp.problem
    obstacle = problem.collision if problem.interpolated else 0.0
    finite = may_end(mdp) if problem.discount == 1.0 else np.ones(mdp.ending.shape, dtype=bool)
    leaves = expectation(mdp, np.where(finite, 0.0, 1.0), 0.0, np.zeros(4)) > 0.0
    forbidden = np.stack([leaves, leaves[..., ::-1]], axis=-1)
    values = with_absorbing(mdp, np.zeros(mdp.ending.shape), obstacle, 0.0)
    change, sweeps = np.inf, 0
    while change > residual:
        if sweeps == max_sweeps:
            raise RuntimeError(f"value iteration did not converge: {change}")
        q = np.where(forbidden, np.inf, action_values(mdp, values))
        after = with_absorbing(mdp, np.where(finite, q.min(axis=-1), 0.0), obstacle, 0.0)
        change, values, sweeps = float(np.max(np.abs(after - values))), after, sweeps + 1
    free = (mdp.kind == FREE)[:, :, None, None]
    policy = ((q[..., 1] < q[..., 0]) & free).astype(np.uint8)
    gap = np.zeros(values.shape)
    np.subtract(q[..., 1], q[..., 0], out=gap, where=free & finite)
    values = np.where(finite, values, np.inf)
    return Solution(values, policy, np.abs(gap), success_of(mdp, policy), q, change, sweeps)


def explicit(mdp: Mdp) -> tuple[Ints, Floats, Floats]:
    """The "nearest" chain as arrays: successors [n, 2, taps] (-1: over), tap probabilities, stage costs [n, 2].

    States are numbered in C order of [x, y, heading, bevel]; rows of absorbing points are all -1, with cost 0.
    """
    problem = mdp.problem
    shape = mdp.ending.shape
    k, bevel = np.arange(problem.headings)[:, None], np.array((0, 1))[None, :]
    free = (mdp.kind == FREE)[:, :, None, None]
    failure = np.array([0.0, problem.exit, problem.collision, 0.0])[mdp.ending]
    successor = np.full((*shape, 2, len(problem.noise)), -1, dtype=np.int64)
    cost = np.zeros((*shape, 2))
    for action in (0, 1):
        new = bevel if action == 0 else 1 - bevel
        ending, cell, over = mdp.ending[:, :, k, new], mdp.corner[:, :, k, new, 0], failure[:, :, k, new]
        cost[..., action] = np.where(free, mdp.insertion + action * problem.rotation + over, 0.0)
        for tap, m in enumerate(problem.noise):
            heading = (k + np.array(BEVELS)[new] + m) % problem.headings
            state = (cell * problem.headings + heading) * 2 + new
            successor[..., action, tap] = np.where(free & (ending == GOES_ON), state, -1)
    n = int(np.prod(shape))
    return successor.reshape(n, 2, -1), np.array(list(problem.noise.values())), cost.reshape(n, 2)
