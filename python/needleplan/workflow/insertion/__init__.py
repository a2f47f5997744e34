"""Insertions with devices by address: what is opened, what is checked before anything moves, and a simulated lab."""

from needleplan.workflow.insertion.agreement import require_fitting
from needleplan.workflow.insertion.bench import Bench, are_simulated, open_bench, simulated_bench
from needleplan.workflow.insertion.figure import insertion_figure
from needleplan.workflow.insertion.slicer import SlicerView

__all__ = [
    "Bench",
    "SlicerView",
    "are_simulated",
    "insertion_figure",
    "open_bench",
    "require_fitting",
    "simulated_bench",
]
