"""Comparisons of the observers that need no data: equations (4.1) to (4.3), and the numbers of Figure 4.6."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.optimize import brentq

from needleplan.plotting import save
from needleplan.plotting.canvas import BLUE, GREEN, ORANGE, title
from needleplan.reports.comparison import Agreement, Comparison, Evidence, measured
from needleplan.signals import FAST_ALPHA1, HighGainObserver, ObserverForm, Projection, sinusoid
from needleplan_thesis.chapter4.phantoms import AGAR, FAST, FREQUENCY_HZ, GELATIN, Tuned

__all__ = ["draw_bode", "response"]

# Candidates for the unpublished sampling interval (s); the tracker has 25 ms.
_INTERVALS_S = (0.001, 0.005, 0.025)

# Epsilon for which the printed equations differ from the correct ones; at 1 they agree.
_EPSILON = 0.5

# alpha1 of the curves of Figure 4.6 (1/s).
_ALPHAS = (5.0, GELATIN.alpha1, AGAR.alpha1)


def response() -> list[Comparison]:
    """Return the comparisons of all equations, of the printed attenuations and lags, and of Figure 4.6."""
    return [
        *_damping(),
        *_equations(),
        *(each for tuned in (GELATIN, AGAR) for each in _at_a_tenth_of_a_hertz(tuned)),
        _monotone(),
        *_inverse(),
    ]


def draw_bode(folder: Path) -> None:
    """Draw Figure 4.6 into a folder."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    magnitude, phase = figure.subplots(1, 2)
    frequency = np.geomspace(0.01, 99.0, 500)
    for alpha1, colour in zip(_ALPHAS, (ORANGE, BLUE, GREEN), strict=True):
        gain = Projection.critically_damped(alpha1, 0.005).transfer.response(frequency)
        label = f"alpha1 = {alpha1:g}"
        magnitude.semilogx(frequency, 20 * np.log10(np.abs(gain)), color=colour, label=label)
        phase.semilogx(frequency, np.degrees(np.angle(gain)), color=colour, label=label)
    for axes, heading, unit in ((magnitude, "(a) magnitude", "|H| (dB)"), (phase, "(b) phase", "phase of H (deg)")):
        axes.axvline(FREQUENCY_HZ, color="#8c8c8c", linewidth=0.8, linestyle=":")
        axes.set_xlabel("frequency (Hz)")
        axes.set_ylabel(unit)
        title(axes, heading)
    magnitude.annotate(
        "0.1 Hz", (FREQUENCY_HZ, magnitude.get_ylim()[0]), (3, 4), textcoords="offset points", fontsize=8
    )
    magnitude.legend(frameon=False, fontsize=8)
    save(figure, folder / "figure_4_6.png")


def _damping() -> list[Comparison]:
    rows = [("fast", *FAST), ("gelatin", GELATIN.alpha1, GELATIN.alpha2), ("agar", AGAR.alpha1, AGAR.alpha2)]
    return [
        Comparison(
            f"ch4/section 4.3/alpha2 of the critically damped observer, {name}", alpha2,
            HighGainObserver.critically_damped(alpha1, 0.005).alpha2, "1/s^2",
            Agreement.REPRODUCED if alpha1**2 / 4 == alpha2 else Agreement.DIFFERS,
            kind=Evidence.ARITHMETIC,
        )
        for name, alpha1, alpha2 in rows
    ]  # fmt: skip


def _equations() -> list[Comparison]:
    depth = sinusoid(offset_mm=100, amplitude_mm=40, frequency_hz=FREQUENCY_HZ, cycles=1).depth_mm
    frequency = np.geomspace(0.01, 50, 60)
    rows = []
    for epsilon in (1.0, _EPSILON):
        right = HighGainObserver(*FAST, 0.005, epsilon)
        printed = HighGainObserver(*FAST, 0.005, epsilon, ObserverForm.PRINTED)
        gain, wrong = (each.transfer.response(frequency) for each in (right, printed))
        apart = float(np.max(np.abs(wrong / gain - 1)))
        recursion = float(np.max(np.abs(right.observe(depth) - right.transfer.apply(depth))))
        rows.append(
            Comparison(
                f"ch4/equation 4.2/transfer function of the recursion, epsilon {epsilon:g}",
                "(4.2) for any epsilon", f"(4.2) is off by up to {100 * apart:.2g} %; "
                f"the corrected one by {recursion:.1g} mm/s", "",
                Agreement.REPRODUCED if apart < 1e-9 else Agreement.NOT_REPRODUCED,
                "" if apart < 1e-9 else "(4.1) and (4.2) divide alpha2 by epsilon once; the observer divides it twice",
                kind=Evidence.COMPUTED,
            )
        )  # fmt: skip
    longest = HighGainObserver.critically_damped(FAST_ALPHA1, 0.005).longest_interval_s
    rows.append(
        Comparison(
            "ch4/equation 4.1/stable below", None, longest, "s", Agreement.OURS, "fast observer", kind=Evidence.COMPUTED
        )
    )
    return rows


def _at_a_tenth_of_a_hertz(tuned: Tuned) -> list[Comparison]:
    rows = []
    name = f"ch4/figure 4.6/{tuned.phantom}"
    for interval in _INTERVALS_S:
        projection = Projection.critically_damped(tuned.alpha1, interval)
        lost = 100 * float(projection.attenuation(FREQUENCY_HZ))
        late = float(np.degrees(projection.lag_rad(FREQUENCY_HZ)))
        at = f"{1e3 * interval:g} ms"
        rows += [
            measured(
                f"{name}/attenuation at 0.1 Hz, {at}", tuned.attenuation_percent, round(lost, 3), "%",
                "the sampling interval is not printed; 25 ms, that of the tracker, agrees best",
                kind=Evidence.COMPUTED,
            ),
            measured(
                f"{name}/lag at 0.1 Hz, {at}", tuned.lag_deg, round(late, 3), "deg",
                "no sampling interval gives the printed phase; 0.1005 to 0.1017 Hz instead of 0.1 Hz would",
                kind=Evidence.COMPUTED,
            ),
        ]  # fmt: skip

    def excess(interval: float) -> float:
        return 100 * float(Projection.critically_damped(tuned.alpha1, interval).attenuation(FREQUENCY_HZ)) - (
            tuned.attenuation_percent
        )

    implied = 1e3 * float(brentq(excess, 1e-3, 0.1))
    why = "both attenuations imply nearly the same interval; of the named rates, 40 Hz (tracker, 25 ms) is nearest"
    rows.append(
        Comparison(
            f"{name}/interval that the attenuation implies",
            None,
            implied,
            "ms",
            Agreement.OURS,
            why,
            kind=Evidence.COMPUTED,
        )
    )
    return rows


def _monotone() -> Comparison:
    alphas = np.arange(2.0, 40.0)
    pairs = [Projection.critically_damped(each, 0.005) for each in alphas.tolist()]
    lost = np.array([float(pair.attenuation(FREQUENCY_HZ)) for pair in pairs])
    late = np.array([float(pair.lag_rad(FREQUENCY_HZ)) for pair in pairs])
    holds = bool((np.diff(lost) < 0).all() and (np.diff(late) < 0).all())
    computed = f"at each of {alphas.size} values" if holds else "no"
    return Comparison(
        "ch4/figure 4.6/a smaller alpha1 attenuates and delays more", "yes", computed, "",
        Agreement.REPRODUCED if holds else Agreement.NOT_REPRODUCED,
        kind=Evidence.QUALITATIVE,
    )  # fmt: skip


def _inverse() -> list[Comparison]:
    velocity = np.random.default_rng(4).normal(0, 10, 4000)
    rows = []
    for tuned in (GELATIN, AGAR):
        projection = Projection.critically_damped(tuned.alpha1, 0.005)
        back = projection.inverse.apply(projection.transfer.apply(velocity))
        error = float(np.max(np.abs(back - velocity)))
        causal = projection.transfer.minimum_phase
        rows += [
            Comparison(
                f"ch4/equation 4.3/{tuned.phantom}/back to the fast velocity", "inverse z-transform",
                f"causal and stable, round trip {error:.1g} mm/s", "",
                Agreement.REPRODUCED if causal and error < 1e-8 else Agreement.NOT_REPRODUCED,
                "a round trip does not test the friction model, because the fast velocity is known",
                kind=Evidence.ROUND_TRIP,
            ),
            Comparison(
                f"ch4/equation 4.3/{tuned.phantom}/gain of the inverse at Nyquist", None,
                float(np.abs(projection.inverse.response(100.0))), "", Agreement.OURS,
                "amplification of noise in v_s",
                kind=Evidence.COMPUTED,
            ),
        ]  # fmt: skip
    return rows
