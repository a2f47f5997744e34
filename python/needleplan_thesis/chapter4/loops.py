"""Figures 4.3 and 4.5: the loop of friction and velocity, before and after compensation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from needleplan.models import LumpedLuGre, fit, simulate
from needleplan.models.tissue import SlowObserver, tissue_start, tune_slow_observer
from needleplan.plotting import save
from needleplan.plotting.canvas import BLUE, GREY, VERMILLION, title
from needleplan.reports.comparison import Agreement, Comparison, Evidence, measured
from needleplan.signals import Array, Motion, MovingAverage, Projection, Record
from needleplan_thesis.chapter4.phantoms import FREQUENCY_HZ, PhantomTrial, Tuned

__all__ = ["FrictionLoop", "compensated", "draw_loops", "loop_rows"]

# Initial part of a trial that is excluded from all errors (s).
_SKIPPED_S = 1.0

# Ratio of two errors below which the first error counts as clearly smaller.
_CLEARLY = 0.8

_TUNING = "the phantom is assumed; the thesis tunes by hand, the computation by the gap at zero force"


@dataclass(frozen=True)
class FrictionLoop:
    """A trial with the velocities of the fast and of the slow observer, and Model II fitted with each velocity.

    - `tuned`: result of tuning the slow observer to the trial
    - `projection`: fast and slow observer; if the tuning finds no slow observer, that of the thesis is used
    - `fast_mm_s`, `slow_mm_s`: velocity v_f of the fast and v_s of the slow observer
    - `over_fast_n`, `over_slow_n`: force of Model II fitted with v_f and with v_s
    """

    trial: PhantomTrial
    tuned: SlowObserver
    projection: Projection
    fast_mm_s: Array
    slow_mm_s: Array
    over_fast_n: Array
    over_slow_n: Array

    @property
    def counted(self) -> Array:
        """Mask of the samples that errors include: all but the first second."""
        return np.asarray(self.trial.motion.time_s >= _SKIPPED_S)

    def rmse_n(self, simulated: Array) -> float:
        """Return the RMSE (N) of a simulated force relative to the measured force."""
        left = (self.trial.record["force_n"] - simulated)[self.counted]
        return float(np.sqrt(np.mean(left**2)))

    @property
    def vs_error(self) -> float:
        """RMS error of v_s divided by the RMS of the true velocity.

        The true velocity is that of the needle relative to the tissue, filtered by the fast observer.
        """
        return self._error(self.slow_mm_s)

    @property
    def vf_error(self) -> float:
        """RMS error of v_f, which has no compensation, divided by the RMS of the true velocity (see `vs_error`)."""
        return self._error(self.fast_mm_s)

    def _error(self, velocity: Array) -> float:
        true = self.projection.fast.normalised.apply(self.trial.relative_mm_s)[self.counted]
        return float(np.sqrt(np.mean((velocity[self.counted] - true) ** 2) / np.mean(true**2)))


def compensated(trial: PhantomTrial, slow_alpha1: float) -> FrictionLoop:
    """Tune the slow observer to a trial, and fit Model II with the velocities of the fast and the slow observer.

    If the tuning finds no slow observer, a critically damped one with `slow_alpha1` (1/s) is used.
    """
    record = trial.record
    tuned = tune_slow_observer(record["time_s"], record["depth_mm"], record["force_n"])
    interval = float(record["time_s"][1] - record["time_s"][0])
    projection = tuned.projection or Projection.critically_damped(slow_alpha1, interval)
    fast = projection.fast.observe(record["depth_mm"])
    slow = projection.transfer.apply(fast)
    forces = [_fitted(record, velocity) for velocity in (fast, slow)]
    return FrictionLoop(trial, tuned, projection, fast, slow, *forces)


def _fitted(record: Record, velocity: Array) -> Array:
    """Fit Model II to the force of a record with a filtered velocity, as in the thesis; return the fitted force (N)."""
    seen = record.with_column("velocity_mm_s", velocity)
    first = tissue_start(record)
    names = ("sigma0", "sigma1", "sigma2", "mu_c", "mu_s", "alpha")
    start = LumpedLuGre(**{name: getattr(first, name) for name in names})
    average = MovingAverage(5).apply
    found = fit(start, seen, smooth=average, mask=lambda each: each["time_s"] >= _SKIPPED_S, starts=3, spread=0.7)
    motion = Motion.sampled(seen["time_s"], seen["depth_mm"], velocity)
    return average(simulate(found.model, motion).output)


def loop_rows(loop: FrictionLoop, tuned: Tuned, figure: str) -> list[Comparison]:
    """Compare alpha1 and the quality of the fits with the thesis, and list the errors of the velocities."""
    name = f"ch4/{figure}/{tuned.phantom}"
    rows = []
    if loop.tuned.alpha1 is None:
        words = f"{loop.tuned.status}, the fast velocity is used"
        why = (
            f"the damping of the bristles closes the loop of a stiff phantom, so no slow observer is needed; {_TUNING}"
        )
        rows.append(
            Comparison(
                f"{name}/alpha1 of the slow observer",
                tuned.alpha1,
                words,
                "1/s",
                Agreement.DIFFERS,
                why,
                kind=Evidence.OWN_DATA,
            )
        )
    else:
        late = float(np.degrees(loop.projection.lag_rad(FREQUENCY_HZ)))
        rows += [
            measured(f"{name}/alpha1 of the slow observer", tuned.alpha1, loop.tuned.alpha1, "1/s", _TUNING,
                     kind=Evidence.OWN_DATA),
            Comparison(
                f"{name}/lag of the slow observer less the true one", None, late - loop.trial.lag_deg, "deg",
                Agreement.OURS, "the true lag is known from the simulation; no sensor of the thesis measures it",
                kind=Evidence.OWN_DATA,
            ),
        ]  # fmt: skip
    before, after = 1e3 * loop.rmse_n(loop.over_fast_n), 1e3 * loop.rmse_n(loop.over_slow_n)
    holds = loop.tuned.alpha1 is not None and after < _CLEARLY * before
    rows += [
        Comparison(
            f"{name}/Model II fits over v_s and not over v_f", "yes",
            f"RMSE {before:.1f} mN over v_f, {after:.1f} mN over v_s", "",
            Agreement.REPRODUCED if holds else Agreement.NOT_REPRODUCED,
            "holds if the second error is below 0.8 of the first; the noise contributes 4 mN",
            kind=Evidence.OWN_DATA,
        ),
        Comparison(
            f"{name}/error of the velocity against the tissue", None,
            f"{100 * loop.vf_error:.1f} % with v_f, {100 * loop.vs_error:.1f} % with v_s", "", Agreement.OURS,
            "rms error over rms of the true velocity, which is filtered by the fast observer",
            kind=Evidence.OWN_DATA,
        ),
    ]  # fmt: skip
    return rows


def draw_loops(loop: FrictionLoop, tuned: Tuned, file: Path) -> None:
    """Draw the friction over v_f and over v_s. In the first panel, 1/H maps the velocity of the fit back to v_f."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    shown, force = loop.counted, loop.trial.record["force_n"]
    back = loop.projection.inverse.apply(loop.slow_mm_s)
    slow = loop.projection.slow.alpha1
    panels = (
        (loop.fast_mm_s, back, "fast velocity v_f (mm/s)", f"(a) {tuned.phantom}, mapped back by 1/H"),
        (
            loop.slow_mm_s,
            loop.slow_mm_s,
            "slow velocity v_s (mm/s)",
            f"(b) over the slow observer, alpha1 = {slow:.1f}",
        ),
    )
    for each, (velocity, mapped, label, heading) in zip(axes, panels, strict=True):
        each.axhline(0, color=GREY, linewidth=0.6)
        each.axvline(0, color=GREY, linewidth=0.6)
        each.plot(velocity[shown], force[shown], ".", color=BLUE, markersize=1.5, alpha=0.5, label="synthetic trial")
        each.plot(mapped[shown], loop.over_slow_n[shown], color=VERMILLION, linewidth=1.0, label="Model II over v_s")
        each.set_xlabel(label)
        title(each, heading)
    axes[0].set_ylabel("axial force (N)")
    axes[0].legend(frameon=False, fontsize=8, loc="upper left", markerscale=4)
    save(figure, file)
