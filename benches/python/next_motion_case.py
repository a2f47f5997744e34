"""Blind data in which effects look alike, for both channels, and further trials in the same tissue."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np
from diagnosis_subject import SUBJECTS, Subject, SubjectName, records

from needleplan.signals import Motion, Record
from tests.blind import force, path
from tests.blind.campaign import HETEROGENEITY, NAMEABLE, SEEDS, UNSEEN, Purpose, Variety
from tests.blind.effect import ForceName
from tests.blind.motions import MotionKind, from_depths, trajectory
from tests.blind.path_effect import PathName
from tests.blind.recording import DataSet, Trial
from tests.blind.steering import STEP_S, SteeringKind, from_rates, steering

__all__ = ["SOURCES", "Source", "Spec"]

Spec = Any
"""Specification of a data set: ForceSpec or PathSpec."""

_BEHIND = 9_000_000
"""Offset of the seeds, beyond those of the campaign with the same purpose."""

_CLEAR = (
    ForceName.PUNCTURE, ForceName.BUMPS, ForceName.LATENCY, ForceName.INERTIA, ForceName.RELAXATION,
    ForceName.FRICTION_LAYER, ForceName.CUTTING_LAYER, ForceName.PATH_DAMAGE,
)  # fmt: skip
"""Excluded effects: those that look like no other effect, or that poor motions do not show."""


_SIZES, _SIGMAS = (0.5, 3.0), (2.0, 12.0)
"""Ranges of effect sizes (force: multiple of the noise; tip: standard deviations) in which effects look alike.

Smaller effects are not detected, and most larger ones are identified without a further motion.
"""


@dataclass(frozen=True)
class Source(ABC):
    """An endless supply of data sets of one channel, which cycles through effects, heterogeneities and lengths."""

    subject: Subject

    @abstractmethod
    def specs(self, purpose: Purpose) -> Iterator[Spec]:
        """Yield specifications of data sets with poor motions and one hidden effect."""

    @abstractmethod
    def hidden(self, spec: Spec) -> tuple[str, float]:
        """Return the name in the library and the size (multiple of the noise) of the hidden effect."""

    @abstractmethod
    def extra(self, spec: Spec, motion: Motion) -> Record:
        """Return one more training trial in the same tissue, with the given motion."""

    @abstractmethod
    def again(self, spec: Spec) -> Record:
        """Return one more training trial in the same tissue, with the last motion repeated."""

    def generate(self, spec: Spec) -> list[Record]:
        """Return the recordings of a data set."""
        data, _ = self.subject.generate(spec)
        return records(data)

    def called(self, name: Any) -> str:
        """Return the name in the library of an effect of the blind data."""
        return self.subject.called.get(name, str(name))


class _Force(Source):
    """Axial force: two or three trials at 5 mm/s (one is rarely enough), and a slower or faster held-out trial."""

    def specs(self, purpose: Purpose) -> Iterator[force.ForceSpec]:
        names = [each for each in NAMEABLE if each not in UNSEEN[Variety.POOR] and each not in _CLEAR]
        for number in count():
            seed = SEEDS[purpose].start + _BEHIND + number
            name, level, turn = _mixed(number, names)
            wanted = force.Wanted(name, _log_uniform(seed, *_SIZES))
            training = (MotionKind.CONSTANT,) * (2 + turn % 2)
            held_out = (MotionKind.CONSTANT_SLOW, MotionKind.CONSTANT_FAST)[turn // 2 % 2]
            yield force.ForceSpec(seed, (wanted,), level, training, (held_out,))

    def hidden(self, spec: Spec) -> tuple[str, float]:
        (wanted,) = spec.effects
        return self.called(wanted.name), wanted.noise_multiple

    def extra(self, spec: Spec, motion: Motion) -> Record:
        run = from_depths("extra", np.asarray(motion.time_s), np.asarray(motion.depth_mm))
        return _record(force.another(spec, run))

    def again(self, spec: Spec) -> Record:
        return _record(force.another(spec, trajectory(spec.training[-1])))


# What insertions at one speed without a turn cannot show at all.
_UNSEEN = (PathName.CURVATURE_SPEED, PathName.TORSIONAL_LAG, PathName.TURN_SLIP)


class _Tip(Source):
    """Path of the tip: one to three insertions at one speed without a turn, and a held-out insertion with one turn."""

    def specs(self, purpose: Purpose) -> Iterator[path.PathSpec]:
        names = [each for each in path.INSIDE_PATH if each not in _UNSEEN]
        for number in count():
            seed = SEEDS[purpose].start + _BEHIND + number
            name, level, turn = _mixed(number, names)
            wanted = path.Moves(name, _log_uniform(seed, *_SIGMAS))
            training = (SteeringKind.ONE_SPEED,) * (1 + turn % 3)
            yield path.PathSpec(seed, (wanted,), level, training, (SteeringKind.LATE_TURN,))

    def hidden(self, spec: Spec) -> tuple[str, float]:
        (wanted,) = spec.effects
        return self.called(wanted.name), wanted.sigmas

    def extra(self, spec: Spec, motion: Motion) -> Record:
        time_s = np.asarray(motion.time_s)
        steps = np.arange(round(float(time_s[-1] - time_s[0]) / STEP_S) + 1) * STEP_S + time_s[0]
        depth, angle = (np.interp(steps, time_s, each) for each in (motion.depth_mm, motion.angle_rad))
        rates = (np.diff(each, prepend=each[0]) / STEP_S for each in (depth, angle))
        run = from_rates("extra", *rates, start_rad=float(angle[0]))
        return _record(path.another(spec, run))

    def again(self, spec: Spec) -> Record:
        return _record(path.another(spec, steering(spec.training[-1])))


def _record(trial: Trial) -> Record:
    (record,) = records(DataSet((trial,)))
    return record


def _mixed(number: int, names: list[Any]) -> tuple[Any, float, int]:
    """Return effect name and heterogeneity of data set `number`, and a counter that selects its trials."""
    levels, turn = divmod(number, len(names))
    name = names[turn]
    turn, level = divmod(levels, len(HETEROGENEITY))
    return name, HETEROGENEITY[level], turn + levels


def _log_uniform(seed: int, low: float, high: float) -> float:
    return float(np.exp(np.random.default_rng(seed).uniform(np.log(low), np.log(high))))


SOURCES = {
    SubjectName.FORCE: _Force(SUBJECTS[SubjectName.FORCE]),
    SubjectName.TIP: _Tip(SUBJECTS[SubjectName.TIP]),
}
