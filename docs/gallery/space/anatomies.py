"""
The invented anatomies
======================

One slice through the target of each of the four anatomies that come with needleplan: obstacles dark, the target
orange, white outside of the body. They are made of balls, ellipsoids and tubes.
"""

import tempfile
from pathlib import Path

import numpy as np
from matplotlib import pyplot

from needleplan.anatomy import PHANTOMS, TARGET, Anatomy, grid_of, write_phantom
from needleplan.planning import draw_slice

figure, panels = pyplot.subplots(2, 2, figsize=(9, 7.4), layout="constrained")
for panel, name in zip(panels.flat, PHANTOMS, strict=True):
    with tempfile.TemporaryDirectory() as folder:
        grid = grid_of(Anatomy.read(write_phantom(name, Path(folder), seed=1)))
    middle = np.argwhere(grid.codes == TARGET).mean(axis=0).round().astype(int)
    draw_slice(panel, grid, 2, int(middle[2]))
    panel.set_title(name, loc="left", fontsize=10)
