"""The motion that shows most of a gap without a name: along its axis, what is known least of it.

What is missing is taken as a smooth function along the axis, of the kind that won without a name: a sum of columns b
with sizes that are independent and normal, of the variance under which the data are most probable. With M = b'W b of
the recordings so far and M' of one more trial, each with all that the base can take up projected out, that trial says

    log2 det(1 + s^2 (M + M')) / det(1 + s^2 M) / 2        bits

of it (Lindley, Ann. Math. Stat. 27 (1956) 986). Columns reach as far as the motions that are considered, so that what
nobody has seen yet counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from needleplan.diagnosis.calibrate import Case
from needleplan.diagnosis.curves import axis_values
from needleplan.diagnosis.diagnosis import Diagnosis
from needleplan.diagnosis.measurand import Axis
from needleplan.diagnosis.next_motion.proposal import NextMotion, Tried, predicted_case
from needleplan.diagnosis.rivals import bases
from needleplan.diagnosis.space import Space
from needleplan.signals import Array, Role

__all__ = ["Exploring", "exploring", "information_bits"]

_SIZES = np.geomspace(0.03, 100.0, 15)
"""Of the noise's standard deviation."""

_LONGEST_S = 45.0
"""A motion is not longer than that, or than the recordings: of time that nobody asked about, anything says most."""

_ALIKE = 0.99

_INSTEAD = {Axis.PERIOD: Axis.DEPTH}
"""Where a wave of the position is missing, every place counts."""

_UNITS = {
    Axis.TIME: "s", Axis.DEPTH: "mm", Axis.SPEED: "mm/s", Axis.FORCE: "N", Axis.HOLD: "s", Axis.PERIOD: "mm",
    Axis.ANGLE: "rad",
}  # fmt: skip


@dataclass(frozen=True)
class Exploring(NextMotion):
    """The motion from which most is learnt about a gap along its axis."""

    axis: Axis
    also: Axis | None
    """Another axis that the recordings cannot tell from it: at one speed and one way, time and depth are one."""

    unit: str
    visited: tuple[float, float]
    """Along the axis, by the recordings so far."""

    reach: tuple[float, float]
    """The same, by this motion."""

    bits: float
    """What it says of the gap."""

    repeated_bits: float
    """What the last training motion says, made once more."""

    considered: tuple[tuple[str, float], ...]
    """All programs: name and bits."""

    @property
    def why(self) -> str:
        """Where it goes, and what is learnt there."""
        name = self.axis.replace("_", " ")
        one = f" or {self.also}, which are one in these recordings" if self.also else ""
        saw = _ends_words(self.visited, self.unit)
        return (
            f"The gap lies along {name}{one}; of {name} the recordings saw {saw}; this "
            f"motion goes over {_ends_words(self.reach, self.unit)} and says {self.bits:.1f} bits of the gap, the last "
            f"motion again {self.repeated_bits:.1f}."
        )


def exploring(found: Diagnosis, axis: Axis, tried: Sequence[Tried], role: Role) -> Exploring | None:
    """Return the best of the motions for a gap along an axis; None where the channel has no functions along it."""
    known = found.joint.cases if found.effects and found.joint else found.calibration.training
    longest = max(_LONGEST_S, *(float(np.ptp(case.motion.time_s)) for case in known))
    tried = [each for each in tried if float(np.ptp(each[1].time_s)) <= longest] or tried
    level = np.array([found.selection.base.level])
    cases = [predicted_case(found.base, found.calibration, motion) for _, motion in tried]
    also = _one_with(axis, known)
    columns = _columns(found, axis, [*known, *cases])
    if columns is None:
        return None
    more = _columns(found, also, [*known, *cases]) if also else None
    if more is not None:
        columns = tuple(np.column_stack(each) for each in zip(columns, more, strict=True))
    whitened = [case.whiten(each) for case, each in zip([*known, *cases], columns, strict=True)]
    first = len(known)
    now, target = Space([case.block for case in known], level).normal(whitened[:first], 0)
    size = _likeliest_size(now, target, found.calibration.noise.rms)
    bits = [_more_bits(now, case, each, level, size) for case, each in zip(cases, whitened[first:], strict=True)]
    again = _more_bits(now, known[-1], whitened[first - 1], level, size)
    best = int(np.argmax(bits))
    program, motion = tried[best]
    return Exploring(
        program, motion, role, axis, also, _UNITS[axis], _ends(axis, known), _ends(axis, [cases[best]]), bits[best],
        again, tuple((each.name, value) for (each, _), value in zip(tried, bits, strict=True)),
    )  # fmt: skip


def information_bits(now: Array, more: Array, size: float) -> float:
    """Return what more normal equations say of sizes that are normal with sd `size`, beside those there are now."""
    one = np.eye(len(now))
    after, before = (float(np.linalg.slogdet(one + size**2 * each)[1]) for each in (now + more, now))
    return max(after - before, 0.0) / (2 * float(np.log(2)))


def _more_bits(now: Array, case: Case, columns: Array, level: Array, size: float) -> float:
    more, _ = Space([case.block], level).normal([columns], 0)
    return information_bits(now, more, size)


def _columns(found: Diagnosis, axis: Axis, cases: Sequence[Case]) -> tuple[Array, ...] | None:
    """Return the smooth function along the axis that gains most, or any; one array for each trial."""
    made = bases(cases)
    rivals = found.selection.steps[-1 if found.effects else 0].rivals
    wanted = _INSTEAD.get(axis, axis)
    names = [each.name for each in rivals if each.name in made and made[each.name].axis is wanted]
    names += [name for name, basis in made.items() if basis.axis is wanted]
    return made[names[0]].columns if names else None


def _one_with(axis: Axis, cases: Sequence[Case]) -> Axis | None:
    """Return depth for time, and time for depth, where the two went along with each other in all trials."""
    other = {Axis.TIME: Axis.DEPTH, Axis.DEPTH: Axis.TIME}.get(axis)
    both = [np.corrcoef(case.motion.time_s, case.motion.depth_mm)[0, 1] for case in cases]
    return other if other and min(both) > _ALIKE else None


def _likeliest_size(matrix: Array, target: Array, noise_sd: float) -> float:
    """Return the standard deviation of the sizes under which the data are most probable."""
    one = np.eye(len(target))

    def evidence(size: float) -> float:
        shrunk = one + size**2 * matrix
        return float(size**2 * target @ np.linalg.solve(shrunk, target) - np.linalg.slogdet(shrunk)[1])

    return float(max(_SIZES * noise_sd, key=evidence))


def _ends(axis: Axis, cases: Sequence[Case]) -> tuple[float, float]:
    values = [axis_values(axis, case.motion, case.output) for case in cases]
    return min(float(each.min()) for each in values), max(float(each.max()) for each in values)


def _ends_words(ends: tuple[float, float], unit: str) -> str:
    return f"{ends[0]:.3g} to {ends[1]:.3g} {unit}"
