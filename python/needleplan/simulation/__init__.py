"""The lab twin: robot, needle, tissue and sensors on simulated time.

| | |
|---|---|
| `Simulation`, `run_simulation` | read a program of moves from a file; run it and return all samples of the devices |
| `open_lab`, `Lab` | the three devices of a lab, opened by an address such as `sim://insertion?seed=3` |
| `simulated_station` | the devices of a lab, for an insertion |
| `Setup`, `Effects`, ... | the parts of a lab |
| `Plant` | the true state behind the devices |
"""

import needleplan.extras.lab  # noqa: F401  # raises MissingLibraryError
from needleplan.simulation._effects import Effects
from needleplan.simulation._lab import (
    Lab,
    SimulatedFibre,
    SimulatedForceSensor,
    SimulatedStage,
    SimulatedTracker,
    SimulatedUltrasound,
    open_lab,
)
from needleplan.simulation._plant import Plant
from needleplan.simulation._run import Run, RunPhase, record_run, run_simulation
from needleplan.simulation._setup import Move, Robot, Setup, Shaft, SimulatedEntry, SimulatedLayer, SimulatedTissue
from needleplan.simulation._simulation import Simulation, shipped_simulations
from needleplan.simulation._station import (
    SimulatedStation,
    are_simulated,
    open_insertion_station,
    simulated_coil_mm,
    simulated_station,
    tip_noise_remark,
)

__all__ = [
    "Effects",
    "Lab",
    "Move",
    "Plant",
    "Robot",
    "Run",
    "RunPhase",
    "Setup",
    "Shaft",
    "SimulatedEntry",
    "SimulatedFibre",
    "SimulatedForceSensor",
    "SimulatedLayer",
    "SimulatedStage",
    "SimulatedStation",
    "SimulatedTissue",
    "SimulatedTracker",
    "SimulatedUltrasound",
    "Simulation",
    "are_simulated",
    "open_insertion_station",
    "open_lab",
    "record_run",
    "run_simulation",
    "shipped_simulations",
    "simulated_coil_mm",
    "simulated_station",
    "tip_noise_remark",
]
