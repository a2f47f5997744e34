"""What keeps a run from harm: states, limits, a guard before the stage, a watchdog."""

from needleplan.control.safety.causes import Cause, Severity
from needleplan.control.safety.events import EventName, Listener, SafetyEvent
from needleplan.control.safety.guard import GuardedStage
from needleplan.control.safety.inputs import Inputs, judge
from needleplan.control.safety.limits import SafetyLimits
from needleplan.control.safety.machine import Action, OperatingState, Order, Report, SafetyState, Step, advance
from needleplan.control.safety.watchdog import Watchdog

__all__ = [
    "Action",
    "Cause",
    "EventName",
    "GuardedStage",
    "Inputs",
    "Listener",
    "OperatingState",
    "Order",
    "Report",
    "SafetyEvent",
    "SafetyLimits",
    "SafetyState",
    "Severity",
    "Step",
    "Watchdog",
    "advance",
    "judge",
]
