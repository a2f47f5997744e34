"""Before anything is called missing, the base gets every chance: all of its parameters, in each trial by itself.

A trial is linearised about its own best parameters. Late readings belong to the base too: low-pass filters of sensors
are normal, so a lag of some milliseconds is a nuisance with a prior, and only one far beyond it is an effect.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from needleplan.diagnosis.channels import measurand_of
from needleplan.diagnosis.noise import Noise
from needleplan.diagnosis.space import Block
from needleplan.models import Channel, Model, Scale, recurrence, simulate
from needleplan.signals import Array, Motion, Record

__all__ = [
    "LAG",
    "Calibration",
    "Case",
    "calibrate",
    "fit_case",
    "lag_taps",
    "late",
    "measured_of",
    "pooled",
    "with_measured",
]

LAG = "lag_s"
"""Name of the lag among what is held."""

_STEPS = 10
_TRIES = 5
_LONGEST_STEP = 0.7
_RELATIVE = 1e-3
_DONE = 0.02
_EARLIEST_S, _LONGEST_LAG_S = -0.001, 0.2
_FORGOTTEN = 0.05
_ROUNDING = math.log(1e-14)
_BELIEF = 0.7
"""Standard deviation of a coordinate about that of the model as given: a factor of two, give or take."""


@dataclass(frozen=True)
class Case:
    """A trial that is diagnosed: what was measured, the base calibrated to it, and both whitened."""

    record: Record
    motion: Motion
    measured: Array
    model: Model
    lag_s: float
    output: Array
    """Of the calibrated base, with the effects that were held."""

    predicted: Array
    """What the sensor shows of it: with the lag."""

    block: Block
    rows: Array
    """Whitened samples that count: bool (samples - order,)."""

    noise: Noise
    lag_column: Array
    """Whitened: what is measured by one second of lag, zeros for what is known already."""

    def whiten(self, values: Array) -> Array:
        """Return what is new in forces, (samples, ...), once they are read; zeros for what is known already."""
        taps = lag_taps(self.motion, self.lag_s)
        read = values if taps is not None else late(values, self.motion, self.lag_s)
        count = int(self.rows.sum())
        found = np.empty((self.block.samples, *values.shape[1:]))
        if count == len(self.rows):
            self.noise.whiten_into(found[:count], read, taps)
        else:
            found[:count] = self.noise.whiten(read, taps)[self.rows]
        found[count:] = 0.0
        return found

    def samples(self) -> NDArray[np.intp]:
        """Return of which sample each whitened one that counts is, axis after axis."""
        each = len(self.motion) - self.noise.order
        return np.asarray(np.flatnonzero(self.rows) % each + self.noise.order)

    def spread(self, values: Array) -> Array:
        """Return columns (samples, m), once on each axis that is measured, (axes * samples, axes * m)."""
        return np.asarray(np.kron(np.eye(len(self.measured) // len(self.motion)), values), float)


@dataclass(frozen=True)
class Calibration:
    """The base, calibrated to every trial, and the noise."""

    noise: Noise
    training: tuple[Case, ...]
    held_out: tuple[Case, ...]
    free: tuple[str, ...]
    model: Model
    """With the mean of the parameters of the training trials."""

    given: Model


def calibrate(
    model: Model, training: Sequence[Record], held_out: Sequence[Record], noise: Noise, *, modes: bool = True
) -> Calibration:
    """Calibrate every free parameter of `model` to every trial by itself."""
    free = tuple(name for name, what in model.parameters().items() if what.free)
    cases = [fit_case(model, record, noise, free, modes=modes) for record in training]
    base = pooled([case.model for case in cases], free)
    others = [fit_case(base, record, noise, free, modes=modes, about=model) for record in held_out]
    return Calibration(noise, tuple(cases), tuple(others), free, base, model)


def measured_of(record: Record, channel: Channel) -> Array:
    """Return what was measured of a channel, its axes one after the other, shape (axes * samples,)."""
    return np.concatenate([record[name] for name in channel.columns])


def with_measured(record: Record, channel: Channel, values: Array) -> Record:
    """Return the record with other values of a channel, its axes one after the other."""
    axes = zip(channel.columns, np.split(values, len(channel.columns)), strict=True)
    return replace(record, columns={**record.columns, **dict(axes)})


def pooled(models: Sequence[Model], free: Sequence[str]) -> Model:
    """Return the model with the mean of the coordinates of each free parameter."""
    first = models[0]
    what = first.parameters()
    return first.with_values(**{
        name: what[name].value(float(np.mean([what[name].coordinate(getattr(each, name)) for each in models])))
        for name in free
    })  # fmt: skip


def fit_case(
    model: Model,
    record: Record,
    noise: Noise,
    free: Sequence[str],
    *,
    modes: bool = True,
    whole: Callable[[Model], Model] = lambda base: base,
    start_lag_s: float = 0.004,
    about: Model | None = None,
    hold: Collection[str] = (),
) -> Case:
    """Calibrate `model` to one trial (Levenberg and Marquardt, whitened) and linearise it there.

    Where the last step was too short to count, sensitivities are those before it.

    `whole` makes of the base the model with the effects that are held. Parameters are believed to be near those of
    `about`, by default `model`; those in `hold` stay as they are in `model`, and `LAG` as it starts.
    """
    measurand = measurand_of(model.channel)
    usual_lag_s = max(measurand.usual_lag_s, 1e-9)
    motion = record.motion()
    measured = measured_of(record, model.channel)
    rows = np.isfinite(noise.whiten(measured))
    what = model.parameters()
    coordinates = np.array([what[name].coordinate(getattr(model, name)) for name in free])
    low = np.array([
        what[name].coordinate(max(what[name].lower, 1e-300) if what[name].scale is Scale.LOG else what[name].lower)
        for name in free
    ])  # fmt: skip
    high = np.array([what[name].coordinate(what[name].upper) for name in free])
    given = about or model
    centre = np.append([what[name].coordinate(getattr(given, name)) for name in free], 0.0)
    belief = np.array([measurand.beliefs.get(name, _BELIEF) for name in free] + [usual_lag_s])

    def model_at(u: Array) -> Model:
        return model.with_values(**{
            name: min(max(what[name].value(each), what[name].lower), what[name].upper)
            for name, each in zip(free, u.tolist(), strict=True)
        })  # fmt: skip

    def output(u: Array) -> Array:
        return simulate(whole(model_at(u)), motion).output.ravel()

    def left(plain: Array, its_lag: float) -> Array:
        return noise.whiten(measured - late(plain, motion, its_lag))[rows]

    def off(u: Array, its_lag: float) -> Array:
        return np.asarray((np.append(u, its_lag) - centre) / belief)

    def cost(plain: Array, u: Array, its_lag: float) -> float:
        each, known = left(plain, its_lag), off(u, its_lag)
        return float(each @ each) + float(known @ known)

    lag = start_lag_s if measurand.usual_lag_s else 0.0
    plain = output(coordinates)
    least = cost(plain, coordinates, lag)
    moving = np.array(
        [name not in (*hold, *measurand.held) for name in free] + [measurand.usual_lag_s > 0 and LAG not in hold]
    )

    def at(wanted: NDArray[np.bool_]) -> Array:
        return _sensitivities(output, coordinates, plain, motion, lag, noise, rows, wanted)

    damping = 1e-4
    for _ in range(_STEPS):
        sensitivities = at(moving)
        normal = sensitivities.T @ sensitivities + np.diag(belief**-2)
        target = np.where(moving, sensitivities.T @ left(plain, lag) - off(coordinates, lag) / belief, 0.0)
        normal = np.where(np.outer(moving, moving), normal, np.diag(np.diag(normal)))
        promised, found = 0.0, False  # whether there is more to be found
        for _ in range(_TRIES):
            move = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), target)
            move *= min(1.0, _LONGEST_STEP / max(float(np.abs(move[:-1]).max(initial=0.0)), 1e-12))
            promised = float(move @ target)
            trial = np.clip(coordinates + move[:-1], low, high)
            its_lag = float(np.clip(lag + move[-1], _EARLIEST_S, _LONGEST_LAG_S))
            there = output(trial)
            its_cost = cost(there, trial, its_lag)
            if its_cost < least:
                found = least - its_cost > _DONE
                coordinates, lag, plain, least = trial, its_lag, there, its_cost
                damping = max(damping / 10, 1e-6)
                break
            if promised < _DONE:
                break
            damping = max(damping * 20, 1e-2)
        if not found or promised < _DONE:
            break
    else:
        sensitivities = at(moving)
    if not moving.all():
        sensitivities += at(~moving)
    predicted, residual = late(plain, motion, lag), left(plain, lag)
    best = model_at(coordinates)
    vectors, variances = (
        _modes(measurand.modes(best, motion), motion, lag, noise, rows)
        if modes
        else (np.zeros((len(residual), 0)), np.zeros(0))
    )
    jitter = noise.whiten(measurand.moments(predicted, motion))[rows]
    # What is believed of parameters, of the lag and of the moments of turning are more measurements.
    q, k = sensitivities.shape[1], jitter.shape[1]
    more = q + k
    sensitivities = np.block(
        [[sensitivities, jitter], [np.diag(1 / belief), np.zeros((q, k))], [np.zeros((k, q)), np.eye(k)]]
    )
    lag_column = np.concatenate([sensitivities[: len(residual), q - 1], np.zeros(more)])
    block = Block(
        np.concatenate([residual, -off(coordinates, lag), np.zeros(k)]),
        sensitivities / np.maximum(np.linalg.norm(sensitivities, axis=0), 1e-12),
        np.zeros((len(residual) + more, 0)),
        np.vstack([vectors, np.zeros((more, vectors.shape[1]))]),
        variances,
        measurand.usual_level,
        measurand.independent(motion),
    )
    return Case(record, motion, measured, best, lag, plain, predicted, block, rows, noise, lag_column)


def late(force: Array, motion: Motion, lag_s: float) -> Array:
    """Return a force as a sensor with a lag of first order shows it, shape (samples,) or (samples, n).

    Several axes that follow one another, (axes * samples, ...), are late alike.
    """
    if len(force) > len(motion):
        axes = np.moveaxis(force.reshape(-1, len(motion), *force.shape[1:]), 0, -1)
        return np.moveaxis(late(axes, motion, lag_s), -1, 0).reshape(force.shape)
    h = motion.interval_s.reshape((-1,) + (1,) * (force.ndim - 1))
    rise = np.diff(force, axis=0) / h
    found: Array = np.array(force, float)
    if lag_s <= 0:  # early instead: what a lag that is small goes over into
        found[1:] -= lag_s * rise
        return found
    decay = np.exp(-h / lag_s)
    behind = -lag_s * rise * (1 - decay)
    if float(decay.max()) >= _FORGOTTEN:
        return force + recurrence(decay.ravel(), behind, np.zeros(force.shape[1:]))
    found[1:] += behind
    found[2:] += decay[1:] * behind[:-1]
    return found


def lag_taps(motion: Motion, lag_s: float) -> Array | None:
    """Return `late` as weights of the present and the past; None where the sampling is uneven."""
    h = motion.interval_s
    step = float(np.median(h))
    if lag_s == 0:
        return np.ones(1)
    decay = math.exp(-step / lag_s) if lag_s > 0 else 0.0
    if float(np.abs(h - step).max()) > 1e-3 * step:
        return None
    count = 3 if decay <= _FORGOTTEN else math.ceil(_ROUNDING / math.log(decay))
    rise = lag_s / step * (1 - decay) * decay ** np.arange(count)
    taps: Array = np.append(-rise, 0.0) + np.append(0.0, rise)
    taps[0] += 1
    return taps


def _sensitivities(
    output: Callable[[Array], Array], coordinates: Array, plain: Array, motion: Motion, lag: float, noise: Noise,
    rows: Array, wanted: NDArray[np.bool_],
) -> Array:  # fmt: skip
    """Return how what is measured depends on coordinates and on the lag, whitened; 0 for those that are not wanted."""
    chosen = np.flatnonzero(wanted)
    raw = np.empty((len(plain), chosen.size))
    count = int((chosen < coordinates.size).sum())
    for column, index in enumerate(chosen[:count]):
        moved = coordinates.copy()
        moved[index] += _RELATIVE
        raw[:, column] = output(moved) - plain
    if count:
        raw[:, :count] = late(raw[:, :count] / _RELATIVE, motion, lag)
    if count < chosen.size:
        step = 1e-4
        raw[:, count] = (late(plain, motion, lag + step) - late(plain, motion, lag)) / step
    whitened = noise.whiten(raw)
    found: Array = np.zeros((int(rows.sum()), wanted.size))
    found[:, chosen] = whitened if rows.all() else whitened[rows]
    return found


def _modes(raw: Array, motion: Motion, lag: float, noise: Noise, rows: Array) -> tuple[Array, Array]:
    whitened = noise.whiten(late(raw, motion, lag))
    if not rows.all():
        whitened = whitened[rows]
    gram = whitened.T @ whitened
    values, vectors = np.linalg.eigh(gram)
    keep = values > 1e-6 * values[-1]
    return whitened @ (vectors[:, keep] / np.sqrt(values[keep])), values[keep]
