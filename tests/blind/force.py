"""The force channel: from a specification with its seed to recordings, and apart from them the truth."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.signal import lfilter

from tests.blind.base import ONSET_MM, Scene, Specimen, base_force_n, specimen, stacked
from tests.blind.contact import Contact, touch
from tests.blind.effect import Effect, ForceName
from tests.blind.identifiable import Colour, left
from tests.blind.motions import RICH, RICH_HELD_OUT, STEP_S, Array, MotionKind, Trajectory, trajectory
from tests.blind.outside import OUTSIDE
from tests.blind.recording import DataSet, Role, Trial
from tests.blind.resisting import (
    Bristle,
    Bumps,
    CuttingDepth,
    CuttingLayer,
    FreshCutting,
    FrictionLayer,
    PathDamage,
    Puncture,
    Relaxation,
    Respiration,
    Stribeck,
    TissueMotion,
    Viscous,
)  # fmt: skip
from tests.blind.sensing import Bias, Drift, Gain, Inertia, Latency, ThermalDrift
from tests.blind.sizes import scaled
from tests.blind.truth import HiddenEffect, Truth

NOISE_N = 0.03
NOISE_SHARE, NOISE_KEEP = 0.6, 0.8  # share of the variance that is AR(1), and its coefficient at 50 Hz
CUT_OFF_HZ = 30.0
QUANTUM_N = 0.002
ENCODER_MM = 0.005
COLOUR = Colour(NOISE_N, NOISE_SHARE, NOISE_KEEP)
EVERY = 2  # steps per recorded sample: 50 Hz
NOISE_SECONDS = 60.0

_INSIDE: tuple[type[Effect], ...] = (
    Puncture, FrictionLayer, CuttingLayer, FreshCutting, CuttingDepth, Stribeck, Bristle, TissueMotion, Viscous, Bias,
    Drift, ThermalDrift, Gain, Latency, Relaxation, Inertia, Respiration, PathDamage, Bumps,
)  # fmt: skip
FORCE_EFFECTS: dict[ForceName, type[Effect]] = {each.NAME: each for each in (*_INSIDE, *OUTSIDE)}
INSIDE = tuple(each.NAME for each in _INSIDE)


@dataclass(frozen=True)
class Wanted:
    """An effect and the RMS that it is to have in the training data, in units of the noise RMS."""

    name: ForceName
    noise_multiple: float


@dataclass(frozen=True)
class ForceSpec:
    """Everything that decides a data set."""

    seed: int
    effects: tuple[Wanted, ...] = ()
    heterogeneity: float = 0.0
    training: tuple[MotionKind, ...] = RICH
    held_out: tuple[MotionKind, ...] = RICH_HELD_OUT


@dataclass(frozen=True)
class _Trials:
    """R trials that are generated at one time."""

    trajectories: tuple[Trajectory, ...]
    tissue: Specimen


def generate(spec: ForceSpec) -> tuple[DataSet, Truth]:
    """Recordings and the truth about them; the same for the same specification."""
    effects, contributions = _sized(spec)
    kinds = spec.training + spec.held_out
    roles = [Role.TRAIN] * len(spec.training) + [Role.HOLDOUT] * len(spec.held_out)
    seeds = _seeds(spec, len(kinds))
    trials = _record(_trials(spec, seeds, [trajectory(each) for each in kinds]), effects, seeds, roles)
    truth = Truth(
        "force",
        spec.seed,
        spec.heterogeneity,
        NOISE_N,
        "N",
        tuple(_hidden(spec, each, added) for each, added in zip(effects, contributions, strict=True)),
    )
    return DataSet((*trials, noise_record(spec.seed))), truth


def another(spec: ForceSpec, motion: Trajectory, number: int = 0, role: Role = Role.TRAIN) -> Trial:
    """One more trial in the same tissue with the same hidden effects, of any motion; number tells repetitions apart."""
    effects, _ = _sized(spec)
    seeds = _seeds(spec, len(spec.training) + len(spec.held_out) + number + 1)[-1:]
    (trial,) = _record(_trials(spec, seeds, [motion]), effects, seeds, [role], f"extra_{number + 1}")
    return trial


def noise_record(seed: int, seconds: float = NOISE_SECONDS) -> Trial:
    """The sensor, set to zero, with the needle at rest in the air."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(2,)))
    still = trajectory(MotionKind.AIR, seconds)
    return _trial("noise", Role.NOISE, still, _noise(rng, len(still.depth_mm) // EVERY))


def _sized(spec: ForceSpec) -> tuple[tuple[Effect, ...], tuple[Array, ...]]:
    """The effects of a specification with their sizes found, and what each adds in N, the others being there."""
    if not spec.effects:
        return (), ()
    rng = np.random.default_rng(np.random.SeedSequence(spec.seed, spawn_key=(1,)))
    reach = max(trajectory(each).depth_mm.max() for each in spec.training)
    trials = _training(spec)
    without = _force_n(trials, ())
    found: list[Effect] = []
    for want in spec.effects:
        kind = FORCE_EFFECTS[want.name]
        effect = kind.drawn(rng, float(reach))
        sign = float(rng.choice([-1.0, 1.0])) if kind.SIGNED else 1.0

        def rms_n(size: float, effect: Effect = effect, sign: float = sign) -> float:
            return _rms(_force_n(trials, (effect.with_size(sign * size),)) - without)

        size = scaled(rms_n, want.noise_multiple * NOISE_N, kind.FIRST, kind.LARGEST, linear=kind.LINEAR)
        found.append(effect.with_size(sign * size))
    complete = _force_n(trials, tuple(found))
    if len(found) == 1:
        return tuple(found), (complete - without,)
    others = (tuple(found[:i] + found[i + 1 :]) for i in range(len(found)))
    return tuple(found), tuple(complete - _force_n(trials, each) for each in others)


def _hidden(spec: ForceSpec, effect: Effect, added: Array) -> HiddenEffect:
    rms = _rms(added)
    absorbed, rest = left(added[..., None], _calibrations(_training(spec))[:, :, None], COLOUR)
    largest = float(np.abs(added).max())
    return HiddenEffect(effect.NAME, effect.parameters(), rms, largest, rms / NOISE_N, absorbed, rest)


def _calibrations(trials: _Trials) -> Array:
    """What friction, cutting, onset and presliding length of the base do to the force, (samples, R, 4)."""
    tissue, compliance = trials.tissue, trials.tissue.compliance
    whole = _force_n(trials, ())
    cutting = _force_n(replace(trials, tissue=replace(tissue, friction_n_mm=0.0 * tissue.friction_n_mm)), ())
    depth = np.maximum(stacked(trials.trajectories)[0][::EVERY], 1e-9) / ONSET_MM
    longer = replace(compliance, bristle_mm=1.05 * compliance.bristle_mm)
    stretched = _force_n(replace(trials, tissue=replace(tissue, compliance=longer)), ()) - whole
    return np.stack([whole - cutting, cutting, cutting * depth / np.expm1(depth), stretched], axis=-1)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _seeds(spec: ForceSpec, count: int) -> list[np.random.SeedSequence]:
    return [np.random.SeedSequence(spec.seed, spawn_key=(0, i)) for i in range(count)]


def _training(spec: ForceSpec) -> _Trials:
    return _trials(spec, _seeds(spec, len(spec.training)), [trajectory(each) for each in spec.training])


def _trials(spec: ForceSpec, seeds: Sequence[np.random.SeedSequence], motions: Sequence[Trajectory]) -> _Trials:
    tissue = specimen([np.random.SeedSequence(each.entropy, spawn_key=(*each.spawn_key, 0)) for each in seeds],
                      spec.heterogeneity)  # fmt: skip
    return _Trials(tuple(motions), tissue)


def _force_n(trials: _Trials, effects: tuple[Effect, ...]) -> Array:
    """What an ideal sensor with the filter shows, (samples, R)."""
    depth, velocity, acceleration = stacked(trials.trajectories)
    time = trials.trajectories[0].time_s
    tip, compliance = depth, trials.tissue.compliance
    for each in effects:
        breath = each.tissue_mm(time)
        tip = tip if breath is None else tip - breath[:, None]
        compliance = each.compliance(compliance)
    tissue = replace(trials.tissue, compliance=compliance)
    scene = Scene(time, depth, velocity, acceleration, tip, _touch(tip, tissue), tissue)
    friction, cutting = base_force_n(scene)
    force = friction + cutting
    for each in effects:
        force = force + each.load_n(scene, friction, cutting)
    shown = force
    for each in effects:
        shown = shown + each.reading_n(scene, force)
    return _filtered(shown)[::EVERY]


def _filtered(shown: Array) -> Array:
    """The sensor's low-pass, exact where its input is linear between the steps."""
    lag = 1.0 / (2 * np.pi * CUT_OFF_HZ * STEP_S)  # in steps
    keep = np.exp(-1.0 / lag)
    now, before = 1.0 - lag * (1.0 - keep), lag * (1.0 - keep) - keep
    return lfilter([now, before], [1.0, -keep], shown, axis=0, zi=(1.0 - now) * shown[:1])[0]


_known: dict[bytes, Contact] = {}


def _touch(tip_mm: Array, tissue: Specimen) -> Contact:
    """The contact, kept for the next call: effects that do not touch it share it."""
    limits = tissue.compliance
    key = b"".join(part.tobytes() for part in (tip_mm, limits.bristle_mm, limits.give_mm, np.array(limits.lag_s)))
    if key not in _known:
        while len(_known) > 1:
            _known.pop(next(iter(_known)))
        _known[key] = touch(tip_mm, limits)
    return _known[key]


def _noise(rng: np.random.Generator, samples: int) -> Array:
    """AR(1) and white noise, stationary from the first sample; NOISE_N together."""
    slow = NOISE_N * np.sqrt(NOISE_SHARE)
    driven = slow * np.sqrt(1.0 - NOISE_KEEP**2) * rng.standard_normal(samples)
    driven[0] = slow * rng.standard_normal()
    coloured = lfilter([1.0], [1.0, -NOISE_KEEP], driven)
    return coloured + NOISE_N * np.sqrt(1.0 - NOISE_SHARE) * rng.standard_normal(samples)


def _record(
    trials: _Trials, effects: tuple[Effect, ...], seeds: Sequence[np.random.SeedSequence], roles: Sequence[Role],
    name: str = "",
) -> tuple[Trial, ...]:  # fmt: skip
    force = _force_n(trials, effects)
    recorded = []
    for r, (motion, seed, role) in enumerate(zip(trials.trajectories, seeds, roles, strict=True)):
        rng = np.random.default_rng(np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, 1)))
        noisy = force[:, r] + _noise(rng, len(force))
        recorded.append(_trial(name or f"trial_{r + 1}", role, motion, noisy))
    return tuple(recorded)


def _trial(name: str, role: Role, motion: Trajectory, force_n: Array) -> Trial:
    columns: dict[str, Any] = {
        "time_s": np.round(motion.time_s[::EVERY], 4),
        "depth_mm": ENCODER_MM * np.round(motion.depth_mm[::EVERY] / ENCODER_MM),
        "velocity_mm_s": motion.velocity_mm_s[::EVERY],
        "force_n": QUANTUM_N * np.round(force_n / QUANTUM_N),
        "phase": motion.phase[::EVERY],
    }
    return Trial(name, role, columns)
