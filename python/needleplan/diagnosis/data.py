"""Input of a diagnosis: recordings by role, checked, and the data that are missing; the noise of the sensor."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from needleplan.artifacts import ShortRepr
from needleplan.errors import DataError, Mistake
from needleplan.models import Channel, Model, simulate
from needleplan.signals import (
    UNITS,
    Array,
    Record,
    Role,
    SensorNoise,
    combine_axes,
    fit_axes,
    require_one_frame,
    rest_before_entry,
    scatter,
)

__all__ = ["FEWEST_VALUES", "CheckedData", "Lack", "check_data", "check_needle", "measured_output", "sensor_noise"]

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
# Ratio of measured to predicted RMS, or its inverse, above which the recordings count as another needle's.
_OTHER_NEEDLE_RATIO = 5.0
# Correlation of readings and prediction below which the force of a trial has the wrong sign. No missing effect turns
# friction and cutting force round.
_OPPOSITE = -0.5
# Least number of samples of a part of a trial, before the entry, from which the noise is estimated.
_FEWEST_REST = 100
# Least noise without a noise record, as a share of the RMS of the readings, for data without noise. A smaller one takes
# the digits from the sums of squares in which hypotheses differ.
_LEAST_NOISE = 1e-6
# Ratio between the scatter of trials and noise record, or its inverse, from which the record is not used.
_NOISE_RATIO = 5.0
# Relative deviation from the median interval above which a sampling interval counts as uneven.
_INTERVAL_TOLERANCE = 0.5
# Largest permitted share of uneven sampling intervals.
_UNEVEN_SHARE = 0.1


# Distance (mm) before the surface from which a needle touches no tissue, fewest readings there, how many neighbouring
# readings count as one, since noise is coloured, and standard deviations above which zeros of the sensor differ.
_OUTSIDE_MM, _FEWEST_OUTSIDE, _ALIKE, _ZERO_SDS = 0.5, 20, 10, 5.0


class Lack(StrEnum):
    """Data without which no effect is named."""

    NOISE = "noise record"
    HELD_OUT = "held-out trial"
    OTHER_MOTION = "held-out trial of another motion"
    TRIALS = "second training trial"
    NEEDLE = "recording of the needle of the model"


@dataclass(frozen=True)
class CheckedData(ShortRepr):
    """Usable recordings by role, with remarks. `lacks` maps each kind of missing data to the reason why it matters.

    Without a noise record, `rest` holds the parts of training trials in which the needle stands before the entry.
    """

    training: tuple[Record, ...]
    held_out: tuple[Record, ...]
    references: tuple[Record, ...]
    noise: tuple[Record, ...]
    lacks: dict[Lack, str]
    remarks: tuple[str, ...]
    rest: tuple[Record, ...] = ()

    @property
    def trials(self) -> tuple[Record, ...]:
        """Training, held-out and reference trials, in this order."""
        return *self.training, *self.held_out, *self.references


def check_data(recordings: Sequence[Record], channel: Channel) -> CheckedData:
    """Return the recordings by role, with the missing data.

    Noise records that are too short, or do not match the trials, are left out. Raises DataError, with all mistakes, if
    a diagnosis is impossible: there is no training trial; a trial lacks a column, is too short, shallow or constant, or
    is sampled unevenly; a noise record lacks a column, is constant, moves, or contains NaN; or the sampling rates
    differ.
    """
    require_one_frame(recordings)
    roles = {role: tuple(recording for recording in recordings if recording.role is role) for role in Role}
    training, held_out, noise = roles[Role.TRAIN], roles[Role.HOLDOUT], roles[Role.NOISE]
    references = roles[Role.REFERENCE]
    mistakes: list[Mistake] = []
    if not training:
        mistakes.append(Mistake("role", "", "no trial has the role train: there is nothing to diagnose"))
    for each in (*training, *held_out, *references):
        mistakes += _trial_mistakes(each, channel)
    for each in noise:
        mistakes += _noise_mistakes(each, channel)
    if mistakes:
        raise DataError(mistakes, "diagnose")
    rates = {recording.trial: _interval_s(recording) for recording in recordings}
    first = rates[training[0].trial]
    mistakes += [
        Mistake(
            f"time_s of {name}",
            f"every {rate:.4g} s",
            f"must be sampled as in {training[0].trial}, every {first:.4g} s: --rate HZ interpolates all trials",
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
    remarks = [f"{recording.trial}: {note}" for recording in recordings for note in recording.notes]
    if channel is Channel.FORCE:
        remarks += _zero_remarks((*training, *held_out, *references))
    return CheckedData(training, held_out, references, noise if usable else (), lacks, tuple(remarks), rest)


def _zero_remarks(trials: Sequence[Record]) -> list[str]:
    """Return a remark if the readings of the force before the entry differ between the trials by more than chance."""
    found = []
    for trial in trials:
        force = trial["force_n"][trial["depth_mm"] < -_OUTSIDE_MM]
        force = force[np.isfinite(force)]
        if len(force) >= _FEWEST_OUTSIDE:
            error = float(force.std()) * math.sqrt(_ALIKE / len(force))
            found.append((float(force.mean()), error, trial.trial))
    if len(found) < 2:
        return []
    (low, low_error, one), (high, high_error, other) = min(found), max(found)
    if high - low <= _ZERO_SDS * math.hypot(low_error, high_error):
        return []
    return [
        f"the force before the entry is {low:.3g} N in {one} and {high:.3g} N in {other}: subtract the zero of the "
        "sensor from each trial. The effect `bias` is one zero for all trials"
    ]


def _source(rest: Sequence[Record]) -> str:
    if not rest:
        return "the scatter of the trials from sample to sample"
    return f"{sum(float(np.ptp(each['time_s'])) for each in rest):.3g} s in which the needle stands before the entry"


def _trial_mistakes(record: Record, channel: Channel) -> list[Mistake]:
    """Return the mistakes of a trial that moves."""
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
        rule = (
            f"has a gap of {steps.max():.3g} s after {record['time_s'][np.argmax(steps)]:.6g} s, between samples every "
            f"{np.median(steps):.3g} s; cut the trial there"
        )
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
        size = float(np.sqrt(np.mean([np.nanmean(trial[name] ** 2) for trial in checked.training])))
        sd = max(float(np.median([scatter(trial[name]) for trial in checked.training])), _LEAST_NOISE * size, 1e-9)
        found.append(SensorNoise(np.zeros(0), sd, sd))
    return combine_axes(found)


def check_needle(checked: CheckedData, model: Model) -> CheckedData:
    """Return the data, with `Lack.NEEDLE` added if the RMS of the readings is a factor of 5 off the model's prediction.

    Calibration would hide that the recordings are of another needle than the model. Raises DataError if the force of a
    trial has the opposite sign.
    """
    trials = (*checked.training, *checked.held_out, *checked.references)
    predicted = [simulate(model, trial.motion()).output.ravel() for trial in trials]
    readings = [measured_output(trial, model.channel) for trial in trials]
    if model.channel is Channel.FORCE and (mistakes := list(_signs(trials, readings, predicted))):
        raise DataError(mistakes, "diagnose")
    given = np.concatenate(predicted[: len(checked.training)])
    measured = np.concatenate(readings[: len(checked.training)])
    ratio = float(np.sqrt(np.nanmean(measured**2)) / max(float(np.sqrt(np.mean(given**2))), 1e-12))
    if 1 / _OTHER_NEEDLE_RATIO < ratio < _OTHER_NEEDLE_RATIO:
        return checked
    why = (
        f"the RMS of the readings is {ratio:.2g} times the prediction of the model: another needle or tissue, or a "
        "wrong unit? First identify the base model from recordings of this needle"
    )
    return replace(checked, lacks={**checked.lacks, Lack.NEEDLE: why})


def _signs(trials: Sequence[Record], readings: Sequence[Array], predicted: Sequence[Array]) -> Iterator[Mistake]:
    """Yield a mistake for each trial whose readings have the opposite sign of the prediction.

    A fit would make friction and cutting force vanish, and call the rest noise or other laws.
    """
    for trial, measured, model in zip(trials, readings, predicted, strict=True):
        good = np.isfinite(measured)
        both = np.cov(measured[good], model[good])
        correlation = float(both[0, 1] / max(math.sqrt(both[0, 0] * both[1, 1]), 1e-300))
        if correlation < _OPPOSITE:
            rule = (
                f"has the opposite sign of the model's force (correlation {correlation:.2f}): a push is positive. "
                "Change the sign, as in --columns force=-F, or record depth and force in the same direction"
            )
            yield Mistake(f"force_n ({trial.trial})", "", rule)


def measured_output(record: Record, channel: Channel) -> Array:
    """Return the measured values of a channel, one axis after the other, shape (axes * samples,)."""
    return np.concatenate([record[name] for name in channel.columns])
