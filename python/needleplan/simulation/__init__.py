"""The lab twin: robot, needle, tissue and sensors on simulated time.

| | |
|---|---|
| `Experiment`, `run_experiment` | a program of moves from a file, and all that the devices said |
| `open_lab`, `Lab` | the three devices of a lab by address, `sim://insertion?seed=3` |
| `Setup`, `Effects`, ... | what a lab is built from |
| `Plant` | the truth behind the devices |
"""

from needleplan.simulation.address import open_lab
from needleplan.simulation.effects import Effects
from needleplan.simulation.experiment import Experiment, shipped_experiments
from needleplan.simulation.lab import Lab, SimulatedForceSensor, SimulatedStage, SimulatedTracker
from needleplan.simulation.parts import Entry, Layer, Move, Robot, Shaft, Tissue
from needleplan.simulation.plant import Plant
from needleplan.simulation.recorded import record_run
from needleplan.simulation.run import Phase, Run, run_experiment
from needleplan.simulation.setup import Setup

__all__ = [
    "Effects",
    "Entry",
    "Experiment",
    "Lab",
    "Layer",
    "Move",
    "Phase",
    "Plant",
    "Robot",
    "Run",
    "Setup",
    "Shaft",
    "SimulatedForceSensor",
    "SimulatedStage",
    "SimulatedTracker",
    "Tissue",
    "open_lab",
    "record_run",
    "run_experiment",
    "shipped_experiments",
]
