"""Atlases: many policy tables over the values of scenario keys, made on the processors of one machine or of a cluster.

A sweep (`Sweep`) names a scenario and the keys that vary. `make_atlas` solves what its folder does not have yet; Dask
distributes the work. `Atlas.open` reads the folder.
"""

from needleplan.atlas._atlas import Atlas, AtlasEntry
from needleplan.atlas._engine import Engine
from needleplan.atlas._make import AtlasReport, make_atlas
from needleplan.atlas._sweep import MOST_TABLES, Design, RangeScale, Sweep, SweepEntry, SweptParameter, shipped_sweeps

__all__ = [
    "MOST_TABLES",
    "Atlas",
    "AtlasEntry",
    "AtlasReport",
    "Design",
    "Engine",
    "RangeScale",
    "Sweep",
    "SweepEntry",
    "SweptParameter",
    "make_atlas",
    "shipped_sweeps",
]
