"""Control of a run: the insertion loop, its recorder and its replay. The safety guard is in `control.safety`."""

from needleplan.control._events import (
    CommandKind,
    ExecutedStep,
    Listener,
    RunCommand,
    RunEvent,
    RunEventName,
)
from needleplan.control._insertion import Insertion
from needleplan.control._options import Options, RunSetup
from needleplan.control._preconditions import require_fitting
from needleplan.control._recorder import RunRecorder
from needleplan.control._replanning import Replanner, ThreadReplanner
from needleplan.control._replay import RecordedStation, ReplayComparison, replay
from needleplan.control._report import InsertionOutcome, InsertionReport, drawn, path_distances_mm
from needleplan.control._scene import ScenarioGeometry

__all__ = [
    "CommandKind",
    "ExecutedStep",
    "Insertion",
    "InsertionOutcome",
    "InsertionReport",
    "Listener",
    "Options",
    "RecordedStation",
    "Replanner",
    "ReplayComparison",
    "RunCommand",
    "RunEvent",
    "RunEventName",
    "RunRecorder",
    "RunSetup",
    "ScenarioGeometry",
    "ThreadReplanner",
    "drawn",
    "path_distances_mm",
    "replay",
    "require_fitting",
]
