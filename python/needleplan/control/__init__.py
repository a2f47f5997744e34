"""Control of a run: the insertion loop, its recorder and its replay. The safety guard is in `control.safety`."""

import needleplan.extras.lab  # noqa: F401  # raises MissingLibraryError
from needleplan.control._deadman import DeadmanThread, KeyDeadman, PedalDeadman, open_deadman
from needleplan.control._deadman_link import Deadman, DeadmanSender, UdpDeadman
from needleplan.control._events import (
    CommandKind,
    ExecutedStep,
    Listener,
    RunCommand,
    RunEvent,
    RunEventName,
)
from needleplan.control._gate import BreathGate
from needleplan.control._insertion import Insertion
from needleplan.control._options import Options, RunSetup, planned_tip_settings
from needleplan.control._order_port import OrderPort, send_order
from needleplan.control._preconditions import require_fitting
from needleplan.control._recorded_insertion import recorded_coil_mm, recorded_insertion
from needleplan.control._recorder import RunRecorder
from needleplan.control._replanning import Replanner, ThreadReplanner, curvature_mismatch, rescaled
from needleplan.control._replay import ReplayComparison, recorded_samples, replay
from needleplan.control._report import (
    InsertionOutcome,
    InsertionReport,
    SpaceErrors,
    path_distances_mm,
)
from needleplan.control._retraction import Retraction, RetractionOutcome, RetractionReport, open_stage_patiently
from needleplan.control._scene import Approach, ScenarioGeometry
from needleplan.control._table_set_replanning import TableSetReplanner

__all__ = [
    "Approach",
    "BreathGate",
    "CommandKind",
    "Deadman",
    "DeadmanSender",
    "DeadmanThread",
    "ExecutedStep",
    "Insertion",
    "InsertionOutcome",
    "InsertionReport",
    "KeyDeadman",
    "Listener",
    "Options",
    "OrderPort",
    "PedalDeadman",
    "Replanner",
    "ReplayComparison",
    "Retraction",
    "RetractionOutcome",
    "RetractionReport",
    "RunCommand",
    "RunEvent",
    "RunEventName",
    "RunRecorder",
    "RunSetup",
    "ScenarioGeometry",
    "SpaceErrors",
    "TableSetReplanner",
    "ThreadReplanner",
    "UdpDeadman",
    "curvature_mismatch",
    "open_deadman",
    "open_stage_patiently",
    "path_distances_mm",
    "planned_tip_settings",
    "recorded_coil_mm",
    "recorded_insertion",
    "recorded_samples",
    "replay",
    "require_fitting",
    "rescaled",
    "send_order",
]
