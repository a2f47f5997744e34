"""The rules of the states, written a second time: slowly, from the reference, one sentence a rule, nothing shared.

Each rule may veto. A transition is what no rule forbids and one rule demands.
"""

from __future__ import annotations

from dataclasses import dataclass, field

PAUSING = {"pose_stale", "pose_suspect", "pose_unseen", "tip_unknown", "plan_lost", "recording_behind"}

MOVING = ("still_moving", "wrong_way", "overspeed", "depth_exceeded", "stage_jumped")


@dataclass
class SlowRobot:
    """What a person with a clipboard would note down."""

    state: str = "DISABLED"
    homed: bool = False
    there: set[str] = field(default_factory=set)
    unsigned: set[str] = field(default_factory=set)
    """Causes of stops for which a person has not signed."""

    held: bool = False
    """Whether a person wants the pause, so that nobody else may end it."""

    stops: int = 0
    refusals: int = 0

    def look(self, causes: set[str]) -> None:
        # What is wrong is noted first, whatever follows from it.
        new = causes - self.there
        self.there = set(causes)
        if "stage_jumped" in causes:
            self.homed = False
        severe = causes - PAUSING
        # FAULT persists until its causes clear, and then goes to DISABLED, never straight to ENABLED.
        self.held = self.held and not severe
        if self.state == "FAULT":
            if severe:
                self.unsigned |= severe
                # It has been stopped; again only where it moves all the same.
                if any(each in new for each in MOVING):
                    self.stops += 1
            else:
                self.state = "DISABLED"
            return
        # In DISABLED nothing moves, so nothing is a fault, but that something moves.
        if self.state == "DISABLED":
            if "still_moving" in causes:
                self.state, self.stops = "FAULT", self.stops + 1
                self.unsigned.add("still_moving")
            return
        if severe:
            self.state, self.stops = "FAULT", self.stops + 1
            self.unsigned |= severe
        elif causes and self.state == "ENABLED":
            self.state, self.stops = "PAUSED", self.stops + 1

    def ask(self, wish: str) -> None:
        may = {
            # No motion without healthy inputs, a signature for every stop, and a known zero.
            "enable": self.state == "ENABLED"
            or (self.state == "DISABLED" and not self.there and not self.unsigned and self.homed),
            "disable": True,
            "pause": self.state in ("ENABLED", "PAUSED"),
            # Leaving PAUSED needs an explicit resume.
            "resume": self.state == "PAUSED" and not self.there,
            "continue": self.state == "PAUSED" and not self.there and not self.held,
            "reset": self.state != "FAULT",
            "stop": True,
            "home": self.state == "DISABLED" and "stage_jumped" not in self.there,
            "unhome": self.state == "DISABLED",
        }[wish]
        if not may:
            self.refusals += 1
            return
        if wish in ("disable", "pause", "stop"):
            self.stops += 1
        if wish == "stop":
            self.unsigned.add("stop_ordered")
        if wish == "reset":
            self.unsigned.clear()
        if wish in ("home", "unhome"):
            self.homed = wish == "home"
        goes = {
            "enable": "ENABLED",
            "resume": "ENABLED",
            "continue": "ENABLED",
            "pause": "PAUSED",
            "disable": "DISABLED",
            "stop": "DISABLED",
        }
        # No command causes FAULT, and none ends it.
        if self.state != "FAULT" and wish in goes:
            self.state = goes[wish]
        # What a person holds, he holds until the pause is over, in whatever way.
        self.held = self.state == "PAUSED" and (self.held or wish == "pause")
