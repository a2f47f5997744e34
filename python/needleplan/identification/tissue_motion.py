"""`identify tissue-motion`: lag of the tissue around a moving needle, by the slow observer and by a fitted tissue.

The slow observer is that of chapter 4 of the thesis. The fitted tissue is a spring and a damper in series with the
friction of the needle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from needleplan.errors import DataError, Mistake
from needleplan.identification._between_trials import with_scatter
from needleplan.identification._identification import Finding, Identification, averaged, trials_by_role, undetermined
from needleplan.models import Fit, LumpedLuGre, LumpedOnTissue, fit, residual_findings, simulate
from needleplan.models.tissue import SlowObserver, TuningStatus, fit_on_tissue, lag_with_sd, tune_slow_observer
from needleplan.plotting.canvas import BLUE, GREY, VERMILLION, title
from needleplan.signals import (
    Array,
    MovingAverage,
    Projection,
    Record,
    VelocityMethod,
    dominant_frequency_hz,
    lag_rad,
    sine_at,
    velocity_without_delay,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Excitation", "identify"]

# Delay (s) of the column velocity_mm_s above which a remark reports it.
_LATE_S = 0.01

# Least number of samples for a velocity without delay.
_FEWEST = 15

# Ratio of the largest to the smallest amplitude (or frequency) below which all count as equal.
_SAME = 1.25

# Relative reduction of the RMSE by a moving tissue below which the finding says that moving tissue is hardly needed.
_NEEDED = 0.05

# Initial time (s) that the figure leaves out.
_SKIPPED_S = 1.0


@dataclass(frozen=True)
class Excitation:
    """Frequency and amplitude of the dominant sine in the motion of a record."""

    frequency_hz: float
    amplitude_mm: float

    @classmethod
    def of(cls, record: Record) -> Excitation:
        """Return the dominant sine of the depth. Raises DataError if the depth is constant."""
        frequency = dominant_frequency_hz(record["time_s"], record["depth_mm"])
        return cls(frequency, sine_at(frequency, record["time_s"], record["depth_mm"]).amplitude)


def identify(records: object, *, average: int = 5, starts: int = 2, marker: str | None = None) -> Identification:
    """Identify lag, slow observer, stiffness and damping of the tissue around an oscillating needle.

    Parameters
    ----------
    records : Record, table of columns such as a DataFrame, path of a data file, or list of these
        Trials with time_s, depth_mm and force_n. The velocity is computed from the depth, without a delay; a column
        velocity_mm_s is only compared with it. Trials with the role holdout validate the model.
    average
        Number of samples that the force sensor averages (5 in the thesis); 1: no average.
    starts
        Number of starting points of the fit.
    marker
        Name of a column with the displacement (mm), along the needle, of a sensor in the tissue. The lag of this sensor
        is reported too. None: no such column.

    Returns
    -------
    Identification
        The model is a `LumpedOnTissue`; None if the fit did not converge.

    Raises
    ------
    DataError
        No trial has the role train, a column is missing, a force is not finite, or a record is too short or has no
        motion.
    """
    trials = trials_by_role(records)
    remarks = list(trials.remarks)
    train, holdout = ([_prepared(each, remarks) for each in some] for some in (trials.train, trials.holdout))
    excitations = [Excitation.of(each) for each in train]
    largest = int(np.argmax([each.amplitude_mm * each.frequency_hz for each in excitations]))
    record, excitation = train[largest], excitations[largest]

    tuned = _tuned(record)
    joint = with_scatter(
        fit_on_tissue(train, average=average, starts=starts), train, smooth=MovingAverage(average).apply
    )
    result, model = joint.fit, joint.fit.model
    assert isinstance(model, LumpedOnTissue)
    rigid = _rigid(train, model, average)
    lag, lag_sd = lag_with_sd(result, record, excitation.frequency_hz)
    scores = [
        ("frequency of the motion", excitation.frequency_hz, "Hz"),
        ("amplitude of the motion", excitation.amplitude_mm, "mm"),
        ("lag, fitted tissue", float(np.degrees(lag)), "deg"),
        ("lag, fitted tissue, standard deviation", float(np.degrees(lag_sd)), "deg"),
        *_observed(tuned, excitation),
        ("RMSE, friction on tissue", result.rmse, "N"),
        ("RMSE, friction on rigid tissue", rigid.rmse, "N"),
        *((f"RMSE on {each.trial or 'held-out trial'}", _rmse(model, each, average), "N") for each in holdout),
        *_marked(record, excitation, marker),
    ]
    findings = [
        _agreement(tuned, excitation, lag, lag_sd),
        _moves(result, rigid),
        *residual_findings(result, train),
    ]
    remarks += [*joint.remarks, *_limits(result, tuned, excitations), averaged(average)]
    return Identification(
        "tissue-motion", model if result.ok else None, dict(result.estimates), tuple(scores), tuple(findings),
        tuple(remarks), partial(_draw, record=record, model=model, projection=tuned.projection, average=average),
    )  # fmt: skip


def _tuned(record: Record) -> SlowObserver:
    try:
        return tune_slow_observer(record["time_s"], record["depth_mm"], record["force_n"])
    except DataError as error:
        raise DataError(error.mistakes, record.trial) from None


def _prepared(record: Record, remarks: list[str]) -> Record:
    """Return the record with a velocity computed from the depth without delay, in the column velocity_mm_s.

    Appends remarks about a delayed given velocity and a noisy depth. Raises DataError if the record is too short, its
    depth is constant, or a force is not finite.
    """
    time, depth, trial = record["time_s"], record["depth_mm"], record.trial or "the record"
    if not np.ptp(depth) > 0:
        raise DataError(Mistake("depth_mm", "", "is constant: a needle at rest identifies nothing"), record.trial)
    if not np.isfinite(record["force_n"]).all():
        raise DataError(Mistake("force_n", "", "must be finite numbers: the tuning filters it"), record.trial)
    if len(record) < _FEWEST:
        rule = f"too short: at least {_FEWEST} are needed"
        raise DataError(Mistake("depth_mm", f"{len(record)} samples", rule), record.trial)
    made = velocity_without_delay(time, depth)
    given = record.columns.get("velocity_mm_s")
    if given is not None and np.isfinite(given).all():
        frequency = dominant_frequency_hz(time, depth)
        late = lag_rad(frequency, time, given, made.velocity_mm_s) / (2 * np.pi * frequency)
        if abs(late) > _LATE_S:
            remarks.append(f"{trial}: velocity_mm_s is {late:.3f} s later than the depth says, and is not used")
    if made.method is VelocityMethod.SMOOTHER:
        remarks.append(
            f"{trial}: the depth has {made.noise_mm:.2g} mm of noise or uneven sampling times: a smoother was used"
        )
    return record.with_column("velocity_mm_s", made.velocity_mm_s)


def _rigid(train: Sequence[Record], model: LumpedOnTissue, average: int) -> Fit:
    """Return the fit of the same friction model on rigid tissue."""
    start = LumpedLuGre(
        sigma0=model.sigma0,
        sigma1=model.sigma1,
        sigma2=model.sigma2,
        mu_c=model.mu_c,
        mu_s=model.mu_s,
        alpha=model.alpha,
    )
    return fit(start, train, smooth=MovingAverage(average).apply)


def _rmse(model: LumpedOnTissue, record: Record, average: int) -> float:
    simulated = MovingAverage(average).apply(simulate(model, record.motion()).output)
    return float(np.sqrt(np.nanmean((record["force_n"] - simulated) ** 2)))


def _observed(tuned: SlowObserver, excitation: Excitation) -> list[tuple[str, float, str]]:
    if tuned.projection is None or tuned.alpha1 is None:
        return []
    lag = float(np.degrees(tuned.projection.lag_rad(excitation.frequency_hz)))
    lost = 100 * float(tuned.projection.attenuation(excitation.frequency_hz))
    return [
        ("alpha1 of the slow observer", tuned.alpha1, "1/s"),
        ("lag, slow observer", lag, "deg"),
        ("attenuation, slow observer", lost, "%"),
    ]


def _marked(record: Record, excitation: Excitation, marker: str | None) -> list[tuple[str, float, str]]:
    """Return a score: the phase lag (deg) of the difference of needle and marker velocity behind the needle velocity.

    Returns an empty list without a marker.
    """
    if marker is None:
        return []
    seen = np.isfinite(record[marker])
    time, velocity = record["time_s"][seen], record["velocity_mm_s"][seen]
    relative: Array = velocity - velocity_without_delay(time, record[marker][seen]).velocity_mm_s
    lag = lag_rad(excitation.frequency_hz, time, relative, velocity)
    return [(f"lag, marker {marker}", float(np.degrees(lag)), "deg")]


def _agreement(tuned: SlowObserver, excitation: Excitation, lag: float, lag_sd: float) -> Finding:
    """Test whether the lags of the slow observer and of the fitted tissue agree."""
    name = "slow observer against fitted tissue"
    fitted = f"the fitted tissue lags by {np.degrees(lag):.2f} +- {1.96 * np.degrees(lag_sd):.2f} deg"
    if tuned.projection is None:
        words = {
            TuningStatus.NO_COMPENSATION: "no slow observer closes the loop",
            TuningStatus.TOO_FEW_CROSSINGS: "the force does not cross zero both ways",
        }
        return Finding(name, float("nan"), None, f"{words[tuned.status]}; {fitted}")
    observed = float(tuned.projection.lag_rad(excitation.frequency_hz))
    sd = float(np.hypot(lag_sd, tuned.lag_sd_rad(excitation.frequency_hz)))
    if not np.isfinite(sd):
        untested = "their agreement cannot be tested: too few zeros of the force, or the tissue is not identified"
        says = f"the observer lags by {np.degrees(observed):.2f} deg, {fitted}; {untested}"
        return Finding(name, float("nan"), None, says)
    score = (observed - lag) / sd if sd > 0 else float("inf")
    p_value = float(2 * stats.norm.sf(abs(score)))
    apart = "they disagree: the observer also contains the delay of dry friction and the lead of the bristle damping"
    verdict = "they agree" if p_value > 0.05 else apart
    return Finding(name, score, p_value, f"the observer lags by {np.degrees(observed):.2f} deg, {fitted}; {verdict}")


def _moves(result: Fit, rigid: Fit) -> Finding:
    """Return the finding on how much the RMSE decreases if the tissue may move."""
    gain = 1 - result.rmse / rigid.rmse if rigid.rmse > 0 else 0.0
    says = f"moving tissue reduces the RMSE from {1e3 * rigid.rmse:.1f} to {1e3 * result.rmse:.1f} mN"
    if gain < _NEEDED:
        says += ": hardly at all, so the data give at best a lower bound of the stiffness"
    return Finding("does the tissue move", gain, None, says)


def _limits(result: Fit, tuned: SlowObserver, excitations: Sequence[Excitation]) -> list[str]:
    """Return remarks about parameters that the records do not determine, and about records that would help."""
    remarks = undetermined(result.estimates)
    if not result.ok:
        remarks.append(f"the fit ended with: {result.status}")
    amplitudes = [excitation.amplitude_mm for excitation in excitations]
    frequencies = [excitation.frequency_hz for excitation in excitations]
    if max(amplitudes) < _SAME * min(amplitudes) and max(frequencies) < _SAME * min(frequencies):
        bristles = {name: result.estimates[name] for name in ("sigma0", "sigma1") if name in result.estimates}
        known = ", ".join(f"{name} to {100 * bristle.sd / bristle.value:.0f} %" for name, bristle in bristles.items())
        remarks.append(
            f"one amplitude and one frequency ({amplitudes[0]:.0f} mm, {frequencies[0]:.2g} Hz): compliance of the "
            f"tissue, bending of the bristles ({known}) and delays of sensors have the same effect; record a second "
            "amplitude (10 mm), a second frequency, or a marker in the tissue to separate them"
        )
    if tuned.status is TuningStatus.NO_COMPENSATION:
        remarks.append("there is no slow observer: the tissue is too stiff, or the force leads the motion")
    return remarks


def _draw(figure: Figure, record: Record, model: LumpedOnTissue, projection: Projection | None, average: int) -> None:
    """Draw measured and fitted force over velocity, in two or three panels with different velocities.

    The velocities are that of the needle, that of the needle relative to the fitted tissue, and, if `projection` is
    given, that of the slow observer.
    """
    motion, force = record.motion(), record["force_n"]
    done = simulate(model, motion)
    simulated = MovingAverage(average).apply(done.output)
    shown = motion.time_s - motion.time_s[0] >= _SKIPPED_S
    relative = motion.velocity_mm_s - done.states[2]
    panels = [
        (
            "velocity of the needle (mm/s)",
            f"{record.trial}: measured and fitted".removeprefix(": "),
            motion.velocity_mm_s,
            simulated,
            force,
        ),
        ("velocity relative to the tissue (mm/s)", "relative to the fitted tissue", relative, simulated, force),
    ]
    if projection is not None:
        slow = projection.slow.observe(motion.depth_mm)
        late = projection.fast.normalised
        heading = rf"normalised, $\alpha_1$ = {projection.slow.alpha1:.1f}"
        panels.append(("velocity by the slow observer (mm/s)", heading, slow, late.apply(simulated), late.apply(force)))
    axes = np.atleast_1d(figure.subplots(1, len(panels), sharey=True))
    for axis, (label, heading, velocity, fitted, measured) in zip(axes, panels, strict=True):
        axis.axhline(0, color=GREY, linewidth=0.6)
        axis.axvline(0, color=GREY, linewidth=0.6)
        axis.plot(velocity[shown], measured[shown], ".", color=BLUE, markersize=1, alpha=0.4, label="measured")
        axis.plot(velocity[shown], fitted[shown], color=VERMILLION, linewidth=1.0, label="fitted")
        axis.set_xlabel(label)
        title(axis, heading)
    axes[0].set_ylabel("axial force (N)")
    axes[0].legend(frameon=False, fontsize=8, loc="upper left")
