"""Safety of a run: operating states, limits, the guard of the stage, and the watchdog thread."""

from needleplan.control.safety._causes import Cause, Owner, Severity
from needleplan.control.safety._events import SafetyEvent, SafetyEventName, SafetyListener
from needleplan.control.safety._guard import GuardedStage
from needleplan.control.safety._inputs import Inputs, validate
from needleplan.control.safety._limits import SafetyLimits
from needleplan.control.safety._states import (
    GuardAction,
    InputReport,
    MotionOrder,
    OperatingState,
    Order,
    Ordered,
    SafetyState,
    SafetyTransition,
    advance,
)
from needleplan.control.safety._watchdog import Watchdog

__all__ = [
    "Cause",
    "GuardAction",
    "GuardedStage",
    "InputReport",
    "Inputs",
    "MotionOrder",
    "OperatingState",
    "Order",
    "Ordered",
    "Owner",
    "SafetyEvent",
    "SafetyEventName",
    "SafetyLimits",
    "SafetyListener",
    "SafetyState",
    "SafetyTransition",
    "Severity",
    "Watchdog",
    "advance",
    "validate",
]
