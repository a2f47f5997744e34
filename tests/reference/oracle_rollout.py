"""A slow, plain twin of the planner's executions: Monte-Carlo in the continuous bicycle model with heading noise.

The true pose (x, y, theta) is continuous; only the decision uses the table. One step:

1. Decide. "look-up": the policy of the nearest grid state. "greedy": one-step look-ahead from the true pose; the
   value after each action's true arc is read linearly along its tangent, across it, and in the heading, corners as in
   the interpolated MDP (obstacle: collision cost, target: 0, outside the grid: exit cost), expectation over the noise.
2. Follow the true arc and test its points at t = 1/S, ..., 1. Where the radius changes from place to place the arc is
   as long as the radius at its start says, and each of its S equally long pieces has the radius of its own start. A
   straight step has pieces of the same length, with the share q of the curvature of each place. The first event ends
   the run; nothing else does: a tip whose nearest grid point is an obstacle or target point, but which is not there
   itself, goes on.
3. Otherwise turn by m*eta with the probabilities of the tip noise; eta is alpha unless the scenario says otherwise.

A decision is also needed where the nearest grid point is absorbing, and its policy there is not defined: insert.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from oracle_arc import (
    GOAL,
    GOES_ON,
    OBSTACLE,
    TARGET,
    Floats,
    Ints,
    Kinds,
    Problem,
    follow_pieces,
    length_at,
    nearest_index,
    price_at,
    tangent_corners,
)
from oracle_mdp import Mdp

INSERT, INSERT_ROTATED, INSERT_STRAIGHT = 0, 1, 2  # actions


@dataclass(frozen=True)
class Runs:
    """One entry per run. `ending` is GOES_ON where `max_steps` cut the run; costs are discounted like the table."""

    ending: Ints
    cost: Floats
    steps: Ints
    turns: Ints
    length: Floats
    straight: Floats  # length of the straight steps

    @property
    def success(self) -> float:
        return float(np.mean(self.ending == TARGET))


def corner_values(mdp: Mdp, values: Floats) -> Floats:
    """Values as the greedy look-ahead reads them: [nx*ny + 1, headings, 2], last row outside the grid."""
    problem, kind = mdp.problem, mdp.kind[:, :, None, None]
    table = np.where(kind == OBSTACLE, problem.collision, np.where(kind == GOAL, 0.0, values))
    cells = table.reshape(problem.nx * problem.ny, problem.headings, 2)
    return np.concatenate([cells, np.full((1, problem.headings, 2), problem.exit)])


def nearest_heading(problem: Problem, theta: Floats) -> Ints:
    return np.floor(theta / problem.alpha + 0.5).astype(np.int64) % problem.headings


def look_up(problem: Problem, policy: NDArray[np.uint8], x: Floats, y: Floats, theta: Floats, bevel: Ints) -> Ints:
    """The policy's action at the nearest grid state."""
    i = np.clip(nearest_index(x, problem.dx), 0, problem.nx - 1)
    j = np.clip(nearest_index(y, problem.dy), 0, problem.ny - 1)
    return policy[i, j, nearest_heading(problem, theta), (bevel + 1) // 2].astype(np.int64)


def at_heading(problem: Problem, cells: Floats, corner: Ints, weight: Floats, theta: Floats, bevel: Ints) -> Floats:
    """Weighted sum over the corners, [n], linear between the two headings around theta."""
    whole = np.floor(theta / problem.alpha)
    between = np.zeros(len(theta))
    for k, share in ((whole, 1 - (theta / problem.alpha - whole)), (whole + 1, theta / problem.alpha - whole)):
        index = k.astype(np.int64) % problem.headings
        at_corners = cells[corner, index[:, None], ((bevel + 1) // 2)[:, None]]
        between += share * np.sum(weight * at_corners, axis=1)
    return between


def greedy_q(problem: Problem, cells: Floats, x: Floats, y: Floats, theta: Floats, bevel: Ints) -> Floats:
    """Q of all actions at the true poses, [n, actions]; `cells` comes from `corner_values`."""
    q = np.empty((len(x), 2 if problem.straight is None else 3))
    for action in range(q.shape[1]):
        (ending, *reached), new, cost = follow_action(problem, np.full(len(x), action), x, y, theta, bevel)
        corner, weight = tangent_corners(problem, *reached)
        onward = np.zeros(len(x))
        for m, p in problem.noise.items():
            onward += p * at_heading(problem, cells, corner, weight, reached[2] + m * problem.eta, new)
        q[:, action] = cost + np.where(ending == GOES_ON, problem.discount * onward, 0.0)
    return q


def follow_action(
    problem: Problem, action: Ints, x: Floats, y: Floats, theta: Floats, bevel: Ints
) -> tuple[tuple[Kinds, Floats, Floats, Floats], Ints, Floats]:
    """What `follow_pieces` says of the step of each action, the bevel after it, and its cost with that of its event."""
    new = np.where(action == INSERT_ROTATED, -bevel, bevel)
    step, price = follow_pieces(problem, x, y, theta, new), price_at(problem, x, y)
    if problem.straight is not None:
        straight = action == INSERT_STRAIGHT
        other = follow_pieces(problem.straight, x, y, theta, new)
        ending, x_end, y_end, turned = (np.where(straight, *both) for both in zip(other, step, strict=True))
        step, price = (ending, x_end, y_end, turned), np.where(straight, price_at(problem.straight, x, y), price)
    failure = np.array([0.0, problem.exit, problem.collision, 0.0])[step[0]]
    return step, new, price * length_at(problem, x, y) + (action == INSERT_ROTATED) * problem.rotation + failure


def rollout(
    mdp: Mdp | Problem,
    start: tuple[float, float, float, int],  # x mm, y mm, heading rad, bevel -1 or +1
    runs: int,
    seed: int,
    *,
    policy: NDArray[np.uint8] | None = None,
    greedy_values: Floats | None = None,
    max_steps: int = 10_000,
) -> Runs:
    """Execute `runs` insertions. Give either a policy to look up, or values to act greedily on and an `Mdp`."""
    if (policy is None) == (greedy_values is None):
        raise ValueError("give either policy or greedy_values")
    problem, random = mdp if isinstance(mdp, Problem) else mdp.problem, np.random.default_rng(seed)
    cells = None if isinstance(mdp, Problem) or greedy_values is None else corner_values(mdp, greedy_values)
    x, y, theta = (np.full(runs, float(value)) for value in start[:3])
    bevel = np.full(runs, start[3], dtype=np.int64)
    counts = np.zeros((2, runs), np.int64)
    result = Runs(np.full(runs, GOES_ON), np.zeros(runs), *counts, np.zeros(runs), np.zeros(runs))
    jumps, chances = np.array(list(problem.noise)), np.array(list(problem.noise.values()))
    weight = 1.0
    for _ in range(max_steps):
        on = np.flatnonzero(result.ending == GOES_ON)
        if len(on) == 0:
            break
        if cells is None:
            assert policy is not None
            action = look_up(problem, policy, x[on], y[on], theta[on], bevel[on])
        else:
            action = np.argmin(greedy_q(problem, cells, x[on], y[on], theta[on], bevel[on]), axis=1)
        length = length_at(problem, x[on], y[on])
        step, bevel[on], cost = follow_action(problem, action, x[on], y[on], theta[on], bevel[on])
        result.ending[on], x[on], y[on], theta[on] = step
        theta[on] += random.choice(jumps, size=len(on), p=chances / chances.sum()) * problem.eta
        result.steps[on] += 1
        result.turns[on] += action == INSERT_ROTATED
        result.length[on] += length
        result.straight[on] += length * (action == INSERT_STRAIGHT)
        result.cost[on] += weight * cost
        weight *= problem.discount
    return result
