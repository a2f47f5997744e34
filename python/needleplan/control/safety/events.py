"""What the guard tells its listener: every transition, cause, refusal, command and stop, with its moment."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from needleplan.control.safety.causes import Cause
from needleplan.control.safety.machine import OperatingState

__all__ = ["EventName", "Listener", "SafetyEvent"]


class EventName(StrEnum):
    """What happened."""

    TRANSITION = "transition"
    RAISED = "raised"
    """Causes have come."""

    CLEARED = "cleared"
    """Causes have gone; the present ones are those that remain."""

    ORDER = "order"
    REFUSAL = "refusal"
    COMMAND = "command"
    """A command went to the stage, with the values it went with."""

    RETRACTION = "retraction"
    """A person's retraction went to the stage."""

    STOP = "stop"
    """A stop went to the stage, which was called at `sent_ns`."""


@dataclass(frozen=True)
class SafetyEvent:
    """One event; times on the monotonic clock."""

    name: EventName
    time_ns: int
    state: OperatingState
    """The state after it."""

    causes: frozenset[Cause] = frozenset()
    text: str = ""
    before: OperatingState | None = None
    sent_ns: int | None = None
    values: tuple[tuple[str, float], ...] = field(default=())

    def entry(self) -> dict[str, Any]:
        """Return it as a message of the kind EVENT of a recording."""
        entry: dict[str, Any] = {
            "name": self.name, "cause": ", ".join(sorted(self.causes)), "text": self.text, "state": self.state,
        }  # fmt: skip
        if self.before is not None:
            entry["before"] = self.before
        if self.sent_ns is not None:
            entry["sent_ns"] = str(self.sent_ns)  # as text: JSON readers round numbers of this size
        return entry | dict(self.values)


Listener = Callable[[SafetyEvent], None]
