"""Control of a run: what drives the robot by a plan, and what keeps it from harm."""

from needleplan.control.insertion import Insertion
from needleplan.control.listening import Command, CommandKind, Event, EventName, Listener, Step
from needleplan.control.options import Options
from needleplan.control.replanning import Replanner, ThreadReplanner
from needleplan.control.replay import Comparison, RecordedStation, replay
from needleplan.control.report import Ending, Report
from needleplan.control.run_recorder import RunRecorder
from needleplan.control.run_setup import RunSetup

__all__ = [
    "Command",
    "CommandKind",
    "Comparison",
    "Ending",
    "Event",
    "EventName",
    "Insertion",
    "Listener",
    "Options",
    "RecordedStation",
    "Replanner",
    "Report",
    "RunRecorder",
    "RunSetup",
    "Step",
    "ThreadReplanner",
    "replay",
]
