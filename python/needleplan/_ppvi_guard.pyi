"""The safety guard in `_ppvi`, a stub of its own; at run time there is no module of this name."""

from collections.abc import Sequence
from typing import TypeAlias, final

__all__ = [
    "DeadmanTimer",
    "ForceWindow",
    "HeartbeatTimer",
    "RepeatedStop",
    "guard_against_insertion",
    "guard_against_retraction",
    "guard_against_rotation",
    "guard_causes",
    "guard_delay",
    "guard_freshness",
    "guard_ordered",
    "guard_validated",
]

# Fields of a state of the guard: operating state, homed, busy, present, latched, time, holder, owner of the motion,
# zero lost, first causes, stopping, owner who waits. Causes are bit masks.
_GuardState: TypeAlias = tuple[int, bool, bool, int, int, int, int | None, int | None, bool, int, bool, int | None]
# Next state, whether to stop, whether to move (0) or to retract (1), causes, whether the order is refused; None: no
# change
_GuardStep: TypeAlias = tuple[_GuardState, bool, int | None, int, bool] | None
# Shallowest and deepest depth, velocities inward and outward, roll, velocity of the roll
_CommandLimits: TypeAlias = tuple[float, float, float, float, float, float]

def guard_causes() -> list[tuple[str, int, int]]:
    """Name, owner and severity (0 refusal, 1 pause, 2 fault) of each cause, by the number of its bit."""

def guard_validated(
    before: _GuardState, causes: int, is_busy: bool, is_retracting: bool, is_resting: bool, now_ns: int
) -> _GuardStep: ...
def guard_ordered(before: _GuardState, order: int, owner: int, now_ns: int) -> _GuardStep: ...
def guard_against_insertion(
    numbers: _CommandLimits, here_mm: float | None, depth_mm: float, velocity_mm_s: float
) -> int: ...
def guard_against_retraction(
    numbers: _CommandLimits, here_mm: float | None, depth_mm: float, velocity_mm_s: float
) -> int: ...
def guard_against_rotation(numbers: _CommandLimits, roll_rad: float, velocity_rad_s: float) -> int: ...
def guard_delay(before: Sequence[float] | None, received_ns: int, device_s: float) -> list[float]:
    """Delay of a sample (s), and the three numbers (s) that the next call needs."""

def guard_freshness(
    has_failed: bool, received_ns: int | None, taken_ns: int | None, usable_ns: int | None, limit_s: float, now_ns: int
) -> tuple[int, bool]:
    """Freshness (0 fresh, 1 failed, 2 stale, 3 unusable), and whether the last sample is of the future."""

@final
class ForceWindow:
    """Rise (N) of the magnitude of the force above its minimum of the last 50 ms; infinite if the window overflowed."""

    def __new__(cls) -> ForceWindow: ...
    def observe(self, time_ns: int, force_n: float) -> None: ...
    @property
    def rise_n(self) -> float: ...
    def exceeds(self, limit_n_s: float) -> bool: ...

@final
class RepeatedStop:
    """Times at which a stop is repeated, and the number of stops that are on their way."""

    def __new__(cls) -> RepeatedStop: ...
    @property
    def arrived_ns(self) -> int | None: ...
    @property
    def is_on_its_way(self) -> bool: ...
    def begin(self) -> None: ...
    def end(self, sent_ns: int, now_ns: int, *, arrived: bool) -> None: ...
    def due(self, now_ns: int) -> bool: ...

@final
class HeartbeatTimer:
    """Time of the last heartbeat; `take` returns whether one is due now, which then counts as sent."""

    def __new__(cls, now_ns: int) -> HeartbeatTimer: ...
    def take(self, now_ns: int) -> bool: ...

@final
class DeadmanTimer:
    """Last signal of a deadman switch."""

    def __new__(cls) -> DeadmanTimer: ...
    def observe(self, is_held: bool, now_ns: int) -> None: ...
    def is_released(self, limit_s: float, now_ns: int) -> bool: ...
