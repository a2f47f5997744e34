"""The events of the guard, which a listener receives and a recording stores."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from needleplan.artifacts import CallRepr
from needleplan.control.safety._causes import Cause
from needleplan.control.safety._states import OperatingState

__all__ = ["SafetyEvent", "SafetyEventName", "SafetyListener"]


class SafetyEventName(StrEnum):
    """Kind of an event of the guard."""

    TRANSITION = "transition"
    """The operating state has changed from `before` to `state`."""

    RAISED = "raised"
    """New causes are present; `causes` lists them."""

    CLEARED = "cleared"
    """Causes are no longer present; `causes` lists them."""

    ORDER = "order"
    REFUSAL = "refusal"
    COMMAND = "command"
    """A motion command with the event's `values` was sent to the stage."""

    RETRACTION = "retraction"
    """A retraction by a person was sent to the stage."""

    STOP = "stop"
    """A stop was sent to the stage at `sent_ns`."""


@dataclass(frozen=True)
class SafetyEvent(CallRepr):
    """One event of the guard. Times (ns) are those of the monotonic clock."""

    name: SafetyEventName
    time_ns: int
    state: OperatingState
    """Operating state after the event."""

    causes: frozenset[Cause] = frozenset()
    text: str = ""
    before: OperatingState | None = None
    """Operating state before a TRANSITION; None for all other events."""

    sent_ns: int | None = None
    """Time at which a command or a stop was sent to the stage; None for all other events."""

    values: tuple[tuple[str, float], ...] = field(default=())
    """Names and values of the arguments of a motion command."""

    def entry(self) -> dict[str, Any]:
        """Return the event as a message for a recording channel of the kind `recording.EVENT`."""
        entry: dict[str, Any] = {
            "name": self.name, "cause": ", ".join(sorted(self.causes)), "text": self.text, "state": self.state,
        }  # fmt: skip
        if self.before is not None:
            entry["before"] = self.before
        if self.sent_ns is not None:
            entry["sent_ns"] = str(self.sent_ns)  # as text: JSON readers round integers of this size
        return entry | dict(self.values)


SafetyListener = Callable[[SafetyEvent], None]
