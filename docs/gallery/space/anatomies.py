"""
The invented anatomies
======================

One slice through the target of each of the four anatomies that come with needleplan: obstacles dark, the target
orange, white outside of the body, letters for the anatomical directions. They are made of balls, ellipsoids and tubes.
"""

import tempfile
from pathlib import Path

from matplotlib import pyplot

from needleplan.anatomy import PHANTOMS, Anatomy, draw_slice, grid_of, target_slices, write_phantom

figure, panels = pyplot.subplots(2, 2, figsize=(9, 7.4), layout="constrained")
for panel, name in zip(panels.flat, PHANTOMS, strict=True):
    with tempfile.TemporaryDirectory() as folder:
        grid = grid_of(Anatomy.read(write_phantom(name, Path(folder), seed=1)))
    across, number = target_slices(grid)[0]
    draw_slice(panel, grid, across, number)
    panel.set_title(name, loc="left", fontsize=10)
