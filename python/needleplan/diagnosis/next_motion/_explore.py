"""The motion that gives most information on an unexplained gap along its axis.

The gap is modelled as a smooth function along the axis: a sum of basis functions b with independent normal
coefficients. The standard deviation s of the coefficients maximises the likelihood of the data. Let M = b'W b be the
normal matrix of the recordings so far and M' that of one more trial, both with the base model projected out. That trial
contributes

    log2 det(1 + s^2 (M + M')) / det(1 + s^2 M) / 2        bits

of information on the gap (Lindley, Ann. Math. Stat. 27 (1956) 986). The basis covers the range of all considered
motions, so that ranges without recordings count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from needleplan.diagnosis._diagnosis import Diagnosis
from needleplan.diagnosis.alternatives import smooth_bases
from needleplan.diagnosis.calibration import CalibratedTrial
from needleplan.diagnosis.channels import GapAxis
from needleplan.diagnosis.gap import axis_values
from needleplan.diagnosis.likelihood import JointLikelihood
from needleplan.diagnosis.next_motion._programs import NextMotion, Tried, predicted_trial
from needleplan.signals import Array, Role

__all__ = ["Exploring", "exploring", "information_bits"]

# Prior amplitudes tried, in units of the noise RMS.
_AMPLITUDES = np.geomspace(0.03, 100.0, 15)
# Longest permitted duration (s) of a motion; a longer recording raises this limit.
_LONGEST_S = 45.0
# Correlation of time and depth above which recordings cannot separate these axes.
_ALIKE = 0.99
# Axis that is explored in place of the axis of the gap.
_INSTEAD = {GapAxis.PERIOD: GapAxis.DEPTH}

# Units of the axes.
_UNITS = {
    GapAxis.TIME: "s", GapAxis.DEPTH: "mm", GapAxis.SPEED: "mm/s", GapAxis.FORCE: "N", GapAxis.DWELL: "s",
    GapAxis.PERIOD: "mm", GapAxis.ANGLE: "rad",
}  # fmt: skip


@dataclass(frozen=True)
class Exploring(NextMotion):
    """The motion that gives the most information about a gap, along the axis on which the gap depends."""

    axis: GapAxis
    also: GapAxis | None
    """Axis that the recordings cannot separate from `axis`, as time and depth at constant speed; None if separable."""

    unit: str
    visited: tuple[float, float]
    """Range of the axis that the recordings cover."""

    reach: tuple[float, float]
    """Range of the axis that this motion covers."""

    bits: float
    """Information (bits) of this motion on the gap."""

    repeated_bits: float
    """Information (bits) if the last training motion were repeated instead."""

    considered: tuple[tuple[str, float], ...]
    """Name and information (bits) of each program."""

    @property
    def why(self) -> str:
        """Reason for the motion, in words."""
        name = self.axis.label
        one = f" or {self.also}, which these recordings cannot separate" if self.also else ""
        saw = _ends_words(self.visited, self.unit)
        return (
            f"The gap depends on {name}{one}. The recordings cover {saw} of {name}; this motion covers "
            f"{_ends_words(self.reach, self.unit)} and adds {self.bits:.1f} bits of information on the gap. The last "
            f"motion, repeated, would add {self.repeated_bits:.1f} bits."
        )


def exploring(found: Diagnosis, axis: GapAxis, tried: Sequence[Tried], role: Role) -> Exploring | None:
    """Return the most informative motion for a gap along an axis; None if the channel has no basis for the axis.

    Motions that are longer than 45 s and longer than every recording are left out, unless no motion would remain.
    """
    known = found.joint.trials if found.effects and found.joint else found.calibration.training
    longest = max(_LONGEST_S, *(float(np.ptp(trial.motion.time_s)) for trial in known))
    tried = [each for each in tried if float(np.ptp(each[1].time_s)) <= longest] or tried
    heterogeneity_sd = np.array([found.selection.base.heterogeneity_sd])
    trials = [predicted_trial(found.base, found.calibration, motion) for _, motion in tried]
    also = _inseparable_axis(axis, known)
    functions = _columns(found, axis, [*known, *trials])
    if functions is None:
        return None
    more = _columns(found, also, [*known, *trials]) if also else None
    if more is not None:
        functions = tuple(np.column_stack(each) for each in zip(functions, more, strict=True))
    whitened = [trial.whiten(each) for trial, each in zip([*known, *trials], functions, strict=True)]
    first = len(known)
    now, target = JointLikelihood([trial.whitened for trial in known], heterogeneity_sd).normal(whitened[:first], 0)
    size = _likeliest_size(now, target, found.calibration.noise.rms)
    bits = [
        _more_bits(now, trial, each, heterogeneity_sd, size)
        for trial, each in zip(trials, whitened[first:], strict=True)
    ]
    again = _more_bits(now, known[-1], whitened[first - 1], heterogeneity_sd, size)
    best = int(np.argmax(bits))
    program, motion = tried[best]
    return Exploring(
        program, motion, role, axis, also, _UNITS[axis], _ends(axis, known), _ends(axis, [trials[best]]), bits[best],
        again, tuple((each.name, value) for (each, _), value in zip(tried, bits, strict=True)),
    )  # fmt: skip


def information_bits(now: Array, more: Array, size: float) -> float:
    """Return the information (bits) that the normal matrix `more` adds to `now`.

    `size` is the prior standard deviation of the coefficients.
    """
    one = np.eye(len(now))
    after, before = (float(np.linalg.slogdet(one + size**2 * each)[1]) for each in (now + more, now))
    return max(after - before, 0.0) / (2 * float(np.log(2)))


def _more_bits(now: Array, trial: CalibratedTrial, functions: Array, heterogeneity_sd: Array, size: float) -> float:
    more, _ = JointLikelihood([trial.whitened], heterogeneity_sd).normal([functions], 0)
    return information_bits(now, more, size)


def _columns(found: Diagnosis, axis: GapAxis, trials: Sequence[CalibratedTrial]) -> tuple[Array, ...] | None:
    """Return the basis along an axis with the largest gain, one array per trial; None if the channel has no basis."""
    made = smooth_bases(trials)
    alternatives = found.selection.rounds[-1 if found.effects else 0].alternatives
    wanted = _INSTEAD.get(axis, axis)
    names = [each.name for each in alternatives if each.name in made and made[each.name].axis is wanted]
    names += [name for name, basis in made.items() if basis.axis is wanted]
    return made[names[0]].functions if names else None


def _inseparable_axis(axis: GapAxis, trials: Sequence[CalibratedTrial]) -> GapAxis | None:
    """Return depth for the axis time, and time for the axis depth, if they are closely correlated in all trials.

    Returns None otherwise, and for other axes.
    """
    other = {GapAxis.TIME: GapAxis.DEPTH, GapAxis.DEPTH: GapAxis.TIME}.get(axis)
    both = [np.corrcoef(trial.motion.time_s, trial.motion.depth_mm)[0, 1] for trial in trials]
    return other if other and min(both) > _ALIKE else None


def _likeliest_size(matrix: Array, target: Array, noise_sd: float) -> float:
    """Return the prior standard deviation of the coefficients that maximises the likelihood."""
    one = np.eye(len(target))

    def evidence(size: float) -> float:
        shrunk = one + size**2 * matrix
        return float(size**2 * target @ np.linalg.solve(shrunk, target) - np.linalg.slogdet(shrunk)[1])

    return float(max(_AMPLITUDES * noise_sd, key=evidence))


def _ends(axis: GapAxis, trials: Sequence[CalibratedTrial]) -> tuple[float, float]:
    values = [axis_values(axis, trial.motion, trial.output) for trial in trials]
    return min(float(each.min()) for each in values), max(float(each.max()) for each in values)


def _ends_words(ends: tuple[float, float], unit: str) -> str:
    return f"{ends[0]:.3g} to {ends[1]:.3g} {unit}"
