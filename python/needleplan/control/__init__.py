"""Control of a run: what drives the robot by a plan, and what keeps it from harm."""

from needleplan.control.estimate import ArcFilter, TipEstimate, TipEstimator, Uncertainty
from needleplan.control.insertion import Insertion
from needleplan.control.listening import Command, CommandKind, Event, EventName, Listener, Step
from needleplan.control.options import Options
from needleplan.control.plan_frame import LabFrame, PlanFrame
from needleplan.control.replanning import Replanner, ThreadReplanner
from needleplan.control.report import Ending, Report
from needleplan.control.station import Feed, Sample, Station, ThreadedFeed, TurnFeed

__all__ = [
    "ArcFilter",
    "Command",
    "CommandKind",
    "Ending",
    "Event",
    "EventName",
    "Feed",
    "Insertion",
    "LabFrame",
    "Listener",
    "Options",
    "PlanFrame",
    "Replanner",
    "Report",
    "Sample",
    "Station",
    "Step",
    "ThreadReplanner",
    "ThreadedFeed",
    "TipEstimate",
    "TipEstimator",
    "TurnFeed",
    "Uncertainty",
]
