"""The safety limits of a run, their validation, and the validation of commands against them.

The defaults are strict for a flexible needle in a phantom; docs/reference/safety.md has the reason of each. A guard
takes laxer limits only with a reason, and a value beyond the range of its field not at all. The age limits follow from
the rates of the sensors and from the requirement that a stop is sent at most 50 ms after a fault. With the defaults,
five samples of a force sensor at 200 Hz may be missing, but no pose of a tracker at 40 Hz. If the tracker loses the
coil for a moment, the run pauses until the coil is tracked again.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path

from needleplan import _ppvi
from needleplan.config import (
    ConfigTable,
    Maybe,
    Number,
    Pair,
    Subtable,
    Violation,
    raw_toml,
    ruled,
    shown,
    text_of,
    under,
)
from needleplan.control.safety._causes import Cause, causes_of
from needleplan.devices import StageSample
from needleplan.errors import Mistake, SafetyError
from needleplan.stopping import StopLimits

__all__ = ["SafetyLimits", "against_insertion", "against_retraction", "against_rotation"]

Range = tuple[float, float]

_DEPTH = Number("mm", at_least=-500, at_most=500)
_AGE = Number("s", above=0, at_most=10)
_LAX_IF_SMALLER = ("shallowest_mm", "braking_mm_s2")
_PLACE = Maybe(Pair(Number("mm", at_least=-10_000, at_most=10_000)))


def _depth_range(shallowest_mm: float, deepest_mm: float) -> Iterator[Mistake]:
    if shallowest_mm >= deepest_mm:
        yield Mistake("shallowest_mm", f"{shallowest_mm:g}", f"must be less than deepest_mm, {deepest_mm:g}")


def _workspace_ranges(workspace_x_mm: Range | None, workspace_y_mm: Range | None) -> Iterator[Mistake]:
    for name, pair in (("workspace_x_mm", workspace_x_mm), ("workspace_y_mm", workspace_y_mm)):
        if pair is not None and pair[0] >= pair[1]:
            yield Mistake(name, shown(pair), "must be [least, most]")


@dataclass(frozen=True)
class SafetyLimits(ConfigTable, key="safety", error=SafetyError, between=(_depth_range, _workspace_ranges)):
    """Limits of a run; a table `[safety]` has the same keys. Raises SafetyError with every invalid limit."""

    force_n: float = ruled(Number("N", above=0, at_most=50), 5.0)
    """Largest magnitude of the force at the base of the needle."""

    force_rate_n_s: float = ruled(Number("N/s", above=0, at_most=1000), 50.0)
    """Fastest rise of the force; the force may rise by 50 ms times this rate within 50 ms."""

    shallowest_mm: float = ruled(_DEPTH, -100.0)
    """Smallest stage depth of a command."""
    deepest_mm: float = ruled(_DEPTH, 150.0)
    """Largest stage depth of a command."""
    insertion_velocity_mm_s: float = ruled(Number("mm/s", above=0, at_most=100), 10.0)
    retraction_velocity_mm_s: float = ruled(Number("mm/s", above=0, at_most=100), 20.0)
    rotation_velocity_rad_s: float = ruled(Number("rad/s", above=0, at_most=100), 12.0)
    roll_rad: float = ruled(Number("rad", above=0, at_most=200), 25.0)
    """Largest roll of the base to either side."""

    pose_jump_mm: float = ruled(Number("mm", above=0, at_most=50), 3.0)
    """Largest distance of the coil between successive usable poses, in addition to the motion that the stage can
    cause."""

    out_of_plane_mm: float = ruled(Number("mm", above=0, at_most=1000), 5.0)
    """Largest distance of the tip from the plane of the plan."""
    workspace_x_mm: Range | None = ruled(_PLACE, None)
    """Permitted range (least, most) of the tip's x in the plane of the plan; None for no limit."""
    workspace_y_mm: Range | None = ruled(_PLACE, None)
    """Permitted range (least, most) of the tip's y in the plane of the plan; None for no limit."""
    run_s: float = ruled(Number("s", above=0, at_most=7200), 900.0)
    """Longest duration of a run, from enabling the guard."""

    force_age_s: float = ruled(_AGE, 0.03)
    """Largest age of the last usable force sample."""
    pose_age_s: float = ruled(_AGE, 0.045)
    """Largest age of the last usable pose."""
    stage_age_s: float = ruled(_AGE, 0.03)
    """Largest age of the last usable stage sample."""
    loop_age_s: float = ruled(_AGE, 0.045)
    """Longest time between two calls of the guard's `tick` by the loop."""

    deadman_age_s: float = ruled(_AGE, 0.2)
    """Longest time since the last signal of the deadman switch, if the run needs one."""

    recording_age_s: float = ruled(_AGE, 0.5)
    """Largest delay of the recorder, and time for which a lost message is reported."""

    motion_s: float = ruled(_AGE, 0.5)
    """Longest time from a command until the stage moves, and from a stop until the stage is at rest."""

    rest_mm: float = ruled(Number("mm", above=0, at_most=0.5), 0.02)
    """Range of the measured depths of a needle at rest, over 50 ms; at least the resolution of the encoder."""
    rest_rad: float = ruled(Number("rad", above=0, at_most=0.1), 0.004)
    """Range of the measured rolls of a needle at rest, over 50 ms; at least the resolution of the encoder."""
    braking_mm_s2: float = ruled(Number("mm/s^2", at_least=10, at_most=100_000), 100.0)
    """Smallest deceleration of the stage. The braking distance from the speed v is `following_mm` plus
    v^2 / (2 `braking_mm_s2`); a needle that has gone farther after a stop moves in spite of it."""

    following_mm: float = ruled(Number("mm", above=0, at_most=5), 0.5)
    """Tolerance of the stage position: largest motion outside the range of a command, beyond the depth limits, and
    after a stop. From one sample to the next, 1.5 times the velocity limit is permitted in addition."""
    following_rad: float = ruled(Number("rad", above=0, at_most=3), 0.2)
    """Tolerance of the roll, as `following_mm` of the depth."""

    @property
    def stop(self) -> StopLimits:
        """Limits for the supervision of a stop: rest, braking distance and times.

        `silent_s`, the longest time without a stage sample, is the larger of its default and `stage_age_s`.
        """
        usual = StopLimits()
        return StopLimits(
            self.rest_mm, self.rest_rad, usual.rest_mm_s, self.following_mm, self.braking_mm_s2, self.motion_s,
            max(usual.silent_s, self.stage_age_s),
        )  # fmt: skip

    @property
    def of_commands(self) -> tuple[float, float, float, float, float, float]:
        """Limits of commands as the guard of Rust takes them: depths, speeds inward and outward, roll and its speed."""
        return (
            self.shallowest_mm, self.deepest_mm, self.insertion_velocity_mm_s, self.retraction_velocity_mm_s,
            self.roll_rad, self.rotation_velocity_rad_s,
        )  # fmt: skip

    @property
    def lax(self) -> tuple[Mistake, ...]:
        """The limits that are wider than their defaults, with the default as the rule; empty if there are none.

        A workspace is narrower than its default, which has no limit, so it is never listed.
        """
        lax = []
        for field in fields(self):
            value, usual = getattr(self, field.name), field.default
            if usual is None:
                continue
            if value < usual if field.name in _LAX_IF_SMALLER else value > usual:
                lax.append(Mistake(f"{self.key}.{field.name}", f"{value:g}", f"is laxer than the default, {usual:g}"))
        return tuple(lax)

    def require_accepted(self, reason: str, how: str) -> None:
        """Raise SafetyError with every lax limit if there are any and `reason` is blank; `how` tells how to give it."""
        if not reason.strip() and (lax := self.lax):
            raise SafetyError(
                [replace(mistake, rule=f"{mistake.rule}; give the reason {how}") for mistake in lax], "limits"
            )

    @classmethod
    def from_table(cls, raw: object, source: str = "") -> SafetyLimits:
        """Return the limits in `raw`, a table parsed from TOML. Raises SafetyError with every wrong key or value."""
        try:
            limits: SafetyLimits = Subtable(cls).read(raw)
        except Violation as broken:
            raise SafetyError(list(under(cls.key, broken.mistakes)), source) from None
        return limits

    @classmethod
    def read(cls, path: str | Path) -> SafetyLimits:
        """Return the limits in the table `[safety]` of a file; other tables are ignored.

        Raises SafetyError if the file cannot be read, the table is missing, or a key or value is wrong.
        """
        raw = raw_toml(text_of(path, SafetyError), SafetyError, str(path))
        if cls.key not in raw:
            raise SafetyError(Mistake(cls.key, "", f"is missing: limits belong in the table [{cls.key}]"), str(path))
        return cls.from_table(raw[cls.key], str(path))


def against_insertion(
    limits: SafetyLimits, here: StageSample | None, depth_mm: float, velocity_mm_s: float
) -> frozenset[Cause]:
    """Return the causes against a motion to a depth, inward or outward; empty if it is allowed.

    `here` is the last stage sample. If it is None, the position is unknown and the insertion speed limit applies.
    """
    here_mm = None if here is None else here.depth_mm
    return causes_of(_ppvi.guard_against_insertion(limits.of_commands, here_mm, depth_mm, velocity_mm_s))


def against_rotation(limits: SafetyLimits, roll_rad: float, velocity_rad_s: float) -> frozenset[Cause]:
    """Return the causes against a rotation of the base to a roll; empty if the rotation is allowed."""
    return causes_of(_ppvi.guard_against_rotation(limits.of_commands, roll_rad, velocity_rad_s))


def against_retraction(
    limits: SafetyLimits, here: StageSample | None, depth_mm: float, velocity_mm_s: float
) -> frozenset[Cause]:
    """Return the causes against a retraction to a depth; empty if it is allowed.

    `here` is the last stage sample. If it is None, the position is unknown and only `shallowest_mm` is accepted.
    """
    here_mm = None if here is None else here.depth_mm
    return causes_of(_ppvi.guard_against_retraction(limits.of_commands, here_mm, depth_mm, velocity_mm_s))
