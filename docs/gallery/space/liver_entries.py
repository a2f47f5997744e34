"""
Entries of an invented liver
============================

The 3D plan: success at every entry point, slices through the target with the best path, and executions with noise
in 3D. The anatomy is invented; the lattice is coarser than the shipped one.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

from needleplan.anatomy import Anatomy, write_phantom
from needleplan.planning import draw_entries, rank_entries

with tempfile.TemporaryDirectory() as folder:
    anatomy = Anatomy.read(write_phantom("liver", Path(folder), seed=1))
file = anatomy.file
lattice = replace(file.lattice, spacing_mm=4.0, step_mm=8.0, directions_deg=8.0)
anatomy = replace(anatomy, file=replace(file, lattice=lattice))

entries = rank_entries(anatomy)
best = entries.entry(entries.first())
print(f"success {best.success}; clearance {best.clearance_mm:.1f} mm, {best.turns} turns")
figure = draw_entries(entries)
