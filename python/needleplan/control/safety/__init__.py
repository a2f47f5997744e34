"""Safety of a run: operating states, limits, the guard of the stage, and the watchdog thread."""

from needleplan.control.safety._causes import Cause, Severity
from needleplan.control.safety._guard import GuardedStage
from needleplan.control.safety._inputs import Inputs, validate
from needleplan.control.safety._limits import SafetyLimits
from needleplan.control.safety._states import (
    GuardAction,
    InputReport,
    OperatingState,
    Order,
    SafetyEvent,
    SafetyEventName,
    SafetyListener,
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
    "OperatingState",
    "Order",
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
