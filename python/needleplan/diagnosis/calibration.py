"""Calibration: before effects are considered, all parameters of the base model are fitted to each trial.

Each trial is linearised at its own best parameters. The sensor lag is calibrated too: many sensors have a low-pass
filter of some milliseconds, so the lag is a nuisance parameter with a prior. Only a far longer lag counts as an effect.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from needleplan.artifacts import ShortRepr
from needleplan.diagnosis._blocks import HETEROGENEITY_SDS, TISSUE_KINDS, Block
from needleplan.diagnosis._constants import (
    CALIBRATION_STEPS,
    COORDINATE_STEP,
    DAMPING_TRIES,
    EARLIEST_S,
    HIDDEN_MODES,
    LEAST_DROP,
    LONGEST_LAG_S,
    LONGEST_STEP,
    MOVED,
    NEAR,
    NEAR_S,
    PRIOR_SD,
)
from needleplan.diagnosis.catalogue import FittedEffect, base_of, with_effects
from needleplan.diagnosis.channels import channel_description
from needleplan.diagnosis.data import measured_output
from needleplan.models import Model, simulate
from needleplan.signals import Array, Motion, Record, Role, SensorNoise, lag_taps, lagged

__all__ = [ "CalibratedTrial", "Calibration",
    "calibrate", "calibrate_trial", "calibration_remarks", "mean_model", "noise_sds",
]  # fmt: skip


@dataclass(frozen=True)
class CalibratedTrial(ShortRepr):
    """A trial with the base model calibrated to it: measured and predicted output, and the whitened residual."""

    record: Record
    motion: Motion
    measured: Array
    model: Model
    lag_s: float
    output: Array
    """Output of the calibrated base model with the fixed effects, before the sensor lag, shape (axes * samples,)."""

    predicted: Array
    """`output` after the sensor lag, shape (axes * samples,)."""

    whitened: Block
    rows: Array
    """Whether each whitened sample is valid (not NaN), shape (axes * (samples - order),)."""

    noise: SensorNoise
    lag_sensitivity: Array
    """Derivative of the whitened reading with respect to the lag (1/s), shape (n,); zero in the rows of priors."""

    centre: Array
    """Fit coordinates and lag (s) at which the sensitivities were computed, shape (q,)."""

    laws: Array | None = None
    """Coefficients of other laws of the base that its sensitivities contain; None before the first step of a fit."""

    shared: Array | None = None
    """Whitened columns that all trials share beside the effects, computed with the sensitivities; None before."""

    def _distance(self, coordinates: Array) -> float:
        """Return the distance from the point of the sensitivities, in units of that up to which they hold."""
        reach = np.append(np.full(len(coordinates) - 1, NEAR), NEAR_S)
        return float((np.abs(coordinates - self.centre) / reach).max())

    def has_moved(self, calibration: Calibration) -> bool:
        """Return whether the base parameters or the lag have moved so far that the sensitivities must be renewed."""
        return self._distance(_coordinates(self.model, self.lag_s, calibration.free)[0]) > MOVED

    def moved(
        self, model: Model, lag_s: float, calibration: Calibration, whole: Callable[[Model], Model]
    ) -> CalibratedTrial | None:
        """Return the trial at another base model and lag, with unchanged sensitivities; None if too far away.

        `whole` adds the effects to the base model.
        """
        coordinates, prior_sd = _coordinates(model, lag_s, calibration.free)
        if self._distance(coordinates) > 1:
            return None
        plain = simulate(whole(model), self.motion).output.ravel()
        predicted = lagged(plain, self.motion, lag_s)
        residual = self.noise.whiten(self.measured - predicted)[self.rows]
        centre, _ = _coordinates(calibration.given, 0.0, calibration.free)
        whitened = replace(self.whitened, residual=np.append(residual, -(coordinates - centre) / prior_sd))
        return replace(self, model=model, lag_s=lag_s, output=plain, predicted=predicted, whitened=whitened)

    @cached_property
    def tissue(self) -> tuple[Array, ...]:
        """Whitened output change by each heterogeneity mode of standard deviation 1, (n, modes), by kind of tissue.

        Modes that are next to invisible together, even in the most heterogeneous tissue, are left out.
        """
        found, largest = [], float(HETEROGENEITY_SDS.max())
        for raw in channel_description(self.model.channel).modes(self.model, self.motion):
            whitened = self.whiten(raw)
            energies = largest**2 * np.einsum("nm,nm->m", whitened, whitened)
            order = np.argsort(energies)
            hidden = order[np.cumsum(energies[order]) < HIDDEN_MODES]
            found.append(np.delete(whitened, hidden, axis=1))
        return tuple(found)

    @property
    def is_reference(self) -> bool:
        """Whether the trial is a reference: a recording without the missing effects."""
        return self.record.role is Role.REFERENCE

    @property
    def readings(self) -> int:
        """Number of valid whitened samples; the rows of priors follow them."""
        return len(self.whitened.residual) - int(self.whitened.base.shape[1])

    def whiten(self, values: Array) -> Array:
        """Return changes of the output after sensor lag and whitening, shape (n, ...); zero in the rows of priors.

        `values` are the changes before the sensor lag, shape (axes * samples, ...).
        """
        taps = lag_taps(self.motion, self.lag_s)
        read = values if taps is not None else lagged(values, self.motion, self.lag_s)
        whitened = np.empty((len(self.whitened.residual), *values.shape[1:]))
        if self.readings == len(self.rows):
            self.noise.whiten_into(whitened[: self.readings], read, taps)
        else:
            whitened[: self.readings] = self.noise.whiten(read, taps)[self.rows]
        whitened[self.readings :] = 0.0
        return whitened

    def samples(self) -> NDArray[np.intp]:
        """Return the sample index of each valid whitened row, axis after axis."""
        rows_per_axis = len(self.motion) - self.noise.order
        return np.asarray(np.flatnonzero(self.rows) % rows_per_axis + self.noise.order)

    def on_each_axis(self, values: Array) -> Array:
        """Repeat columns (samples, ..., m) once per axis, as a block diagonal (axes * samples, ..., axes * m)."""
        axes = len(self.measured) // len(self.motion)
        return np.asarray(np.kron(np.eye(axes).reshape(axes, *(1,) * (values.ndim - 2), axes), values), float)


@dataclass(frozen=True)
class Calibration(ShortRepr):
    """The sensor noise, and the base model calibrated to each trial."""

    noise: SensorNoise
    training: tuple[CalibratedTrial, ...]
    held_out: tuple[CalibratedTrial, ...]
    references: tuple[CalibratedTrial, ...]
    free: tuple[str, ...]
    model: Model
    """Base model with the mean parameters of the training trials."""

    given: Model
    """Base model before the calibration, without effects."""

    effects: tuple[FittedEffect, ...] = ()
    """Effects of the given model, in every hypothesis."""

    @property
    def trials(self) -> tuple[CalibratedTrial, ...]:
        """Training, held-out and reference trials, in this order."""
        return *self.training, *self.held_out, *self.references


def calibrate(
    model: Model,
    training: Sequence[Record],
    held_out: Sequence[Record],
    noise: SensorNoise,
    references: Sequence[Record] = (),
) -> Calibration:
    """Calibrate all free parameters of `model` to each trial separately; its effects keep their values.

    The held-out trials start from the mean model of the training trials, and the references from `model`.
    """
    base, effects = base_of(model)
    free = tuple(name for name, parameter in base.parameters().items() if parameter.free)
    whole = partial(with_effects, effects=effects)

    def calibrated(start: Model, records: Sequence[Record]) -> tuple[CalibratedTrial, ...]:
        return tuple(calibrate_trial(start, record, noise, free, whole=whole, about=base) for record in records)

    trials = calibrated(base, training)
    mean = mean_model([trial.model for trial in trials], free)
    return Calibration(
        noise, trials, calibrated(mean, held_out), calibrated(base, references), free, mean, base, effects
    )


def noise_sds(trial: CalibratedTrial, free: Sequence[str]) -> Array:
    """Return the standard deviations of the fit coordinates of the parameters of a trial, by noise and priors."""
    priors = channel_description(trial.model.channel).priors
    base = trial.whitened.base
    # The rows of priors hold 1 / (prior sd * norm) of each sensitivity.
    units = np.diag(base[trial.readings :])[: len(free)] * [priors.get(name, PRIOR_SD) for name in free]
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(base.T @ base)))[: len(free)] * units)


def mean_model(models: Sequence[Model], free: Sequence[str]) -> Model:
    """Return the first of `models` with its `free` parameters replaced by the mean over all models.

    The mean is taken in fit coordinates.
    """
    first = models[0]
    parameters = first.parameters()
    return first.with_values(**{
        name: parameters[name].value(float(np.mean([parameters[name].coordinate(getattr(m, name)) for m in models])))
        for name in free
    })  # fmt: skip


def calibrate_trial(
    model: Model,
    record: Record,
    noise: SensorNoise,
    free: Sequence[str],
    *,
    whole: Callable[[Model], Model] = lambda base: base,
    start_lag_s: float = 0.004,
    about: Model | None = None,
    fixed: bool = False,
    beside: Callable[[Model], Array] | None = None,
) -> CalibratedTrial:
    """Calibrate `model` to one trial (Levenberg-Marquardt on whitened residuals) and linearise it at the result.

    `whole` adds fixed effects to the base model. The prior of the parameters is centred at `about`, by default `model`.
    The channel's `linear_parameters` keep their value in `model`. The lag starts at `start_lag_s`; for a channel
    without lag it is 0. If `fixed`, all parameters and the lag stay at their start.
    If the last step was negligible, the sensitivities are not renewed after it. `beside` returns a further output that
    depends on the parameters, such as the deviation of a law: the derivatives include it, and the residual does not.
    """
    description = channel_description(model.channel)
    motion = record.motion()
    measured = measured_output(record, model.channel)
    rows = np.isfinite(noise.whiten(measured))
    parameters = model.parameters()
    coordinates = _coordinates(model, 0.0, free)[0][:-1]
    low = np.array([parameters[name].coordinate(parameters[name].lower) for name in free])
    high = np.array([parameters[name].coordinate(parameters[name].upper) for name in free])
    centre, prior_sd = _coordinates(about or model, 0.0, free)

    def model_at(u: Array) -> Model:
        return model.with_values(**{
            name: min(max(parameters[name].value(coordinate), parameters[name].lower), parameters[name].upper)
            for name, coordinate in zip(free, u.tolist(), strict=True)
        })  # fmt: skip

    def output(u: Array) -> Array:
        return simulate(whole(model_at(u)), motion).output.ravel()

    def whitened_residual(plain: Array, its_lag: float) -> Array:
        return noise.whiten(measured - lagged(plain, motion, its_lag))[rows]

    def prior_deviation(u: Array, its_lag: float) -> Array:
        return np.asarray((np.append(u, its_lag) - centre) / prior_sd)

    def cost(plain: Array, u: Array, its_lag: float) -> float:
        residual, deviation = whitened_residual(plain, its_lag), prior_deviation(u, its_lag)
        return float(residual @ residual) + float(deviation @ deviation)

    lag = start_lag_s if description.usual_lag_s else 0.0
    plain = output(coordinates)
    least = cost(plain, coordinates, lag)
    moving = np.array([name not in description.linear_parameters for name in free] + [description.usual_lag_s > 0])
    moving &= not fixed

    def whole_output(u: Array) -> Array:
        return output(u) if beside is None else output(u) + beside(model_at(u))

    def at(wanted: NDArray[np.bool_]) -> Array:
        present = plain if beside is None or not wanted.any() else plain + beside(model_at(coordinates))
        return _sensitivities(whole_output, coordinates, present, motion, lag, noise, rows, wanted)

    damping = 1e-4
    for _ in range(CALIBRATION_STEPS if moving.any() else 0):
        sensitivities = at(moving)
        normal = sensitivities.T @ sensitivities + np.diag(prior_sd**-2)
        target = np.where(
            moving, sensitivities.T @ whitened_residual(plain, lag) - prior_deviation(coordinates, lag) / prior_sd, 0.0
        )
        normal = np.where(np.outer(moving, moving), normal, np.diag(np.diag(normal)))
        expected_drop, has_improved = 0.0, False
        for _ in range(DAMPING_TRIES):
            move = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), target)
            move *= min(1.0, LONGEST_STEP / max(float(np.abs(move[:-1]).max(initial=0.0)), 1e-12))
            expected_drop = float(move @ target)
            trial = np.clip(coordinates + move[:-1], low, high)
            its_lag = float(np.clip(lag + move[-1], EARLIEST_S, LONGEST_LAG_S))
            there = output(trial)
            its_cost = cost(there, trial, its_lag)
            if its_cost < least:
                has_improved = least - its_cost > LEAST_DROP
                coordinates, lag, plain, least = trial, its_lag, there, its_cost
                damping = max(damping / 10, 1e-6)
                break
            if expected_drop < LEAST_DROP:
                break
            damping = max(damping * 20, 1e-2)
        if not has_improved or expected_drop < LEAST_DROP:
            break
    else:
        sensitivities = at(moving)
    if not moving.all():
        sensitivities += at(~moving)
    predicted, residual = lagged(plain, motion, lag), whitened_residual(plain, lag)
    best = model_at(coordinates)
    # Priors of parameters and lag enter as additional measurements.
    q = sensitivities.shape[1]
    lag_sensitivity = np.append(sensitivities[:, q - 1], np.zeros(q))
    sensitivities = np.vstack([sensitivities, np.diag(1 / prior_sd)])
    whitened = Block(
        np.append(residual, -prior_deviation(coordinates, lag)),
        sensitivities / np.maximum(np.linalg.norm(sensitivities, axis=0), 1e-12),
        np.zeros((len(residual) + q, 0)),
        np.zeros((TISSUE_KINDS.max() + 1, 0)),
    )
    return CalibratedTrial(
        record, motion, measured, best, lag, plain, predicted, whitened, rows, noise, lag_sensitivity,
        np.append(coordinates, lag),
    )  # fmt: skip


def _coordinates(model: Model, lag_s: float, free: Sequence[str]) -> tuple[Array, Array]:
    """Return fit coordinates and lag (s), and their prior standard deviations, shape (q,) each."""
    description, parameters = channel_description(model.channel), model.parameters()
    sds = [description.priors.get(name, PRIOR_SD) for name in free] + [max(description.usual_lag_s, 1e-9)]
    return np.append([parameters[name].coordinate(getattr(model, name)) for name in free], lag_s), np.array(sds)


def _sensitivities(
    output: Callable[[Array], Array], coordinates: Array, plain: Array, motion: Motion, lag: float, noise: SensorNoise,
    rows: Array, wanted: NDArray[np.bool_],
) -> Array:  # fmt: skip
    """Return the whitened derivatives of the reading with respect to the coordinates and the lag, shape (n, q).

    Columns that are not `wanted` are zero.
    """
    chosen = np.flatnonzero(wanted)
    raw = np.empty((len(plain), chosen.size))
    count = int((chosen < coordinates.size).sum())
    for column, index in enumerate(chosen[:count]):
        moved = coordinates.copy()
        moved[index] += COORDINATE_STEP
        raw[:, column] = output(moved) - plain
    if count:
        raw[:, :count] = lagged(raw[:, :count] / COORDINATE_STEP, motion, lag)
    if count < chosen.size:
        step = 1e-4
        raw[:, count] = (lagged(plain, motion, lag + step) - lagged(plain, motion, lag)) / step
    whitened = noise.whiten(raw)
    sensitivities: Array = np.zeros((int(rows.sum()), wanted.size))
    sensitivities[:, chosen] = whitened if rows.all() else whitened[rows]
    return sensitivities


def calibration_remarks(calibration: Calibration) -> list[str]:
    """Return remarks on the calibrated base model for the user of the diagnosis.

    Reported are parameters at a bound of the range or a factor of 5 off the given value, and a lag over 30 ms.
    """
    model, notes = calibration.given, []
    for name in calibration.free:
        parameter, given, now = model.parameters()[name], getattr(model, name), getattr(calibration.model, name)
        if now in (parameter.lower, parameter.upper) or (given * now > 0 and not 0.2 < now / given < 5):
            notes.append(
                f"{name} is {now:.3g} {parameter.unit} in these recordings, and {given:.3g} in the model: another "
                "needle or tissue, or wrong units?"
            )
    lags = [trial.lag_s for trial in calibration.training]
    if max(lags) > 0.03:
        notes.append(f"the readings lag by {max(lags) * 1e3:.0f} ms: are the clocks of sensor and robot synchronised?")
    return notes
