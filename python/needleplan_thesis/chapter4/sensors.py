"""Figure 4.4: what sensors in the tissue say of its motion, beside the slow observer."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from needleplan.plotting import save
from needleplan.plotting.canvas import BLACK, BLUE, GREEN, ORANGE, VERMILLION, title
from needleplan.reports.comparison import Agreement, Comparison, measured
from needleplan.signals import Array, TrackerFilter, lag_rad
from needleplan_thesis.chapter4.loops import Loop
from needleplan_thesis.chapter4.phantoms import SHARES, Trial
from needleplan_thesis.chapter4.published import FREQUENCY_HZ, GELATIN, SENSOR_LAG_DEG

__all__ = ["draw_sensors", "sensor_rows"]

_DENSITY = 3.0
"""Driving noise of the tracker's filter, mm^2/s^5: jerks of 1 mm/s^3, as tissue at 0.1 Hz has, for a second or so."""

_SD_MM = 0.1
_SKIPPED_S = 2.0
_SETTLING_S = 0.5
"""While the filter of the trackers finds their velocity, it is not drawn."""


@dataclass(frozen=True)
class _Seen:
    """Velocities at the samples of the trackers; shape (3, samples) for the sensors."""

    time_s: Array
    tissue_mm_s: Array
    fast_mm_s: Array
    slow_mm_s: Array

    @property
    def relative_mm_s(self) -> Array:
        """Fast velocity of the needle less that of each sensor: v_comp of the thesis."""
        return np.asarray(self.fast_mm_s - self.tissue_mm_s)


def _seen(loop: Loop) -> _Seen:
    trial: Trial = loop.trial
    time, needle = trial.tracker_time_s, trial.motion.time_s
    filtered = TrackerFilter(_SD_MM, _DENSITY)
    tissue = np.array([filtered.apply(time, each).velocity_mm_s for each in trial.sensors_mm])
    fast, slow = (np.interp(time, needle, each) for each in (loop.fast_mm_s, loop.slow_mm_s))
    return _Seen(time, tissue, fast, slow)


def sensor_rows(loop: Loop) -> list[Comparison]:
    """Return lags of the sensors and how well the slow observer agrees with them."""
    seen = _seen(loop)
    counts = seen.time_s >= _SKIPPED_S
    relative = seen.relative_mm_s[:, counts]
    time, fast, slow = seen.time_s[counts], seen.fast_mm_s[counts], seen.slow_mm_s[counts]
    lags = [float(np.degrees(lag_rad(FREQUENCY_HZ, time, each, fast))) for each in relative]
    apart = np.sqrt(np.mean((relative - slow) ** 2, axis=1) / np.mean(relative**2, axis=1))
    best = int(np.argmin(apart)) + 1
    observed = float(np.degrees(loop.projection.lag_rad(FREQUENCY_HZ)))
    chosen = "the stiffness of the generator was chosen for this lag"
    return [
        measured("ch4/figure 4.4/lag of v_comp,3 behind v_f", SENSOR_LAG_DEG, lags[2], "deg", chosen),
        measured(
            "ch4/figure 4.4/observer less v_comp,3", round(GELATIN.lag_deg - SENSOR_LAG_DEG, 2), observed - lags[2],
            "deg", "the error of the method; its sign and size depend on how dry the friction is",
        ),
        Comparison(
            "ch4/figure 4.4/v_s agrees with the sensors", "close agreement",
            ", ".join(f"sensor {number}: {100 * each:.0f} %" for number, each in enumerate(apart, start=1)), "",
            Agreement.REPRODUCED if apart.min() < 0.1 else Agreement.NOT_REPRODUCED,
            "rms of the difference over rms of v_comp",
        ),
        Comparison(
            "ch4/figure 4.4/best match", "sensor 3", f"sensor {best}", "",
            Agreement.REPRODUCED if best == 3 else Agreement.NOT_REPRODUCED,
            f"sensors that move {', '.join(map(str, SHARES))} times as far as the tissue at the shaft: our assumption",
        ),
        Comparison(
            "ch4/figure 4.4/largest displacements", None,
            ", ".join(f"{np.ptp(each) / 2:.1f}" for each in loop.trial.sensors_mm), "mm", Agreement.OURS,
            "drawn in the thesis, not printed",
        ),
        Comparison(
            "ch4/section 4.3/less deformation at h = 40 mm", "yes", None, "", Agreement.IMPOSSIBLE,
            "how stiffness depends on the height of insertion is not published, and is an input here",
        ),
        Comparison(
            "ch4/section 4.3/agar moves too little for the tracker", "yes", None, "", Agreement.IMPOSSIBLE,
            "how far it moved is not published; stiffness that gives the lag of 3 degrees moves it by millimetres here",
        ),
    ]  # fmt: skip


def draw_sensors(loop: Loop, file: Path) -> None:
    """Draw displacements, velocities of the tissue, and velocities of the needle."""
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
