"""What the slow observer and the fit of the tissue make of phantoms of known stiffness; nothing of it was published."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from needleplan.models.tissue import fit_on_tissue, lag_with_sd, tune_slow_observer
from needleplan.reports.comparison import Agreement, Comparison
from needleplan.signals import Record, velocity_without_delay
from needleplan_thesis.chapter4.phantoms import Phantom, Trial
from needleplan_thesis.chapter4.published import FREQUENCY_HZ

__all__ = ["tissue_rows"]

_SECOND_AMPLITUDE_MM = 10.0


def tissue_rows(
    phantoms: Sequence[Phantom], cycles: float, rate_hz: float, note: Callable[[str], None], *, both: bool
) -> list[Comparison]:
    """Return true, observed and fitted lag for each phantom; with `both` also from a second amplitude."""
    rows = []
    for phantom in phantoms:
        note(f"chapter 4: fitting {phantom.name}")
        trial = phantom.trial(cycles, rate_hz)
        observed = _observed(trial)
        records = [_punctual(trial.record)]
        told = [_fitted(phantom, records)]
        if both:
            records.append(_punctual(phantom.trial(cycles, rate_hz, _SECOND_AMPLITUDE_MM).record))
            told.append(_fitted(phantom, records))
        for amplitudes, (lag, sd, text) in zip(("40 mm", "40 and 10 mm"), told, strict=False):
            better = abs(lag - trial.lag_deg) <= abs(observed - trial.lag_deg)
            held = abs(lag - trial.lag_deg) <= 2 * sd
            misses = "" if held else "; its interval, of the noise alone, misses the truth"
            rows.append(
                Comparison(
                    f"ch4/ours/{phantom.name}, {amplitudes}", f"true lag {trial.lag_deg:.2f} deg",
                    f"observer {observed:.2f} deg; {text}", "", Agreement.MET if better else Agreement.MISSED,
                    "goal: the fitted tissue (Model II, data of Model III-B) is nearer to the truth than the observer"
                    + misses,
                )
            )  # fmt: skip
    return rows


def _observed(trial: Trial) -> float:
    """Return the lag that the tuning says; zero where it says that there is nothing to compensate."""
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
