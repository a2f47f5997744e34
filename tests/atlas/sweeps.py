"""Small sweeps that solve in milliseconds."""

from __future__ import annotations

from pathlib import Path

SCENARIO = """
schema = "needleplan.scenario/1"
title = "Small"

[workspace]
width_mm = 60.0
height_mm = 40.0

[[obstacle]]
name = "vessel"
center_mm = [25.0, 18.0]
radius_mm = 4.0

[target]
center_mm = [50.0, 25.0]
radius_mm = 3.0

[needle]
curvature_radius_mm = 40.0

[motion]
headings = 24

[grid]
spacing_mm = [4.0, 4.0]
"""

SWEEP = """
schema = "needleplan.sweep/1"
title = "Radius and rotation"
scenario = "small.toml"

[[parameter]]
key = "needle.curvature_radius_mm"
name = "radius_mm"
values = {radii}

[[parameter]]
key = "objective.rotation"
values = [1.0, 8.0]
"""


def write_sweep(folder: Path, radii: list[float] | None = None, name: str = "sweep.toml") -> Path:
    """Write the scenario and a sweep over radius and rotation, and return the path of the sweep."""
    (folder / "small.toml").write_text(SCENARIO)
    file = folder / name
    file.write_text(SWEEP.format(radii=radii or [30.0, 40.0, 50.0]))
    return file
