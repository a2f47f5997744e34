"""
The solver for anybody's Markov decision process
================================================

`npl.mdp` knows no needles. Here a walker on a grid of 40 x 40 cells slips sideways with probability 0.2, and looks
for the way to a corner around two walls.
"""

import numpy as np
from matplotlib import pyplot
from scipy.sparse import coo_array

import needleplan as npl

size, goal = 40, 39 * 40 + 39
wall = np.zeros((size, size), bool)
wall[12, :30] = wall[26, 10:] = True
steps = np.array([(1, 0), (-1, 0), (0, 1), (0, -1)])
places = np.argwhere(~wall)
number = np.full((size, size), -1)
number[~wall] = np.arange(len(places))


def after(step):
    """Return the state after a step from every place; a wall or the border stops it."""
    to = np.clip(places + step, 0, size - 1)
    stopped = wall[tuple(to.T)]
    return np.where(stopped, np.arange(len(places)), number[tuple(to.T)])


def matrix(step):
    """Return the transition probabilities of an action."""
    aside = step[::-1]
    rows = np.tile(np.arange(len(places)), 3)
    columns = np.concatenate([after(step), after(aside), after(-aside)])
    return coo_array((np.repeat([0.8, 0.1, 0.1], len(places)), (rows, columns)), (len(places),) * 2).toarray()


end = number[-1, -1]
moves = [matrix(step) for step in steps]
for each in moves:
    each[end] = 0.0  # no action: the walk ends here
costs = np.ones((len(places), len(steps)))
solution = npl.mdp.solve(npl.mdp.TabularMdp(moves, costs, discount=1.0), tolerance=1e-6)
print(solution.stats.status, solution.stats.error_bound <= 1e-6)

image = np.full((size, size), np.nan)
image[~wall] = solution.values
figure, axes = pyplot.subplots(figsize=(5.4, 4.6), layout="constrained")
shown = axes.imshow(image.T, origin="lower", cmap="cividis")
figure.colorbar(shown, label="expected number of steps")
axes.set(xlabel="column", ylabel="row")
