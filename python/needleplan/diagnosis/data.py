"""Input of a diagnosis: checked recordings, and the noise of the sensor as an autoregression.

    y[k] = sum_j weights[j] y[k - 1 - j] + sd e[k],        e white with variance 1

The order minimises the BIC for the noise records of one axis, and the AIC for those of several axes. An autoregression
of that order also approximates the filter and the quantisation of a sensor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import lru_cache

import numpy as np
from numpy.lib.stride_tricks import as_strided

from needleplan.errors import DataError, Mistake
from needleplan.models import Channel, Model
from needleplan.signals import UNITS, Array, Record, Role, rest_before_entry

__all__ = [
    "FEWEST_VALUES", "CheckedData", "Lack", "MultiAxisNoise", "SensorNoise", "check_data", "combine_axes", "fit_axes",
    "fit_noise", "measured_output", "scatter", "sensor_noise", "with_measured",
]  # fmt: skip

FEWEST_VALUES = 200
"""Least number of values in a trial, summed over all axes."""

# Least total duration (s) of noise records.
_NOISE_RECORD_S = 5.0
# Largest permitted relative difference between the sampling intervals of two recordings.
_RATE_TOLERANCE = 0.03
# RMS depth difference (mm) below which two trials have the same motion.
_SAME_MOTION_MM = 0.5
# Largest permitted sampling interval, as a multiple of the median interval.
_GAP_FACTOR = 5.0
# Depth (mm) that a trial must reach at least.
_SHALLOWEST_MM = 3.0
# Largest permitted movement (mm) of the needle in a noise record.
_REST_TOLERANCE_MM = 1.0
# Least number of samples of a part of a trial, before the entry, from which the noise is estimated.
_FEWEST_REST = 100
# Ratio between the scatter of trials and noise record, or its inverse, from which the record is not used.
_NOISE_RATIO = 5.0
# Relative deviation from the median interval above which a sampling interval counts as uneven.
_INTERVAL_TOLERANCE = 0.5
# Largest permitted share of uneven sampling intervals.
_UNEVEN_SHARE = 0.1
# Highest order of an autoregression of one axis.
_HIGHEST_ORDER = 12
# Highest order of an autoregression that several axes share.
_HIGHEST_SHARED_ORDER = 24
# Number of samples filtered at once: larger blocks multiply more zeros, smaller blocks need more products.
_FILTER_BLOCK = 16


class Lack(StrEnum):
    """Data without which no effect is named."""

    NOISE = "noise record"
    HELD_OUT = "held-out trial"
    OTHER_MOTION = "held-out trial of another motion"
    TRIALS = "second training trial"
    NEEDLE = "recording of the needle of the model"


@dataclass(frozen=True)
class CheckedData:
    """Usable recordings by role, with remarks. `lacks` maps each kind of missing data to the reason why it matters.

    Without a noise record, `rest` holds the parts of training trials in which the needle stands before the entry.
    """

    training: tuple[Record, ...]
    held_out: tuple[Record, ...]
    noise: tuple[Record, ...]
    lacks: dict[Lack, str]
    remarks: tuple[str, ...]
    rest: tuple[Record, ...] = ()


def check_data(recordings: Sequence[Record], channel: Channel) -> CheckedData:
    """Return the recordings by role, with the missing data.

    Noise records that are too short, or do not match the trials, are left out. Raises DataError, with all mistakes, if
    a diagnosis is impossible: there is no training trial; a trial lacks a column, is too short, shallow or constant, or
    is sampled unevenly; a noise record lacks a column, is constant, moves, or contains NaN; or the sampling rates
    differ.
    """
    roles = {role: tuple(each for each in recordings if each.role is role) for role in Role}
    training, held_out, noise = roles[Role.TRAIN], roles[Role.HOLDOUT], roles[Role.NOISE]
    mistakes: list[Mistake] = []
    if not training:
        mistakes.append(Mistake("role", "", "no trial has the role train: there is nothing to diagnose"))
    for each in (*training, *held_out):
        mistakes += _trial_mistakes(each, channel)
    for each in noise:
        mistakes += _noise_mistakes(each, channel)
    if mistakes:
        raise DataError(mistakes, "diagnose")
    rates = {each.trial: _interval_s(each) for each in recordings}
    first = rates[training[0].trial]
    mistakes += [
        Mistake(
            f"time_s of {name}",
            f"every {rate:.4g} s",
            f"must be sampled as in {training[0].trial}, every {first:.4g} s",
        )
        for name, rate in rates.items()
        if abs(rate / first - 1) > _RATE_TOLERANCE
    ]
    if mistakes:
        raise DataError(mistakes, "diagnose")
    lacks: dict[Lack, str] = {}
    long_enough = sum(float(np.ptp(each["time_s"])) for each in noise) >= _NOISE_RECORD_S
    other = _foreign_noise(training, noise, channel) if long_enough else ""
    usable = long_enough and not other
    rest = () if usable else rest_before_entry(training, channel.columns, _FEWEST_REST)
    if other:
        lacks[Lack.NOISE] = other
    if not long_enough:
        lacks[Lack.NOISE] = (
            f"no noise record of at least {_NOISE_RECORD_S:g} s (role noise: the sensor at rest): the noise is "
            f"estimated from {_source(rest)}, and an error of that estimate cannot be distinguished from a gap"
        )
    if not held_out:
        lacks[Lack.HELD_OUT] = "no held-out trial (role holdout): no effect can be validated"
    elif not any(_is_other_motion(each, training) for each in held_out):
        lacks[Lack.OTHER_MOTION] = (
            "the held-out trials repeat a training motion: they cannot validate an effect in another motion"
        )
    if len(training) < 2:
        lacks[Lack.TRIALS] = "one training trial: heterogeneity cannot be distinguished from a missing effect"
    remarks = [f"{each.trial}: {note}" for each in recordings for note in each.notes]
    return CheckedData(training, held_out, noise if usable else (), lacks, tuple(remarks), rest)


def _source(rest: Sequence[Record]) -> str:
    if not rest:
        return "the scatter of the trials from sample to sample"
    return f"{sum(float(np.ptp(each['time_s'])) for each in rest):.3g} s in which the needle stands before the entry"


def _trial_mistakes(record: Record, channel: Channel) -> list[Mistake]:
    """Return the mistakes of a training or held-out trial."""
    missing = [name for name in ("depth_mm", *channel.columns) if name not in record.columns]
    if missing:
        return [Mistake(f"{name} ({record.trial})", "", "is missing, but needed for this model") for name in missing]
    mistakes = []
    for name in channel.columns:
        good = np.isfinite(record[name])
        fewest = -(-FEWEST_VALUES // len(channel.columns))
        if good.sum() < fewest:
            rule = f"too short: at least {fewest} samples of {name} are needed"
            mistakes.append(Mistake(record.trial, f"{int(good.sum())} samples", rule))
        elif np.ptp(record[name][good]) == 0:
            rule = "is constant: the reading of a working sensor varies"
            mistakes.append(Mistake(f"{name} ({record.trial})", "", rule))
    if np.ptp(record["depth_mm"]) == 0:
        mistakes.append(Mistake(f"depth_mm ({record.trial})", "", "is constant: the needle does not move"))
    elif (deepest := float(record["depth_mm"].max())) < _SHALLOWEST_MM:
        rule = f"must reach {_SHALLOWEST_MM:g} mm: the tip is not in the tissue. Depth counts inwards from its surface"
        mistakes.append(Mistake(f"depth_mm ({record.trial})", f"{deepest:.3g} mm at most", rule))
    steps = np.diff(record["time_s"])
    if steps.size and steps.max() > _GAP_FACTOR * np.median(steps):
        rule = f"has a gap of {steps.max():.3g} s between samples every {np.median(steps):.3g} s; cut the trial there"
        mistakes.append(Mistake(f"time_s ({record.trial})", "", rule))
    elif steps.size and (uneven := np.mean(np.abs(steps / np.median(steps) - 1) > _INTERVAL_TOLERANCE)) > _UNEVEN_SHARE:
        rule = (
            f"is sampled unevenly: {uneven:.0%} of the intervals differ by more than {_INTERVAL_TOLERANCE:.0%} from "
            f"{np.median(steps):.3g} s, so the noise cannot be estimated. Record at one rate, or interpolate (--rate)"
        )
        mistakes.append(Mistake(f"time_s ({record.trial})", "", rule))
    return mistakes


def _noise_mistakes(record: Record, channel: Channel) -> list[Mistake]:
    """Return the mistakes of a noise record."""
    mistakes = []
    for name in channel.columns:
        if name not in record.columns:
            mistakes.append(Mistake(f"{name} ({record.trial})", "", "is missing from the noise record"))
        elif not np.isfinite(record[name]).all() or np.ptp(record[name]) == 0:
            rule = f"a noise record must have a number in {UNITS[name]} in every row, and they must not all be equal"
            mistakes.append(Mistake(f"{name} ({record.trial})", "", rule))
    moved = float(np.ptp(record["depth_mm"])) if "depth_mm" in record.columns else 0.0
    if moved > _REST_TOLERANCE_MM:
        rule = f"moves by {moved:.3g} mm, but a noise record is of a needle at rest in the air"
        mistakes.append(Mistake(f"depth_mm ({record.trial})", "", rule))
    return mistakes


def _foreign_noise(training: Sequence[Record], noise: Sequence[Record], channel: Channel) -> str:
    """Return why the noise records do not match the training trials; an empty text if they match."""
    for name in channel.columns:
        quiet, busy = (float(np.median([scatter(each[name]) for each in part])) for part in (noise, training))
        if quiet > 0 and busy > 0 and not 1 / _NOISE_RATIO < busy / quiet < _NOISE_RATIO:
            unit = UNITS[name]
            return (
                f"the noise record does not match the trials: from sample to sample {name} scatters by {quiet:.2g} "
                f"{unit} in the record and by {busy:.2g} {unit} in the trials, from which the noise is now estimated"
            )
    return ""


def scatter(values: Array) -> float:
    """Return the standard deviation of white noise in a signal, estimated from its second differences."""
    return float(np.nanmedian(np.abs(np.diff(values, n=2))) / 0.6745 / np.sqrt(6))


def _interval_s(record: Record) -> float:
    return float(np.median(np.diff(record["time_s"])))


def _is_other_motion(record: Record, training: Sequence[Record]) -> bool:
    """Return whether a trial's motion differs from every training motion."""
    for each in training:
        time = record["time_s"] - record["time_s"][0]
        other = np.interp(time, each["time_s"] - each["time_s"][0], each["depth_mm"])
        if float(np.sqrt(np.mean((record["depth_mm"] - other) ** 2))) < _SAME_MOTION_MM:
            return False
    return True


def sensor_noise(model: Model, checked: CheckedData) -> SensorNoise:
    """Return the sensor noise from the noise records; without any, from the training trials."""
    if checked.noise or checked.rest:
        return fit_axes([[each[name] for each in checked.noise or checked.rest] for name in model.channel.columns])
    # Without a noise record, the noise is the scatter from sample to sample; second differences remove the motion.
    found = []
    for name in model.channel.columns:
        sd = float(np.median([scatter(each[name]) for each in checked.training])) or 1e-9
        found.append(SensorNoise(np.zeros(0), sd, sd))
    return combine_axes(found)


def measured_output(record: Record, channel: Channel) -> Array:
    """Return the measured values of a channel, one axis after the other, shape (axes * samples,)."""
    return np.concatenate([record[name] for name in channel.columns])


def with_measured(record: Record, channel: Channel, values: Array) -> Record:
    """Return a copy of a recording with other values of a channel, shape (axes * samples,), axis after axis."""
    axes = zip(channel.columns, np.split(values, len(channel.columns)), strict=True)
    return replace(record, columns={**record.columns, **dict(axes)})


@dataclass(frozen=True)
class SensorNoise:
    """Noise of one axis: weights of past samples, standard deviation of the innovations, and RMS (channel's unit)."""

    weights: Array
    sd: float
    rms: float

    @property
    def order(self) -> int:
        """Order of the autoregression: number of past samples."""
        return int(self.weights.size)

    def whiten(self, values: Array, taps: Array | None = None) -> Array:
        """Return the innovations of `values` in units of their standard deviation, shape (n - order, ...).

        `taps` are weights of a filter that is applied first, such as a sensor lag. Before its first sample a signal is
        taken to be constant.
        """
        found = np.empty((max(len(values) - self.order, 0), *values.shape[1:]))
        self.whiten_into(found, values, taps)
        return found

    def whiten_into(self, found: Array, values: Array, taps: Array | None = None) -> None:
        """Write the result of `whiten` into `found`, shape (n - order, ...)."""
        whole = np.concatenate([[1.0], -self.weights]) / self.sd
        if taps is not None:
            whole = np.convolve(whole, taps)
        early = min(len(whole) - 1 - self.order, len(found))  # rows that need values before the first
        if early:
            before = np.broadcast_to(values[:1], (len(whole) - 1 - self.order, *values.shape[1:]))
            _filter(found[:early], whole, np.concatenate([before, values[: early + self.order]]))
        if early < len(found):
            _filter(found[early:], whole, np.asarray(values, float))


@dataclass(frozen=True)
class MultiAxisNoise(SensorNoise):
    """Noise of several independent axes; values hold one axis after the other, shape (axes * samples, ...).

    As many values are dropped at the start of each axis as the highest order of all axes, so that lengths are equal.
    """

    axes: tuple[SensorNoise, ...]

    def whiten(self, values: Array, taps: Array | None = None) -> Array:
        """Return the innovations, one axis after the other, shape (axes * (samples - order), ...)."""
        each = max(len(values) // len(self.axes) - self.order, 0)
        found = np.empty((each * len(self.axes), *values.shape[1:]))
        self.whiten_into(found, values, taps)
        return found

    def whiten_into(self, found: Array, values: Array, taps: Array | None = None) -> None:
        """Write the result of `whiten` into `found`, shape (axes * (samples - order), ...)."""
        count = len(self.axes)
        for axis, rows, part in zip(self.axes, np.split(found, count), np.split(values, count), strict=True):
            if axis.order == self.order:
                axis.whiten_into(rows, part, taps)
            else:
                rows[...] = axis.whiten(part, taps)[self.order - axis.order :]


def _filter(found: Array, weights: Array, values: Array) -> None:
    """Write sum_j weights[j] values[k - j] for each k with a full history into `found`, shape (n - order, ...).

    Values with several columns are filtered in blocks by a band matrix: more operations than a loop over the weights,
    but much faster.
    """
    if values.ndim == 1:
        found[:] = np.convolve(values, weights, "valid")
        return
    order = len(weights) - 1
    values = np.ascontiguousarray(values, float).reshape(len(values), -1)
    n, m = len(values) - order, values.shape[1]
    found = found.reshape(n, m)
    band = _band(weights.tobytes())
    part = len(band)
    parts, rest = divmod(n, part)
    row, column = values.strides
    windows = as_strided(values, (parts, part + order, m), (part * row, row, column), writeable=False)
    np.matmul(band, windows, out=found[: parts * part].reshape(parts, part, m))
    if rest:
        np.matmul(band[:rest, : rest + order], values[parts * part :], out=found[parts * part :])


@lru_cache(maxsize=16)
def _band(weights: bytes) -> Array:
    row = np.frombuffer(weights)
    order = len(row) - 1
    part = max(_FILTER_BLOCK, order)
    at = np.arange(part)
    band = np.zeros((part, part + order))
    for lag, weight in enumerate(row):
        band[at, at + order - lag] = weight
    return band


def combine_axes(axes: Sequence[SensorNoise]) -> SensorNoise:
    """Return the joint noise of several axes; for one axis, the noise of that axis."""
    if len(axes) == 1:
        return axes[0]
    longest = max(axes, key=lambda each: each.order)
    mean = [float(np.sqrt(np.mean([getattr(each, name) ** 2 for each in axes]))) for name in ("sd", "rms")]
    return MultiAxisNoise(longest.weights, mean[0], mean[1], tuple(axes))


def fit_axes(rows: Sequence[Sequence[Array]]) -> SensorNoise:
    """Fit noise with common weights and separate standard deviations to axes; `rows` holds the recordings by axis.

    The order minimises the AIC instead of the BIC: too low an order underestimates slow noise, which smooth functions
    would then fit. A single axis is fitted by `fit_noise`, with the BIC.
    """
    if len(rows) == 1:
        return fit_noise(rows[0])
    rms = [float(np.sqrt(np.mean(np.concatenate([row - row.mean() for row in axis]) ** 2))) for axis in rows]
    shared = [row / size for axis, size in zip(rows, rms, strict=True) for row in axis]
    whole = fit_noise(shared, highest=_HIGHEST_SHARED_ORDER, penalty=2.0)
    return combine_axes([SensorNoise(whole.weights, whole.sd * size, size) for size in rms])


def fit_noise(rows: Sequence[Array], *, highest: int = _HIGHEST_ORDER, penalty: float | None = None) -> SensorNoise:
    """Fit an autoregression to noise recordings minus their means; each recording has shape (samples,).

    `penalty` is the cost of one weight in twice the log-likelihood; by default log(n), as in the BIC.
    """
    centred = [row - row.mean() for row in rows]
    n = sum(row.size for row in centred)
    most = min(highest, min(row.size for row in centred) // 10)
    rms = float(np.sqrt(sum(row @ row for row in centred) / max(n - len(centred), 1)))
    best, least = SensorNoise(np.zeros(0), rms, rms), n * np.log(max(rms, 1e-300) ** 2)
    target = np.concatenate([row[most:] for row in centred])
    past = np.vstack([
        np.column_stack([row[most - lag : row.size - lag] for lag in range(1, most + 1)]) for row in centred
    ]) if most else np.zeros((n, 0))  # fmt: skip
    for order in range(1, most + 1):
        weights = np.linalg.lstsq(past[:, :order], target, rcond=None)[0]
        left = target - past[:, :order] @ weights
        variance = float(left @ left) / max(target.size - order, 1)
        criterion = n * np.log(max(variance, 1e-300)) + order * (np.log(n) if penalty is None else penalty)
        if criterion < least:
            best, least = SensorNoise(weights, float(np.sqrt(variance)), rms), criterion
    return best
