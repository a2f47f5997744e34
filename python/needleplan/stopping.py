"""When a needle that was stopped is at rest: measured, never believed.

Let the stop be decided at the depth `d0` and the speeds `v0` (of the depth) and `w0` (of the roll), and reach the stage
at the time `T`. A sample i, taken at
`t_i`, has the depth `d_i`, the velocity `v_i` and the roll `r_i`. Then

1. the needle *rests* if, over a run of samples with `t_i > T` of at least `w` without a gap above `GAP_S` that ends
   now, `max d_i - min d_i <= rest_mm`, `max r_i - min r_i <= rest_rad` and `|v_i| <= rest_mm_s`. Here `w` is the
   longest of `window_s` and, up to `_LONGEST_WINDOW_S`, the times `1.25 rest_mm / v` and `1.25 rest_rad / w`, in which
   a needle that goes on at `v` or `w` leaves `rest_mm` or `rest_rad`; `v` and `w` are `v0` and `w0`, and those that the
   run shows, its ranges over its duration. So a needle that creeps on is not at rest at more than 0.08 mm/s;
2. it *moves* in spite of the stop if it does not rest, and has left `d0` by more than the braking distance
   `following_mm + v0^2 / (2 braking_mm_s2)`, or `motion_s` has passed and the samples of the last `motion_s` show a
   motion;
3. its rest is *unknown* if no sample has arrived for `silent_s`, or `motion_s` has passed, and the samples stand still
   but are too rare, or the stop has not reached the stage: it must be treated as moving;
4. otherwise it *brakes*.

A robot's own report that it does not move, and its answer to a stop, do not enter. `needleplan stop` uses this module
before it imports anything else, so the module imports next to nothing.
"""

from __future__ import annotations

from enum import StrEnum

__all__ = ["GAP_S", "WINDOW_S", "Rest", "StopLimits", "StopProcedure", "limits_at_any_speed"]

WINDOW_S = 0.05
"""Duration (s) of measured standstill that counts as rest, if it shows no slow motion."""

# Duration (s) that counts as rest if a slow motion is possible; a needle at 0.08 mm/s, or at 0.016 rad/s, leaves the
# default `rest_mm` or `rest_rad` in it.
_LONGEST_WINDOW_S = 0.25

# Ratio of the distance that a needle covers in the window at its speed to `rest_mm` or `rest_rad`
_WINDOW_SHARE = 1.25

GAP_S = 0.03
"""Longest time (s) between two samples of a standstill: the age limit of a stage sample."""

# Relative rounding error of a time in s
_ROUNDING_S = 1e-9


class Rest(StrEnum):
    """Motion state of a needle after a stop, from its measured positions."""

    RESTS = "rests"
    BRAKES = "brakes"
    """The needle has not come to rest, within its braking distance and time."""

    MOVES = "moves"
    """The needle moves in spite of the stop."""

    UNKNOWN = "unknown"
    """No fresh sample tells; treat the needle as moving."""


class StopLimits:
    """Limits of a stop.

    Parameters
    ----------
    rest_mm, rest_rad : float
        Largest range of depth (mm) and roll (rad) during a standstill, at least the resolution of the sensors. The
        defaults are twice the range within which the robot machine regards an axis as standing. `rest_mm` also bounds
        the mean speed of a standstill, by default to 0.08 mm/s.
    rest_mm_s : float
        Largest measured speed (mm/s) of a sample during a standstill. The default is one step of 1 um in 1 ms.
    following_mm : float
        Distance (mm) that the needle covers before the stop takes effect. The default is 50 ms at 10 mm/s.
    braking_mm_s2 : float
        Smallest deceleration (mm/s2) of the stage. The default is the deceleration of the shipped lab.
    motion_s : float
        Longest time (s) from the stop to rest.
    silent_s : float
        Time (s) without a sample after which the state of the needle is unknown; the same as `lost_s` of a robot's
        session.
    window_s : float
        Shortest duration (s) of a standstill that counts as rest.
    """

    rest_mm: float
    rest_rad: float
    rest_mm_s: float
    following_mm: float
    braking_mm_s2: float
    motion_s: float
    silent_s: float
    window_s: float

    def __init__(
        self, rest_mm: float = 0.02, rest_rad: float = 0.004, rest_mm_s: float = 1.0, following_mm: float = 0.5,
        braking_mm_s2: float = 100.0, motion_s: float = 0.5, silent_s: float = 0.1, window_s: float = WINDOW_S,
    ) -> None:  # fmt: skip
        self.rest_mm, self.rest_rad, self.rest_mm_s = rest_mm, rest_rad, rest_mm_s
        self.following_mm, self.braking_mm_s2 = following_mm, braking_mm_s2
        self.motion_s, self.silent_s, self.window_s = motion_s, silent_s, window_s

    def braking_mm(self, speed_mm_s: float) -> float:
        """Return the braking distance (mm) from a speed (mm/s)."""
        return self.following_mm + speed_mm_s**2 / (2 * self.braking_mm_s2)

    def standstill_s(self, speed_mm_s: float, speed_rad_s: float = 0.0) -> float:
        """Return the duration of a standstill that counts as rest after a motion.

        Speeds at which a needle does not leave `rest_mm` or `rest_rad` within `_LONGEST_WINDOW_S` count as no motion.

        Parameters
        ----------
        speed_mm_s : float
            Speed of the insertion (mm/s).
        speed_rad_s : float, default 0.0
            Speed of the rotation (rad/s).

        Returns
        -------
        float
            Duration (s).
        """
        duration_s = self.window_s
        for speed, rest in ((speed_mm_s, self.rest_mm), (speed_rad_s, self.rest_rad)):
            if speed * _LONGEST_WINDOW_S > rest:
                duration_s = max(duration_s, min(_WINDOW_SHARE * rest / speed, _LONGEST_WINDOW_S))
        return duration_s


def limits_at_any_speed(silent_s: float = 0.1) -> StopLimits:
    """Return the default limits of a stop whose speed is unknown: the longest standstill, which may end later."""
    usual = StopLimits()
    return StopLimits(silent_s=silent_s, motion_s=usual.motion_s + _LONGEST_WINDOW_S, window_s=_LONGEST_WINDOW_S)


class StopProcedure:
    """One stop: the samples of the stage after it, and the motion state of the needle that they show.

    All times are in s, on one clock.

    Parameters
    ----------
    limits : StopLimits
        Limits of the stop.
    begun_s : float
        Time of the stop.
    depth_mm : float, optional
        Last known depth before the stop (mm). Default: the depth of the first sample.
    speed_mm_s : float, default 0.0
        Largest of the measured and the commanded insertion speed (mm/s) before the stop.
    speed_rad_s : float, default 0.0
        Commanded speed of the rotation (rad/s) before the stop.
    """

    limits: StopLimits
    begun_s: float

    def __init__(
        self, limits: StopLimits, begun_s: float, depth_mm: float | None = None, speed_mm_s: float = 0.0,
        speed_rad_s: float = 0.0,
    ) -> None:  # fmt: skip
        self.limits, self.begun_s = limits, begun_s
        self.depth_mm: float | None = depth_mm
        """Depth of the last sample (mm), or None."""

        self._begin_mm, self._speed_mm_s, self._speed_rad_s = depth_mm, abs(speed_mm_s), abs(speed_rad_s)
        self._heard_s = begun_s
        self._arrived_s: float | None = None
        self._last: tuple[float, float | None] | None = None
        self._since: tuple[float, float | None] = (begun_s, None)
        self._range: list[float] = []
        self._is_beyond = False
        self._moved_s: float | None = None
        """Time of the last sample (s) that shows a motion, or None."""

    def arrived(self, now_s: float) -> None:
        """Note that the stop has reached the stage: only samples that are taken later show a standstill."""
        if self._arrived_s is None:
            self._arrived_s = now_s

    @property
    def moved_mm(self) -> float:
        """Distance (mm) of the last sample from the depth at the stop; 0 without a sample."""
        if self.depth_mm is None or self._begin_mm is None:
            return 0.0
        return abs(self.depth_mm - self._begin_mm)

    @property
    def stands(self) -> bool:
        """Whether the last sample belongs to a standstill, of whatever duration, of at least two samples."""
        return self._is_counted and self._last is not None and self._last[0] > self._since[0]

    @property
    def _is_counted(self) -> bool:
        """Whether the present standstill began after the stop had reached the stage."""
        return self._arrived_s is not None and self._since[0] > self._arrived_s

    def see(
        self, taken_s: float, depth_mm: float, velocity_mm_s: float, roll_rad: float, device_s: float | None = None
    ) -> None:
        """Process a sample of the stage.

        Samples that are not newer than the last one, or not after the begin, are ignored. A sample that is not finite
        ends the standstill.

        Parameters
        ----------
        taken_s : float
            Time of measurement (s).
        depth_mm : float
            Depth (mm).
        velocity_mm_s : float
            Velocity (mm/s).
        roll_rad : float
            Roll angle (rad).
        device_s : float, optional
            Time on the clock of the device (s), if it has one.
        """
        last = self._last
        if taken_s <= self.begun_s or (last is not None and taken_s <= last[0]):
            return
        if last is not None and device_s is not None and last[1] is not None and device_s <= last[1]:
            return  # repeated, or of the time before a restart
        self._last = taken_s, device_s
        numbers = (depth_mm, velocity_mm_s, roll_rad)
        if not all(-1e9 < each < 1e9 for each in numbers):  # False for NaN, too
            self._range = []
            self._moved_s = taken_s
            return
        self._heard_s = taken_s
        self._note_way(depth_mm, velocity_mm_s, taken_s)
        self._note_standstill(taken_s, device_s, last, numbers)

    def _note_way(self, depth_mm: float, velocity_mm_s: float, taken_s: float) -> None:
        if self._begin_mm is None:
            self._begin_mm = depth_mm
        if taken_s - self.begun_s <= GAP_S:  # the robot may not have received the stop yet
            self._speed_mm_s = max(self._speed_mm_s, abs(velocity_mm_s))
        self.depth_mm = depth_mm
        self._is_beyond = self._is_beyond or self.moved_mm > self.limits.braking_mm(self._speed_mm_s)

    def _note_standstill(
        self, taken_s: float, device_s: float | None, last: tuple[float, float | None] | None,
        numbers: tuple[float, float, float],
    ) -> None:  # fmt: skip
        depth_mm, velocity_mm_s, roll_rad = numbers
        limits, is_counted = self.limits, self._is_counted
        low, high, left, right = self._range or (depth_mm, depth_mm, roll_rad, roll_rad)
        low, high, left, right = min(low, depth_mm), max(high, depth_mm), min(left, roll_rad), max(right, roll_rad)
        is_slow = abs(velocity_mm_s) <= limits.rest_mm_s
        is_still = is_slow and high - low <= limits.rest_mm and right - left <= limits.rest_rad
        if not is_still:
            self._moved_s = taken_s
        is_near = last is not None and taken_s - last[0] <= GAP_S + _ROUNDING_S
        if is_still and self._range and is_near and (is_counted or self._arrived_s is None):
            self._range = [low, high, left, right]
            return
        self._range = [depth_mm, depth_mm, roll_rad, roll_rad] if is_slow else []
        self._since = taken_s, device_s

    def rest(self, now_s: float) -> Rest:
        """Return the motion state at a time (s) on the clock of the samples."""
        is_fresh = now_s - self._heard_s <= GAP_S + _ROUNDING_S
        if is_fresh and self._range and self._is_counted and self._is_long_enough():
            return Rest.RESTS
        if now_s - self._heard_s > self.limits.silent_s + _ROUNDING_S:
            return Rest.UNKNOWN
        if self._is_beyond:
            return Rest.MOVES
        if now_s - self.begun_s <= self.limits.motion_s + _ROUNDING_S:
            return Rest.BRAKES
        has_moved = self._moved_s is not None and now_s - self._moved_s <= self.limits.motion_s
        return Rest.MOVES if has_moved else Rest.UNKNOWN

    def _is_long_enough(self) -> bool:
        """Return whether the standstill is long by both clocks: samples that arrive together may be old."""
        if self._last is None:
            return False
        (begin_s, begin_device_s), (end_s, end_device_s) = self._since, self._last
        duration_s = end_s - begin_s
        if begin_device_s is not None and end_device_s is not None:
            duration_s = min(duration_s, end_device_s - begin_device_s)
        if duration_s < self.limits.window_s - _ROUNDING_S:
            return False
        low, high, left, right = self._range
        least_s = max(
            self.limits.standstill_s(self._speed_mm_s, self._speed_rad_s),
            self.limits.standstill_s((high - low) / duration_s, (right - left) / duration_s),
        )
        return duration_s >= least_s - _ROUNDING_S
