"""What a run may do at most: the limits that are checked on the last value before the wire.

The defaults are those of a needle robot in a phantom. Ages come from the rates of the sensors and from the goal that a
stop is on its way 50 ms after a fault: a force at 200 Hz may miss five samples, a pose at 40 Hz none. Trackers lose
their coil for a moment every now and then; that is a pause, which the loop ends by itself as soon as it is seen again.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field
from pathlib import Path
from typing import Any

from needleplan.errors import Mistake, SafetyError
from needleplan.scenario.parts import Part, checked
from needleplan.scenario.rules import Maybe, Number, Pair, Rule, shown

__all__ = ["SafetyLimits"]

_KEY = "safety"


def _ruled(rule: Rule, default: object = MISSING) -> Any:
    return field(default=default, metadata={"rule": rule, "key": ""})


_DEPTH = Number("mm", at_least=-1000, at_most=1000)
_AGE = Number("s", above=0, at_most=10)
_PLACE = Maybe(Pair(Number("mm", at_least=-10_000, at_most=10_000)))


@dataclass(frozen=True)
class SafetyLimits(Part):
    """The limits; the table `[safety]`. Raises SafetyError with all mistakes."""

    force_n: float = _ruled(Number("N", above=0, at_most=200), 10.0)
    """Length of the force at the base of the needle."""

    shallowest_mm: float = _ruled(_DEPTH, -100.0)
    deepest_mm: float = _ruled(_DEPTH, 150.0)
    insertion_velocity_mm_s: float = _ruled(Number("mm/s", above=0, at_most=1000), 10.0)
    retraction_velocity_mm_s: float = _ruled(Number("mm/s", above=0, at_most=1000), 20.0)
    rotation_velocity_rad_s: float = _ruled(Number("rad/s", above=0, at_most=1000), 12.0)
    roll_rad: float = _ruled(Number("rad", above=0, at_most=1000), 200.0)
    """Largest roll of the base to either side."""

    pose_jump_mm: float = _ruled(Number("mm", above=0, at_most=1000), 5.0)
    """Largest way of the coil from one usable pose to the next, beside what the stage can move it."""

    out_of_plane_mm: float = _ruled(Number("mm", above=0, at_most=1000), 5.0)
    workspace_x_mm: tuple[float, float] | None = _ruled(_PLACE, None)
    """Where the tip may be in the plane of the table; None for anywhere."""
    workspace_y_mm: tuple[float, float] | None = _ruled(_PLACE, None)
    run_s: float = _ruled(Number("s", above=0, at_most=86_400), 900.0)
    """Longest time from enabling to the end."""

    force_age_s: float = _ruled(_AGE, 0.03)
    pose_age_s: float = _ruled(_AGE, 0.045)
    stage_age_s: float = _ruled(_AGE, 0.03)
    loop_age_s: float = _ruled(_AGE, 0.045)
    """The loop says at least so often that it is alive."""

    recording_age_s: float = _ruled(_AGE, 0.5)
    """The recorder may be so far behind."""

    motion_s: float = _ruled(_AGE, 0.5)
    """A stage that took a command has moved after this time, and one that was stopped stands still."""

    following_mm: float = _ruled(Number("mm", above=0, at_most=100), 0.5)
    """What a stage may move against its command, overshoot its limits, or jump from one sample to the next."""

    def __post_init__(self) -> None:
        values, mistakes = checked(type(self), vars(self), _KEY)
        for name, value in values.items():
            object.__setattr__(self, name, value)
        mistakes = mistakes or _disagreements(self)
        if mistakes:
            raise SafetyError(mistakes)

    @classmethod
    def from_table(cls, raw: object, source: str = "") -> SafetyLimits:
        """Return the limits of a table of a file, as TOML reads it. Raises SafetyError."""
        if not isinstance(raw, Mapping):
            raise SafetyError(Mistake(_KEY, shown(raw), f"must be a table, [{_KEY}]"), source)
        values, mistakes = checked(cls, raw, _KEY)
        if mistakes:
            raise SafetyError(mistakes, source)
        try:
            return cls(**values)
        except SafetyError as error:
            raise SafetyError(error.mistakes, source) from None

    @classmethod
    def read(cls, path: str | Path) -> SafetyLimits:
        """Return the limits of the table `[safety]` of a file; other tables are not looked at. Raises SafetyError."""
        try:
            document = tomllib.loads(Path(path).read_text(encoding="utf-8"))
        except OSError as error:
            raise SafetyError(f"cannot be read: {error.strerror}", str(path)) from error
        except (ValueError, RecursionError) as error:
            raise SafetyError(f"is not TOML: {error}", str(path)) from error
        if _KEY not in document:
            raise SafetyError(Mistake(_KEY, "", f"is missing: limits stand in the table [{_KEY}]"), str(path))
        return cls.from_table(document[_KEY], str(path))


def _disagreements(limits: SafetyLimits) -> list[Mistake]:
    found = []
    if limits.shallowest_mm >= limits.deepest_mm:
        rule = f"must be less than deepest_mm, {limits.deepest_mm:g}"
        found.append(Mistake(f"{_KEY}.shallowest_mm", f"{limits.shallowest_mm:g}", rule))
    for name in ("workspace_x_mm", "workspace_y_mm"):
        pair = getattr(limits, name)
        if pair is not None and pair[0] >= pair[1]:
            found.append(Mistake(f"{_KEY}.{name}", shown(pair), "must be [least, most]"))
    return found
