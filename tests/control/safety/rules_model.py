"""The rules of the states, written a second time: slowly, from the reference, one sentence a rule, nothing shared.

Each rule may veto. A transition is what no rule forbids and one rule demands.
"""

from dataclasses import dataclass, field

PAUSING = {
    "pose_stale", "pose_suspect", "pose_unseen", "tip_unknown", "plan_lost", "recording_behind", "deadman_released",
}  # fmt: skip
MOVING = ("still_moving", "wrong_way", "overspeed", "depth_exceeded", "roll_exceeded", "stage_jumped")
AGAINST_A_RETRACTION = {"wrong_way", "stage_jumped"}
RANKS = ("", "loop", "sensor", "robot", "person")
OF_SENSORS = {
    "pose_stale", "pose_suspect", "pose_unseen", "pose_jumped", "pose_frozen", "pose_fault", "force_stale",
    "force_suspect", "force_fault", "force_exceeded", "force_rising", "tip_unknown", "out_of_plane",
    "out_of_workspace", "in_obstacle", "deadman_released",
}  # fmt: skip
OF_THE_ROBOT = {"stage_stale", "stage_suspect", "stage_fault", "no_motion", *MOVING}


def whose(cause: str) -> str:
    """Return the owner of a cause."""
    return "sensor" if cause in OF_SENSORS else "robot" if cause in OF_THE_ROBOT else "loop"


@dataclass
class SlowRobot:
    """What a person with a clipboard would note down."""

    state: str = "DISABLED"
    homed: bool = False
    distrusted: bool = False
    """Whether the zero was lost, so that a person must find it again."""

    there: set[str] = field(default_factory=set)
    unsigned: set[str] = field(default_factory=set)
    """Causes of stops for which a person has not signed."""

    holder: str = ""
    """The one with the highest rank of all who want the needle to stand."""

    mover: str = ""
    """Whose motion the stage carries out."""

    unsettled: bool = False
    """Whether the needle was told to stop, and nobody has seen it at rest since."""

    next_in_line: str = ""
    """Who has asked to go on as soon as the needle rests."""

    stops: int = 0
    refusals: int = 0

    def halt(self) -> None:
        self.stops += 1
        self.mover = ""
        self.unsettled, self.next_in_line = True, ""

    def hold(self, *others: str) -> None:
        self.holder = max(self.holder, *others, key=RANKS.index)

    def look(self, causes: set[str], *, retracting: bool = False, resting: bool = False) -> None:
        stops = self.stops
        over = self.mover == "person" and not retracting
        self.note(causes, retracting=retracting, resting=resting)
        # Where a retraction ends, the needle is told to stop, as wherever something is over.
        if over and self.stops == stops:
            self.halt()

    def note(self, causes: set[str], *, retracting: bool, resting: bool) -> None:
        # What is wrong is noted first, whatever follows from it.
        new = causes - self.there
        self.there = set(causes)
        if resting:
            self.unsettled = False
        if causes:
            self.next_in_line = ""  # who wanted to go on has to ask again
        if "stage_jumped" in causes:
            self.homed, self.distrusted = False, True
        if self.mover == "person" and not retracting:
            self.mover = ""  # the retraction is over
            if not causes and self.state != "FAULT":
                return
        severe = causes - PAUSING
        pulled = self.mover == "person"
        # FAULT persists until its causes clear, and then goes to DISABLED, never straight to ENABLED.
        if self.state == "FAULT":
            if severe:
                self.unsigned |= severe
                # It has been stopped; again only where it moves all the same, or is pulled the wrong way.
                if new & (AGAINST_A_RETRACTION if pulled else set(MOVING)):
                    self.halt()
            else:
                self.state = "DISABLED"
            return
        # In DISABLED nothing moves, so nothing is a fault, but that something moves, or is pulled the wrong way.
        if self.state == "DISABLED":
            severe &= {"still_moving"} | (AGAINST_A_RETRACTION if pulled else set())
        if severe:
            self.state = "FAULT"
            self.unsigned |= severe
            self.hold(*map(whose, severe))
            if not pulled or severe & AGAINST_A_RETRACTION:
                self.halt()
        elif causes and self.state == "ENABLED":
            self.state = "PAUSED"
            self.hold(*map(whose, causes))
            self.halt()
        elif self.next_in_line and not self.unsettled:
            # It rests, and nothing is in the way of the one who waits.
            self.state, self.holder, self.next_in_line = "ENABLED", "", ""

    def may(self, wish: str, who: str) -> bool:
        """Whether no rule forbids it."""
        person, loop = who == "person", who == "loop"
        # Only a person ends what a person began; the loop ends what only a cause began, but no stop for a fault.
        ends = person or (loop and self.holder in (("", "loop") if self.state == "DISABLED" else RANKS[:-1]))
        pulled = self.mover == "person"
        if wish == "enable":
            # No motion without healthy inputs, a signature for every stop, and a known zero.
            well = not self.there and not self.unsigned and self.homed and not pulled
            return self.state == "ENABLED" or (self.state == "DISABLED" and well and ends)
        return {
            "disable": True,
            "stop": True,
            "pause": self.state in ("ENABLED", "PAUSED"),
            # Leaving PAUSED needs an explicit resume.
            "resume": self.state == "PAUSED" and not self.there and not pulled and ends,
            "reset": person and self.state != "FAULT",
            "home": self.state == "DISABLED" and "stage_jumped" not in self.there
            and (person or (loop and not self.distrusted)),
            "unhome": self.state == "DISABLED",
            "move": loop and self.state == "ENABLED",
            "retract": person,
        }[wish]  # fmt: skip

    def ask(self, wish: str, who: str) -> None:
        if not self.may(wish, who):
            self.refusals += 1
            return
        before = self.state
        if wish in ("enable", "resume") and self.state != "ENABLED" and self.unsettled:
            self.next_in_line = who  # first it comes to rest
            return
        goes = {"enable": "ENABLED", "resume": "ENABLED", "pause": "PAUSED", "disable": "DISABLED", "stop": "DISABLED"}
        # No command causes FAULT, and none ends it.
        if self.state != "FAULT" and wish in goes:
            self.state = goes[wish]
        if wish == "retract" and self.state == "ENABLED":
            self.state = "PAUSED"
            self.halt()
        # The loop does not stop a person who pulls the needle out.
        if wish in ("disable", "pause", "stop") and not (who == "loop" and self.mover == "person"):
            self.halt()
        if wish == "unhome":
            self.next_in_line = ""
        if wish in ("disable", "pause", "stop", "retract"):
            self.hold(who)
        if wish == "stop":
            self.unsigned.add("stop_ordered")
        if wish == "reset":
            self.unsigned.clear()
            # Whoever signs has examined what sensors and robot reported; what he wanted himself, he still wants.
            if self.state == "DISABLED" and self.holder != "person":
                self.holder = ""
        if wish == "home":
            self.homed, self.distrusted = True, False
        if wish == "unhome":
            self.homed, self.distrusted = False, self.distrusted or who == "person"
        if wish == "move":
            self.mover = "loop"
        if wish == "retract":
            self.mover, self.unsettled, self.next_in_line = "person", False, ""
        if self.state == "ENABLED" and before != "ENABLED":
            self.holder = self.next_in_line = ""
