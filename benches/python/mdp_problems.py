"""Fifteen sparse MDPs from the documents of other solvers and from the field, for `compare_mdp.py`."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from needleplan.mdp import TabularMdp

Floats = NDArray[np.float64]
Matrices = Sequence[sparse.csr_array]


@dataclass(frozen=True)
class Tabular:
    """One (S, S) matrix per action and costs (S, A). Every action is available in every state."""

    transitions: Matrices
    costs: Floats
    discount: float


def moves(
    costs: Floats, discount: float, steps: Sequence[Sequence[tuple[float | Floats, NDArray[np.int64]]]]
) -> Tabular:
    """Return a problem of steps: for every action, pairs of a probability (of each state) and the next states."""
    states = len(costs)
    matrices = []
    for outcomes in steps:
        chances = np.concatenate([np.broadcast_to(chance, states) for chance, _ in outcomes])
        places = np.concatenate([target for _, target in outcomes])
        shape = (states, states)
        matrices.append(sparse.csr_array((chances, (np.tile(np.arange(states), len(outcomes)), places)), shape=shape))
    return Tabular(matrices, costs, discount)


def gridworld(side: int, discount: float) -> Tabular:
    """Four moves that slip to each side with probability 0.1; the last cell absorbs without cost."""
    cell = np.arange(side * side)
    row, column = np.divmod(cell, side)
    goal = cell == side * side - 1
    land = [
        np.where(goal, cell, np.clip(row + down, 0, side - 1) * side + np.clip(column + right, 0, side - 1))
        for down, right in ((-1, 0), (1, 0), (0, -1), (0, 1))
    ]
    steps = [[(0.8, land[a]), (0.1, land[2 - a // 2 * 2]), (0.1, land[3 - a // 2 * 2])] for a in range(4)]
    return moves(np.where(goal, 0.0, 1.0)[:, None].repeat(4, axis=1), discount, steps)


def gymnasium_table(name: str, discount: float) -> Tabular:
    """A toy-text environment of gymnasium; terminated transitions lead to an absorbing last state."""
    import gymnasium

    table = gymnasium.make(name).unwrapped.P  # type: ignore[attr-defined]
    states, actions = len(table), len(table[0])
    matrices, costs = [], np.zeros((states + 1, actions))
    for action in range(actions):
        matrix = np.zeros((states + 1, states + 1))
        matrix[states, states] = 1
        for state in range(states):
            for chance, following, reward, ended in table[state][action]:
                matrix[state, states if ended else following] += chance
                costs[state, action] -= chance * reward
        matrices.append(sparse.csr_array(matrix))
    return Tabular(matrices, costs, discount)


def forest(states: int, discount: float) -> Tabular:
    """The forest of pymdptoolbox: wait for a reward, or cut; a fire burns it down with probability 0.1."""
    age = np.arange(states)
    costs = np.zeros((states, 2))
    costs[-1] = -4, -2
    costs[1:-1, 1] = -1
    start = np.zeros(states, dtype=np.int64)
    return moves(costs, discount, [[(0.9, np.minimum(age + 1, states - 1)), (0.1, start)], [(1.0, start)]])


def scattered(states: int, actions: int, discount: float) -> Tabular:
    """Five random successors per action, as the random example of pymdptoolbox."""
    random = np.random.default_rng(1)
    steps = []
    for _ in range(actions):
        chances = random.dirichlet(np.ones(5), states).T
        steps.append([(chance, random.integers(0, states, states)) for chance in chances])
    return moves(random.uniform(0, 1, (states, actions)), discount, steps)


def growth(stock: int, discount: float) -> Tabular:
    """The growth problem of QuantEcon's page on DiscreteDP, enlarged: consume or save, then a random endowment."""
    endowment, most = stock // 2, stock // 2
    s, saved = np.arange(stock + 1), np.arange(most + 1)
    consumption = s[:, None] - saved[None, :]
    costs = np.where(consumption >= 0, -np.sqrt(np.maximum(consumption, 0)), 1e3)
    ends = [[(1 / (endowment + 1), np.full(stock + 1, min(x + u, stock))) for u in range(endowment + 1)] for x in saved]
    return moves(costs, discount, ends)


def inventory(most: int, orders: int, discount: float) -> Tabular:
    """Order up to `orders` units at a fixed and a unit price; Poisson demand of mean 8; holding and shortage costs."""
    level, demand = np.arange(most + 1), np.arange(30)
    chance = np.exp(-8 + demand * np.log(8) - np.cumsum(np.log(np.maximum(demand, 1))))
    chance /= chance.sum()
    costs, steps = np.empty((most + 1, orders)), []
    for order in range(orders):
        stock = np.minimum(level + order, most)
        short = np.maximum(demand[None, :] - stock[:, None], 0) @ chance
        costs[:, order] = 4.0 * (order > 0) + order + 0.1 * stock + 6 * short
        steps.append([(chance[d], np.maximum(stock - d, 0)) for d in demand])
    return moves(costs, discount, steps)


def queue(places: int, discount: float, shuffled: bool = False) -> Tabular:
    """A birth-death queue whose service has three speeds."""
    n, steps = np.arange(places), []
    names = np.random.default_rng(2).permutation(places) if shuffled else n
    back = np.argsort(names)
    costs = np.empty((places, 3))
    for action, serve in enumerate((0.3, 0.45, 0.6)):
        up, down = names[np.minimum(n + 1, places - 1)][back], names[np.maximum(n - 1, 0)][back]
        steps.append([(0.4, up), (serve * 0.6, down), (0.6 - serve * 0.6, np.arange(places))])
        costs[names, action] = n / places + (0.0, 0.2, 0.5)[action]
    return moves(costs, discount, steps)


def tandem(places: int, discount: float) -> Tabular:
    """Two queues in a row; each action serves both at other speeds."""
    first, second = np.divmod(np.arange(places * places), places)

    def at(a: NDArray[np.int64], b: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.clip(a, 0, places - 1) * places + np.clip(b, 0, places - 1)

    steps, costs = [], np.empty((places * places, 4))
    for action, (one, two) in enumerate(((0.2, 0.2), (0.4, 0.2), (0.2, 0.4), (0.35, 0.35))):
        served = np.where((first > 0) & (second < places - 1), at(first - 1, second + 1), at(first, second))
        rest = 0.75 - one - two + 1e-17
        outcomes = [(0.25, at(first + 1, second)), (one, served), (two, at(first, second - 1))]
        steps.append([*outcomes, (rest, at(first, second))])
        costs[:, action] = (first + 2 * second) / places + 2 * (one + two)
    return moves(costs, discount, steps)


def mountain_car(side: int, discount: float) -> Tabular:
    """The mountain car on a grid of positions and speeds, read bilinearly; the top absorbs without cost."""
    x, v = (
        axis.ravel()
        for axis in np.meshgrid(np.linspace(-1.2, 0.6, side), np.linspace(-0.07, 0.07, side), indexing="ij")
    )
    top, steps = x >= 0.5, []
    for push in (-1, 0, 1):
        speed = np.clip(v + 0.001 * push - 0.0025 * np.cos(3 * x), -0.07, 0.07)
        place = np.clip(x + speed, -1.2, 0.6)
        speed = np.where(place <= -1.2, np.maximum(speed, 0), speed)
        i, j = (place + 1.2) / 1.8 * (side - 1), (speed + 0.07) / 0.14 * (side - 1)
        i0, j0 = (np.minimum(f.astype(np.int64), side - 2) for f in (i, j))
        a, b = i - i0, j - j0
        corners = [((1 - a) * (1 - b), 0, 0), ((1 - a) * b, 0, 1), (a * (1 - b), 1, 0), (a * b, 1, 1)]
        state = np.arange(side * side)
        steps.append([(p, np.where(top, state, (i0 + di) * side + j0 + dj)) for p, di, dj in corners])
    return moves(np.where(top, 0.0, 1.0)[:, None].repeat(3, axis=1), discount, steps)


def acyclic(states: int, discount: float) -> Tabular:
    """Steps of 1 to 20 places towards the last state, in a random order of the indices."""
    random = np.random.default_rng(3)
    names = random.permutation(states)
    back, place, last = np.argsort(names), np.arange(states), states - 1
    steps = [
        [(1 / 3, names[np.minimum(place + random.integers(1, 21, states), last)][back]) for _ in range(3)]
        for _ in range(2)
    ]
    costs = random.uniform(0.1, 1, (states, 2))
    costs[names[last]] = 0
    return moves(costs, discount, steps)


def needle(spacing_mm: float) -> Tabular:
    """The four-obstacle workspace with the costs of the thesis."""
    from problem import problem_of, scenario_at

    problem = problem_of(scenario_at(spacing_mm))
    return Tabular([sparse.csr_array(m) for m in problem.matrices], problem.costs.reshape(-1, 2), problem.discount)


PROBLEMS: dict[str, Callable[[], Tabular]] = {
    "taxi (gymnasium), 501, 0.99": lambda: gymnasium_table("Taxi-v4", 0.99),
    "frozen lake 8 x 8 (gymnasium), 65, 0.99": lambda: gymnasium_table("FrozenLake8x8-v1", 0.99),
    "forest (pymdptoolbox), 10,000, 0.96": lambda: forest(10_000, 0.96),
    "random (pymdptoolbox), 10,000 x 4, 0.99": lambda: scattered(10_000, 4, 0.99),
    "growth (QuantEcon), 201 x 101, 0.9": lambda: growth(200, 0.9),
    "inventory, 301 x 40, 0.99": lambda: inventory(300, 40, 0.99),
    "queue, 2,000, 0.9999": lambda: queue(2_000, 0.9999),
    "long chain in random order, 20,000, 0.999": lambda: queue(20_000, 0.999, shuffled=True),
    "tandem queue, 10,000, 0.999": lambda: tandem(100, 0.999),
    "mountain car, 22,500, 0.99": lambda: mountain_car(150, 0.99),
    "acyclic in random order, 100,000, 0.99": lambda: acyclic(100_000, 0.99),
    "gridworld, 90,000 states, 0.99": lambda: gridworld(300, 0.99),
    "gridworld, 22,500 states, 0.9999": lambda: gridworld(150, 0.9999),
    "needle, 2 mm, thesis": lambda: needle(2.0),
    "needle, 1 mm, thesis": lambda: needle(1.0),
}


def ours(problem: Tabular) -> TabularMdp:
    """Return the problem for our solver."""
    return TabularMdp(problem.transitions, problem.costs, problem.discount)
