"""Parameter sweeps: table sets over the values of scenario keys, made on the processors of one machine or of a cluster.

A sweep (`Sweep`) names a scenario and the keys that vary. `make_table_set` solves what its folder does not have yet;
Dask distributes the work. `TableSet.open` reads the folder.
"""

from needleplan.sweep._engine import Engine
from needleplan.sweep._make import TableSetReport, make_table_set
from needleplan.sweep._nearest import CurvatureLookup
from needleplan.sweep._studies import (
    GOALS,
    ParameterEffect,
    QuantityMap,
    TableSetEntryMap,
    WrongParameter,
    entry_map,
    pareto_candidates,
    pareto_front,
    quantity_map,
    sensitivities,
    wrong_parameters,
)
from needleplan.sweep._study_figures import (
    draw_entry_map,
    draw_pareto,
    draw_quantity_map,
    draw_sensitivities,
    draw_wrong_parameters,
)
from needleplan.sweep._study_rules import QUANTITIES, levels_of, selected, tables_text, varying
from needleplan.sweep._sweep import Design, Keep, Sweep, SweepEntry, shipped_sweeps
from needleplan.sweep._swept_parameter import RangeScale, SweptParameter, value_text, values_text
from needleplan.sweep._table_set import TableSet, TableSetEntry

__all__ = [
    "GOALS",
    "QUANTITIES",
    "CurvatureLookup",
    "Design",
    "Engine",
    "Keep",
    "ParameterEffect",
    "QuantityMap",
    "RangeScale",
    "Sweep",
    "SweepEntry",
    "SweptParameter",
    "TableSet",
    "TableSetEntry",
    "TableSetEntryMap",
    "TableSetReport",
    "WrongParameter",
    "draw_entry_map",
    "draw_pareto",
    "draw_quantity_map",
    "draw_sensitivities",
    "draw_wrong_parameters",
    "entry_map",
    "levels_of",
    "make_table_set",
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
