"""Small sweeps that solve in milliseconds."""

from pathlib import Path

import needleplan as npl
from needleplan.sweep import Engine, Sweep, make_table_set

FORTY = [30.0 + number for number in range(20)]

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


def complete(store: Path, sweep: Sweep) -> None:
    """Assert that every table is there once, with one record and the right digest."""
    again = make_table_set(sweep, store, Engine(workers=0))
    assert (again.solved, again.read, again.present) == (0, 0, sweep.tables)
    lines = [line for file in (store / "records").iterdir() for line in file.read_text().splitlines()]
    assert len(lines) == len(list((store / "tables").rglob("*.h5"))) == sweep.tables
    assert all(entry.table().digest == entry.record["digest"] for entry in list(npl.TableSet.open(store))[::7])
