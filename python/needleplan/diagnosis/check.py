"""Whether the data can carry a diagnosis, and what they cannot carry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.models import Channel
from needleplan.signals import UNITS, Array, Record, Role

__all__ = ["Checked", "Lack", "check_data", "scatter"]

_FEWEST = 200
"""Numbers that a trial must have, of all axes together."""

_NOISE_S = 5.0
_SAME_RATE = 0.03
_SAME_MOTION_MM = 0.5
_GAP = 5.0
_SHALLOWEST_MM = 3.0
_MOVED_MM = 1.0
_SAME_NOISE = 5.0
_EVEN = 0.5
_MOST_UNEVEN = 0.1


class Lack(StrEnum):
    """What is missing, and keeps an effect from being named."""

    NOISE = "noise record"
    HELD_OUT = "held-out trial"
    OTHER_MOTION = "held-out trial of another motion"
    TRIALS = "second training trial"
    NEEDLE = "recording of the needle of the model"


@dataclass(frozen=True)
class Checked:
    """Trials by their role; what is lacking, each with what can still be said; remarks."""

    training: tuple[Record, ...]
    held_out: tuple[Record, ...]
    noise: tuple[Record, ...]
    lacks: dict[Lack, str]
    remarks: tuple[str, ...]


def check_data(recordings: Sequence[Record], channel: Channel) -> Checked:
    """Sort recordings by their role and say what is missing.

    Raises DataError, with every mistake, where nothing can be said: no training trial, a column that is missing, too
    few samples, sampling that is uneven or not that of the noise record, a channel that is constant.
    """
    roles = {role: tuple(each for each in recordings if each.role is role) for role in Role}
    training, held_out, noise = roles[Role.TRAIN], roles[Role.HOLDOUT], roles[Role.NOISE]
    mistakes: list[Mistake] = []
    if not training:
        mistakes.append(Mistake("role", "", "no trial has the role train: there is nothing to diagnose"))
    for each in (*training, *held_out):
        mistakes += _unusable(each, channel)
    for each in noise:
        mistakes += _unusable_noise(each, channel)
    if mistakes:
        raise DataError(mistakes, "diagnose")
    rates = {each.trial: _interval_s(each) for each in recordings}
    first = rates[training[0].trial]
    mistakes += [
        Mistake(
            f"time_s of {name}", f"every {rate:.4g} s", f"must be sampled as {training[0].trial}, every {first:.4g} s"
        )
        for name, rate in rates.items()
        if abs(rate / first - 1) > _SAME_RATE
    ]
    if mistakes:
        raise DataError(mistakes, "diagnose")
    lacks: dict[Lack, str] = {}
    long_enough = sum(float(np.ptp(each["time_s"])) for each in noise) >= _NOISE_S
    other = _other_noise(training, noise, channel) if long_enough else ""
    if other:
        lacks[Lack.NOISE] = other
    if not long_enough:
        lacks[Lack.NOISE] = (
            f"no noise record of at least {_NOISE_S:g} s (role noise: the sensor with nothing happening): the noise is "
            "taken from what smooth functions leave, and a gap in the noise cannot be told from one in the model"
        )
    if not held_out:
        lacks[Lack.HELD_OUT] = "no held-out trial (role holdout): whether an effect holds elsewhere is not known"
    elif not any(_other_motion(each, training) for each in held_out):
        lacks[Lack.OTHER_MOTION] = (
            "the held-out trials repeat a motion of the training: that proves nothing about others"
        )
    if len(training) < 2:
        lacks[Lack.TRIALS] = "one training trial: what differs from place to place cannot be told from what is missing"
    remarks = [f"{each.trial}: {note}" for each in recordings for note in each.notes]
    return Checked(training, held_out, noise if long_enough and not other else (), lacks, tuple(remarks))


def _unusable(record: Record, channel: Channel) -> list[Mistake]:
    missing = [name for name in ("depth_mm", *channel.columns) if name not in record.columns]
    if missing:
        return [Mistake(f"{name} ({record.trial})", "", "is missing, and is needed here") for name in missing]
    mistakes = []
    for name in channel.columns:
        good = np.isfinite(record[name])
        fewest = -(-_FEWEST // len(channel.columns))
        if good.sum() < fewest:
            rule = f"too short: at least {fewest} samples of {name} are needed"
            mistakes.append(Mistake(record.trial, f"{int(good.sum())} samples", rule))
        elif np.ptp(record[name][good]) == 0:
            rule = "is constant to the last bit: no sensor measures that"
            mistakes.append(Mistake(f"{name} ({record.trial})", "", rule))
    if np.ptp(record["depth_mm"]) == 0:
        mistakes.append(Mistake(f"depth_mm ({record.trial})", "", "is constant: a needle at rest shows nothing"))
    elif (deepest := float(record["depth_mm"].max())) < _SHALLOWEST_MM:
        rule = f"must reach {_SHALLOWEST_MM:g} mm: the tip is not in the tissue. Depth counts inwards from its surface"
        mistakes.append(Mistake(f"depth_mm ({record.trial})", f"{deepest:.3g} mm at most", rule))
    steps = np.diff(record["time_s"])
    if steps.size and steps.max() > _GAP * np.median(steps):
        rule = f"has a gap of {steps.max():.3g} s between samples every {np.median(steps):.3g} s; cut the trial there"
        mistakes.append(Mistake(f"time_s ({record.trial})", "", rule))
    elif steps.size and (uneven := float(np.mean(np.abs(steps / np.median(steps) - 1) > _EVEN))) > _MOST_UNEVEN:
        usual = f"from {np.median(steps):.3g} s"
        rule = (
            f"is sampled unevenly: {uneven:.0%} of the intervals differ by more than {_EVEN:.0%} {usual}, and noise "
            "from sample to sample says nothing then. Record, or interpolate, at one rate"
        )
        mistakes.append(Mistake(f"time_s ({record.trial})", "", rule))
    return mistakes


def _unusable_noise(record: Record, channel: Channel) -> list[Mistake]:
    mistakes = []
    for name in channel.columns:
        if name not in record.columns:
            mistakes.append(Mistake(f"{name} ({record.trial})", "", "is missing from the noise record"))
        elif not np.isfinite(record[name]).all() or np.ptp(record[name]) == 0:
            rule = f"a noise record must have a number in {UNITS[name]} in every row, and they must not all be equal"
            mistakes.append(Mistake(f"{name} ({record.trial})", "", rule))
    moved = float(np.ptp(record["depth_mm"])) if "depth_mm" in record.columns else 0.0
    if moved > _MOVED_MM:
        rule = f"moves by {moved:.3g} mm, and a noise record is of a needle at rest in the air"
        mistakes.append(Mistake(f"depth_mm ({record.trial})", "", rule))
    return mistakes


def _other_noise(training: Sequence[Record], noise: Sequence[Record], channel: Channel) -> str:
    """Return why a noise record cannot be of the sensor of the trials; empty where it can."""
    for name in channel.columns:
        quiet, busy = (float(np.median([scatter(each[name]) for each in part])) for part in (noise, training))
        if quiet > 0 and busy > 0 and not 1 / _SAME_NOISE < busy / quiet < _SAME_NOISE:
            unit = UNITS[name]
            return (
                f"the noise record is not of this sensor as it was in the trials: from sample to sample {name} "
                f"scatters by {quiet:.2g} {unit} in it, by {busy:.2g} {unit} in them; the noise is that of the trials"
            )
    return ""


def scatter(values: Array) -> float:
    """Return the standard deviation from sample to sample: twice differenced, motion is gone."""
    return float(np.nanmedian(np.abs(np.diff(values, n=2))) / 0.6745 / np.sqrt(6))


def _interval_s(record: Record) -> float:
    return float(np.median(np.diff(record["time_s"])))


def _other_motion(record: Record, training: Sequence[Record]) -> bool:
    """Whether a trial moves otherwise than all of the training."""
    for each in training:
        time = record["time_s"] - record["time_s"][0]
        other = np.interp(time, each["time_s"] - each["time_s"][0], each["depth_mm"])
        if float(np.sqrt(np.mean((record["depth_mm"] - other) ** 2))) < _SAME_MOTION_MM:
            return False
    return True
