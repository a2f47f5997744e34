"""Atlases: many policy tables over the values of scenario keys, made on the processors of one machine or of a cluster.

A sweep (`Sweep`) names a scenario and the keys that vary. `make_atlas` solves what its folder does not have yet; Dask
distributes the work. `Atlas.open` reads the folder.
"""

from needleplan.atlas._atlas import Atlas, AtlasEntry
from needleplan.atlas._engine import Engine
from needleplan.atlas._make import AtlasReport, make_atlas
from needleplan.atlas._nearest import CurvatureLookup
from needleplan.atlas._studies import (
    GOALS,
    EntryMapOfAtlas,
    ParameterEffect,
    QuantityMap,
    WrongParameter,
    entry_map,
    pareto_candidates,
    pareto_front,
    quantity_map,
    sensitivities,
    wrong_parameters,
)
from needleplan.atlas._study_figures import (
    draw_entry_map,
    draw_pareto,
    draw_quantity_map,
    draw_sensitivities,
    draw_wrong_parameters,
)
from needleplan.atlas._study_rules import QUANTITIES, levels_of, selected, tables_text, varying
from needleplan.atlas._sweep import MOST_TABLES, Design, Keep, Sweep, SweepEntry, shipped_sweeps
from needleplan.atlas._swept_parameter import RangeScale, SweptParameter
from needleplan.atlas._texts import value_text, values_text

__all__ = [
    "GOALS",
    "MOST_TABLES",
    "QUANTITIES",
    "Atlas",
    "AtlasEntry",
    "AtlasReport",
    "CurvatureLookup",
    "Design",
    "Engine",
    "EntryMapOfAtlas",
    "Keep",
    "ParameterEffect",
    "QuantityMap",
    "RangeScale",
    "Sweep",
    "SweepEntry",
    "SweptParameter",
    "WrongParameter",
    "draw_entry_map",
    "draw_pareto",
    "draw_quantity_map",
    "draw_sensitivities",
    "draw_wrong_parameters",
    "entry_map",
    "levels_of",
    "make_atlas",
    "pareto_candidates",
    "pareto_front",
    "quantity_map",
    "selected",
    "sensitivities",
    "shipped_sweeps",
    "tables_text",
    "value_text",
    "values_text",
    "varying",
    "wrong_parameters",
]
