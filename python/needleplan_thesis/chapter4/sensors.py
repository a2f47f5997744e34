"""Sensors in the tissue compared with the slow observer (Figure 4.4), and tissue parameters fitted to known phantoms.

The thesis has no numbers for the fitted tissue parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from needleplan.models.tissue import fit_on_tissue, lag_with_sd, tune_slow_observer
from needleplan.plotting import save
from needleplan.plotting.canvas import BLACK, BLUE, GREEN, ORANGE, VERMILLION, title
from needleplan.reports.comparison import Agreement, Comparison, Evidence, measured
from needleplan.signals import Array, Record, TrackerFilter, lag_rad, velocity_without_delay
from needleplan_thesis.chapter4.loops import FrictionLoop
from needleplan_thesis.chapter4.phantoms import FREQUENCY_HZ, GELATIN, SENSOR_LAG_DEG, SHARES, Phantom, PhantomTrial

__all__ = ["draw_sensors", "sensor_rows", "tissue_rows"]

# Noise density of the tracker filter (mm^2/s^5): jerks of about 1 mm/s^3 that last a second, as in tissue at 0.1 Hz.
_DENSITY = 3.0

# Standard deviation of the trackers (mm).
_SD_MM = 0.1

# Initial times (s) that comparisons and figures leave out, because the tracker filter has not settled.
_SKIPPED_S = 2.0
_SETTLING_S = 0.5


@dataclass(frozen=True)
class _Seen:
    """Velocities at the times of the trackers; `tissue_mm_s` has the shape (3, samples), one row per sensor."""

    time_s: Array
    tissue_mm_s: Array
    fast_mm_s: Array
    slow_mm_s: Array

    @property
    def relative_mm_s(self) -> Array:
        """Velocity of the needle (fast observer) minus the velocity of each sensor: v_comp, shape (3, samples)."""
        return np.asarray(self.fast_mm_s - self.tissue_mm_s)


def _seen(loop: FrictionLoop) -> _Seen:
    trial: PhantomTrial = loop.trial
    time, needle = trial.tracker_time_s, trial.motion.time_s
    filtered = TrackerFilter(_SD_MM, _DENSITY)
    tissue = np.array([filtered.apply(time, sensor_mm).velocity_mm_s for sensor_mm in trial.sensors_mm])
    fast, slow = (np.interp(time, needle, each) for each in (loop.fast_mm_s, loop.slow_mm_s))
    return _Seen(time, tissue, fast, slow)


def sensor_rows(loop: FrictionLoop) -> list[Comparison]:
    """Compare the lags with the published lags, and the slow observer with the sensors in the tissue."""
    seen = _seen(loop)
    counts = seen.time_s >= _SKIPPED_S
    relative = seen.relative_mm_s[:, counts]
    time, fast, slow = seen.time_s[counts], seen.fast_mm_s[counts], seen.slow_mm_s[counts]
    lags = [float(np.degrees(lag_rad(FREQUENCY_HZ, time, each, fast))) for each in relative]
    apart = np.sqrt(np.mean((relative - slow) ** 2, axis=1) / np.mean(relative**2, axis=1))
    best = int(np.argmin(apart)) + 1
    observed = float(np.degrees(loop.projection.lag_rad(FREQUENCY_HZ)))
    chosen = "the stiffness of the phantom was chosen for this lag"
    return [
        measured("ch4/figure 4.4/lag of v_comp,3 behind v_f", SENSOR_LAG_DEG, lags[2], "deg", chosen,
                 kind=Evidence.ROUND_TRIP),
        Comparison(
            "ch4/figure 4.4/observer less v_comp,3", None, observed - lags[2], "deg", Agreement.OURS,
            f"the error of the method; it depends on the ratio of dry to viscous friction; the printed lags of "
            f"{GELATIN.lag_deg:g} and {SENSOR_LAG_DEG:g} deg differ by {GELATIN.lag_deg - SENSOR_LAG_DEG:.2f} deg, a "
            "number that the thesis does not print",
            kind=Evidence.OWN_DATA,
        ),
        Comparison(
            "ch4/figure 4.4/v_s agrees with the sensors", "close agreement",
            ", ".join(f"sensor {number}: {100 * each:.0f} %" for number, each in enumerate(apart, start=1)), "",
            Agreement.REPRODUCED if apart.min() < 0.1 else Agreement.NOT_REPRODUCED,
            "rms difference over rms of v_comp",
            kind=Evidence.OWN_DATA,
        ),
        Comparison(
            "ch4/figure 4.4/best match", "sensor 3", f"sensor {best}", "",
            Agreement.REPRODUCED if best == 3 else Agreement.NOT_REPRODUCED,
            f"sensors that move {', '.join(map(str, SHARES))} times as far as the tissue at the shaft (assumed)",
            kind=Evidence.ROUND_TRIP,
        ),
        Comparison(
            "ch4/figure 4.4/largest displacements", None,
            ", ".join(f"{np.ptp(sensor_mm) / 2:.1f}" for sensor_mm in loop.trial.sensors_mm), "mm", Agreement.OURS,
            "drawn in the thesis, not printed",
            kind=Evidence.OWN_DATA,
        ),
        Comparison(
            "ch4/section 4.3/less deformation at h = 40 mm", "yes", None, "", Agreement.IMPOSSIBLE,
            "the dependence of stiffness on the height of insertion is not published; here it would be an input",
            kind=Evidence.IMPOSSIBLE,
        ),
        Comparison(
            "ch4/section 4.3/agar moves too little for the tracker", "yes", None, "", Agreement.IMPOSSIBLE,
            "its displacement is not published; here the stiffness for a lag of 3 degrees gives millimetres",
            kind=Evidence.IMPOSSIBLE,
        ),
    ]  # fmt: skip


def draw_sensors(loop: FrictionLoop, file: Path) -> None:
    """Draw Figure 4.4: displacement and velocity of the tissue, and velocity of the needle relative to the tissue."""
    from matplotlib.figure import Figure

    seen = _seen(loop)
    figure = Figure(figsize=(9.0, 7.2), layout="constrained")
    displaced, moving, needle = figure.subplots(3, 1, sharex=True)
    colours = (ORANGE, GREEN, BLUE)
    tissue = np.where(seen.time_s < _SETTLING_S, np.nan, seen.tissue_mm_s)
    for number, colour in enumerate(colours):
        label = f"sensor {number + 1}"
        displaced.plot(seen.time_s, loop.trial.sensors_mm[number], color=colour, linewidth=1.0, label=label)
        moving.plot(seen.time_s, tissue[number], color=colour, linewidth=1.0, label=label)
        needle.plot(
            seen.time_s,
            seen.relative_mm_s[number],
            color=colour,
            linewidth=0.8,
            label=f"v_f - v of sensor {number + 1}",
        )
    needle.plot(seen.time_s, seen.fast_mm_s, color=BLACK, linewidth=1.0, linestyle="--", label="v_f, needle")
    needle.plot(seen.time_s, seen.slow_mm_s, color=VERMILLION, linewidth=1.4, label="v_s, slow observer")
    displaced.set_ylabel("displacement (mm)")
    moving.set_ylabel("velocity (mm/s)")
    needle.set_ylabel("velocity (mm/s)")
    needle.set_xlabel("time (s)")
    for axes, heading in ((displaced, "(a) tissue"), (moving, "(b) tissue"), (needle, "(c) needle against tissue")):
        title(axes, heading)
        axes.legend(frameon=False, fontsize=7.5, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    save(figure, file)


# Amplitude (mm) of the second trial, which only the full effort has.
_SECOND_AMPLITUDE_MM = 10.0


def tissue_rows(
    phantoms: Sequence[Phantom], cycles: float, rate_hz: float, note: Callable[[str], None], *, both: bool
) -> list[Comparison]:
    """Compare true, observed and fitted lag for each phantom. `both` adds a joint fit to trials of two amplitudes."""
    rows = []
    for phantom in phantoms:
        note(f"chapter 4: fitting {phantom.name}")
        trial = phantom.trial(cycles, rate_hz)
        observed = _observed(trial)
        records = [_punctual(trial.record)]
        fitted = [_fitted(phantom, records)]
        if both:
            records.append(_punctual(phantom.trial(cycles, rate_hz, _SECOND_AMPLITUDE_MM).record))
            fitted.append(_fitted(phantom, records))
        for amplitudes, (lag, sd, text) in zip(("40 mm", "40 and 10 mm"), fitted, strict=False):
            better = abs(lag - trial.lag_deg) <= abs(observed - trial.lag_deg)
            covered = abs(lag - trial.lag_deg) <= 2 * sd
            misses = "" if covered else "; its interval covers the noise only, and misses the truth"
            rows.append(
                Comparison(
                    f"ch4/ours/{phantom.name}, {amplitudes}", None,
                    f"true lag {trial.lag_deg:.2f} deg; observer {observed:.2f} deg; {text}", "",
                    Agreement.MET if better else Agreement.MISSED,
                    "goal: the fitted tissue (Model II, data from Model III-B) is closer to the truth than the observer"
                    + misses,
                    kind=Evidence.OWN_DATA,
                )
            )  # fmt: skip
    return rows


def _observed(trial: PhantomTrial) -> float:
    """Return the lag of the tuned slow observer (degrees); zero if the tuning finds no slow observer."""
    record = trial.record
    tuned = tune_slow_observer(record["time_s"], record["depth_mm"], record["force_n"])
    return float(np.degrees(tuned.projection.lag_rad(FREQUENCY_HZ))) if tuned.projection else 0.0


def _punctual(record: Record) -> Record:
    return record.with_column(
        "velocity_mm_s", velocity_without_delay(record["time_s"], record["depth_mm"]).velocity_mm_s
    )


def _fitted(phantom: Phantom, records: Sequence[Record]) -> tuple[float, float, str]:
    found = fit_on_tissue(records)
    lag, sd = (float(np.degrees(each)) for each in lag_with_sd(found, records[0], FREQUENCY_HZ))
    parts = []
    for symbol, name in (("k", "stiffness"), ("c", "damping")):
        each, true = found.estimates[name], getattr(phantom.model, name)
        parts.append(f"{symbol} {each.value:.3g} +- {each.sd:.2g} (true {true:g})")
    return lag, sd, f"fitted {lag:.2f} +- {sd:.2f} deg, {', '.join(parts)}, RMSE {1e3 * found.rmse:.1f} mN"
