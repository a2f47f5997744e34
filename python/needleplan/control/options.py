"""How an insertion is done: speeds, torsional lag, when it plans again, and when it gives up."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from needleplan.errors import InputError, Mistake
from needleplan.models import Torsion

__all__ = ["Options"]

_POSITIVE = (
    "velocity_mm_s", "velocity_rad_s", "longest_mm", "needle_length_mm", "silence_s", "replan_deviations",
)  # fmt: skip


@dataclass(frozen=True)
class Options:
    """All of them have defaults; lengths in mm, angles in rad. Raises InputError with all mistakes."""

    velocity_mm_s: float = 5.0
    """Speed of insertion; the thesis has up to 12."""

    velocity_rad_s: float = 3.0
    """Speed of rotation; the thesis has 3 turns a minute, a tenth of that."""

    entry_depth_mm: float = 0.0
    """Depth of the stage at which the tip is at the entry."""

    roll_left_rad: float = 0.0
    """Roll of the stage at which the needle bends to the left."""

    longest_mm: float = 180.0
    """Longest path of the tip."""

    torsion: Torsion | None = None
    """Torsional lag to compensate; None: the tip is taken to turn with its base."""

    needle_length_mm: float = 200.0
    stops: bool = False
    """Stop after every step; otherwise only to rotate."""

    lead_s: float = 0.15
    """How long before the end of a step the next decision is made; at least as long as the stage takes to stop."""

    settling_frames: int = 4
    """Frames of the tracker that are waited for when the needle stands."""

    least_success: float = 0.01
    """Where the table promises less than that, the insertion ends."""

    replan: bool = True
    """Plan again when the curvature leaves the plan's."""

    replan_deviations: float = 3.0
    """Standard deviations between estimated and planned curvature at which the plan is taken to be wrong ..."""

    replan_share: float = 0.04
    """... if they differ by this share of the planned one as well: less does not change a policy noticeably."""

    silence_s: float = 1.0
    """Time without any sample after which the devices are taken to be dead."""

    expected_start: tuple[float, float, float] | None = None
    """Where the needle should go in, x_mm, y_mm, heading_rad: elsewhere it does not."""

    start_within_mm: float = 5.0
    start_within_rad: float = 0.2

    resume_s: float = 5.0
    """How long a pause, such as one for a tracker that does not see its coil, is waited out; then the run ends. By
    beginning it, the operator has allowed the loop to resume in his place; 0 does not. A fault is never waited out."""

    force_axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Direction in the frame of the force sensor in which a force that resists insertion is positive."""

    def __post_init__(self) -> None:
        mistakes = [
            Mistake(name, f"{getattr(self, name):g}", "must be a number above 0")
            for name in _POSITIVE if not 0 < getattr(self, name) < math.inf
        ]  # fmt: skip
        for each in fields(self):
            value = getattr(self, each.name)
            if each.name not in _POSITIVE and isinstance(value, float) and not math.isfinite(value):
                mistakes.append(Mistake(each.name, f"{value:g}", "must be a finite number"))
        for name in ("lead_s", "replan_share", "resume_s", "settling_frames"):
            if getattr(self, name) < 0:
                mistakes.append(Mistake(name, f"{getattr(self, name):g}", "must be at least 0"))
        if not 0 <= self.least_success <= 1:
            mistakes.append(Mistake("least_success", f"{self.least_success:g}", "must be from 0 to 1"))
        length = math.hypot(*self.force_axis)
        if not 0.999 < length < 1.001:
            mistakes.append(Mistake("force_axis", str(self.force_axis), "must be a direction of length 1"))
        if mistakes:
            raise InputError(mistakes, "options of the insertion")
