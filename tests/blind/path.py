"""The tip-path channel: from a specification with its seed to recordings, and apart from them the truth."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.signal import lfilter

from tests.blind import bending
from tests.blind.curve import Medium, Steered, integrated, medium, wanted_curvature
from tests.blind.force import ENCODER_MM
from tests.blind.identifiable import Colour, left
from tests.blind.motions import Array
from tests.blind.path_effect import PathEffect, PathName, side
from tests.blind.path_outside import OUTSIDE_PATH
from tests.blind.recording import DataSet, Role, Trial
from tests.blind.sizes import scaled
from tests.blind.steering import TWO_SPEED, TWO_SPEED_HELD_OUT, Steering, SteeringKind, steering
from tests.blind.tracking import CoilOffset, TrackerBias, TrackerDistortion
from tests.blind.truth import HiddenEffect, Truth

SIGMA_MM = 0.1  # per axis
SLOW_SHARE, SLOW_KEEP = 0.2, 0.9  # share of the variance that is AR(1), and its coefficient at 40 Hz
COLOUR = Colour(SIGMA_MM, SLOW_SHARE, SLOW_KEEP)
EVERY = 2
NOISE_SECONDS = 30.0

_INSIDE: tuple[type[PathEffect], ...] = (
    bending.CurvatureLayer, bending.CurvatureSpeed, bending.TorsionalLag, bending.PreBend, bending.EntryRupture,
    bending.Misalignment, CoilOffset, TrackerBias, TrackerDistortion, bending.TissueDrift, bending.PathRespiration,
    bending.Gravity,
)  # fmt: skip
PATH_EFFECTS: dict[PathName, type[PathEffect]] = {each.NAME: each for each in (*_INSIDE, *OUTSIDE_PATH)}
INSIDE_PATH = tuple(each.NAME for each in _INSIDE)


@dataclass(frozen=True)
class Moves:
    """An effect and how far it is to move the tip, at most, in the training data: in tracker sigma of one axis."""

    name: PathName
    sigmas: float


@dataclass(frozen=True)
class PathSpec:
    """Everything that decides a data set."""

    seed: int
    effects: tuple[Moves, ...] = ()
    heterogeneity: float = 0.0
    training: tuple[SteeringKind, ...] = TWO_SPEED
    held_out: tuple[SteeringKind, ...] = TWO_SPEED_HELD_OUT


@dataclass(frozen=True)
class _Trials:
    """R trials that are generated at one time."""

    motions: tuple[Steering, ...]
    tissue: Medium


def generate(spec: PathSpec) -> tuple[DataSet, Truth]:
    """Recordings and the truth about them; the same for the same specification."""
    effects, added = _sized(spec)
    kinds = spec.training + spec.held_out
    roles = [Role.TRAIN] * len(spec.training) + [Role.HOLDOUT] * len(spec.held_out)
    seeds = _seeds(spec, len(kinds))
    trials = _record(_trials(spec, seeds, [steering(each) for each in kinds]), effects, seeds, roles)
    hidden = []
    for each, shift in zip(effects, added, strict=True):
        rms = float(np.sqrt(np.mean(np.sum(shift**2, axis=2))))
        absorbed, rest = left(shift, _calibrations(spec), COLOUR)
        hidden.append(HiddenEffect(each.NAME, each.parameters(), rms, _largest(shift), rms / SIGMA_MM, absorbed, rest))
    truth = Truth("path", spec.seed, spec.heterogeneity, SIGMA_MM, "mm", tuple(hidden))
    return DataSet((*trials, noise_record(spec.seed))), truth


def another(spec: PathSpec, motion: Steering, number: int = 0, role: Role = Role.TRAIN) -> Trial:
    """One more trial in the same tissue with the same hidden effects, of any motion; number tells repetitions apart."""
    effects, _ = _sized(spec)
    seeds = _seeds(spec, len(spec.training) + len(spec.held_out) + number + 1)[-1:]
    (trial,) = _record(_trials(spec, seeds, [motion]), effects, seeds, [role], f"extra_{number + 1}")
    return trial


def noise_record(seed: int, seconds: float = NOISE_SECONDS) -> Trial:
    """The tracker with the tip at rest in its origin."""
    still = steering(SteeringKind.STILL, seconds)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(2,)))
    return _trial("noise", Role.NOISE, still, _noise(rng, len(still.depth_mm) // EVERY))


def _sized(spec: PathSpec) -> tuple[tuple[PathEffect, ...], tuple[Array, ...]]:
    """The effects of a specification with their sizes found, and what each adds in mm, the others being there."""
    if not spec.effects:
        return (), ()
    rng = np.random.default_rng(np.random.SeedSequence(spec.seed, spawn_key=(1,)))
    motions = [steering(each) for each in spec.training]
    reach = max(float(each.depth_mm.max()) for each in motions)
    trials = _trials(spec, _seeds(spec, len(motions)), motions)
    without = _shown_mm(trials, ())
    found: list[PathEffect] = []
    for want in spec.effects:
        kind = PATH_EFFECTS[want.name]
        effect = kind.drawn(rng, reach)
        sign = float(rng.choice([-1.0, 1.0])) if kind.SIGNED else 1.0

        def moved_mm(size: float, effect: PathEffect = effect, sign: float = sign) -> float:
            return _largest(_shown_mm(trials, (effect.with_size(sign * size),)) - without)

        size = scaled(moved_mm, want.sigmas * SIGMA_MM, kind.FIRST, kind.LARGEST, linear=kind.LINEAR)
        found.append(effect.with_size(sign * size))
    complete = _shown_mm(trials, tuple(found))
    if len(found) == 1:
        return tuple(found), (complete - without,)
    added = tuple(complete - _shown_mm(trials, tuple(found[:i] + found[i + 1 :])) for i in range(len(found)))
    return tuple(found), added


def _calibrations(spec: PathSpec) -> Array:
    """What the curvature of the base does to the path, (samples, R, 3, 1)."""
    motions = [steering(each) for each in spec.training]
    trials = _trials(spec, _seeds(spec, len(motions)), motions)
    more = replace(trials.tissue, along=1.01 * trials.tissue.along)
    return (_shown_mm(replace(trials, tissue=more), ()) - _shown_mm(trials, ()))[..., None]


def _largest(shift_mm: Array) -> float:
    return float(np.sqrt(np.sum(shift_mm**2, axis=-1)).max())


def _seeds(spec: PathSpec, count: int) -> list[np.random.SeedSequence]:
    return [np.random.SeedSequence(spec.seed, spawn_key=(0, i)) for i in range(count)]


def _trials(spec: PathSpec, seeds: Sequence[np.random.SeedSequence], motions: Sequence[Steering]) -> _Trials:
    tissue = medium([np.random.SeedSequence(each.entropy, spawn_key=(*each.spawn_key, 0)) for each in seeds],
                    spec.heterogeneity)  # fmt: skip
    return _Trials(tuple(motions), tissue)


def _shown_mm(trials: _Trials, effects: tuple[PathEffect, ...]) -> Array:
    """What a tracker without noise shows (samples, R, 3)."""
    columns = ("depth_mm", "velocity_mm_s", "angle_rad")
    depth, velocity, base = (np.stack([getattr(each, name) for each in trials.motions], axis=1) for name in columns)
    tip = base
    for each in effects:
        tip = each.tip_rad(tip, depth)
    steered = Steered(trials.motions[0].time_s, depth, velocity, base, tip)
    toward, across = wanted_curvature(steered, trials.tissue)
    bevel = toward
    for each in effects:
        bevel = bevel + each.bevel_1_mm(steered, toward)
    bend = bevel[..., None] * side(tip)[..., 1:] + across[..., None] * side(tip + np.pi / 2)[..., 1:]
    tilt = np.zeros(2)
    for each in effects:
        bend = bend + each.bend_1_mm(steered)
        tilt = tilt + each.tilt_rad()
    course = integrated(depth, bend, tilt)
    shown = course.position_mm
    for each in effects:
        shown = shown + each.shift_mm(steered, course)
    return shown[::EVERY]


def _noise(rng: np.random.Generator, samples: int) -> Array:
    """Of the three axes (samples, 3): white and AR(1), stationary from the first sample; SIGMA_MM together."""
    slow = SIGMA_MM * np.sqrt(SLOW_SHARE)
    driven = slow * np.sqrt(1.0 - SLOW_KEEP**2) * rng.standard_normal((samples, 3))
    driven[0] = slow * rng.standard_normal(3)
    white = SIGMA_MM * np.sqrt(1.0 - SLOW_SHARE) * rng.standard_normal((samples, 3))
    return lfilter([1.0], [1.0, -SLOW_KEEP], driven, axis=0) + white


def _record(
    trials: _Trials, effects: tuple[PathEffect, ...], seeds: Sequence[np.random.SeedSequence], roles: Sequence[Role],
    name: str = "",
) -> tuple[Trial, ...]:  # fmt: skip
    shown = _shown_mm(trials, effects)
    recorded = []
    for r, (motion, seed, role) in enumerate(zip(trials.motions, seeds, roles, strict=True)):
        rng = np.random.default_rng(np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, 1)))
        noisy = shown[:, r] + _noise(rng, len(shown))
        recorded.append(_trial(name or f"trial_{r + 1}", role, motion, noisy))
    return tuple(recorded)


def _trial(name: str, role: Role, motion: Steering, tip_mm: Array) -> Trial:
    columns: dict[str, Any] = {
        "time_s": np.round(motion.time_s[::EVERY], 4),
        "depth_mm": ENCODER_MM * np.round(motion.depth_mm[::EVERY] / ENCODER_MM),
        "velocity_mm_s": motion.velocity_mm_s[::EVERY],
        "angle_rad": motion.angle_rad[::EVERY],
        "x_mm": tip_mm[:, 0],
        "y_mm": tip_mm[:, 1],
        "z_mm": tip_mm[:, 2],
        "phase": motion.phase[::EVERY],
    }
    return Trial(name, role, columns)
