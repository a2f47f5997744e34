"""Table 3.6 and Fig. 3.6: friction predicted with the tip inside the tissue, and the remaining cutting force.

The synthetic measurement is Model III-B with the inserted length, plus effects that no friction model contains.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from needleplan.models import AveragedLuGre, Model, Profile, cutting_force, into_fresh_tissue, simulate
from needleplan.models.friction import Friction
from needleplan.plotting import caption, save
from needleplan.plotting.canvas import BLUE, GREY, ORANGE, SKY, VERMILLION, title
from needleplan.reports.comparison import Agreement, Comparison, Evidence, measured
from needleplan.signals import Array, Motion, Record, Start, sinusoid
from needleplan_thesis.chapter3.fits import NOISE_N, Generator, generated, recorded
from needleplan_thesis.chapter3.published import CASES, NEEDLE_MASS_KG, TABLE_3_6, model_i, model_ii, model_iii_b

__all__ = ["InsideRecord", "draw_prediction", "inside", "prediction", "predictors"]

# Motion: depth of the middle of the stroke, and amplitude (mm).
_MIDDLE_MM, _AMPLITUDE_MM = 38.0, 25.0

# Cutting of fresh tissue: force at rest (N), and its increase with the velocity (N s/mm).
_CUTTING_N, _CUTTING_PER_MM_S = 0.10, 0.01

# Minor cutting: force (N), mean rate (1/s), and duration (s).
_MINOR_N, _MINOR_PER_S, _MINOR_S = 0.06, 0.15, 1.0

# Air bubbles: number, standard deviation of the force (N), and width (mm).
_BUBBLES, _BUBBLE_N, _BUBBLE_MM = 20, 0.05, 1.5

_HIDDEN = (
    "data from III-B with the inserted length, and effects that no friction model has: cutting (excluded), minor "
    "cutting, air bubbles, noise; their amplitudes are assumed"
)
_FROZEN = "errors like the printed ones need Fn frozen at the length in the middle of the stroke, which the text omits"
_CASES = "cases 1 and 2 are needles A and B in tissue A, by Fig. 3.6 and Table 3.1, not tissues A and B"


@dataclass(frozen=True)
class InsideRecord:
    """A record with the tip inside the tissue, with the true friction and cutting force (N).

    `major` is a mask of major cutting: the samples at which the tip cuts fresh tissue.
    """

    case: int
    profile: str
    record: Record
    friction_n: Array
    cutting_n: Array
    major: NDArray[np.bool_]

    @property
    def motion(self) -> Motion:
        """The motion of the needle."""
        return self.record.motion()

    def error_mn(self, model: Model) -> float:
        """Return the RMSE (mN) of the force that `model` predicts, without the samples of major cutting."""
        error = self.record["force_n"] - simulate(model, self.motion).output
        return 1e3 * float(np.sqrt(np.mean(error[~self.major] ** 2)))


def inside(case: int, profile: str, hidden: bool = True, rate_hz: float = 200.0, seed: int = 0) -> InsideRecord:
    """Simulate four cycles about the middle of the phantom, and return the record.

    The motion begins with an insertion (profile `solid`) or a retraction (`dashed`), as in Fig. 3.4(b). `hidden` adds
    to the friction of Model III-B:

    - major cutting, of fresh tissue: 0.10 N + 0.01 N s/mm times the velocity
    - minor cutting during insertion without major cutting: 60 mN for 1 s, at random times, on average 0.15 per second
    - 20 air bubbles at random depths, with a width of 1.5 mm and a standard deviation of 50 mN
    - noise of 15 mN
    """
    motion = sinusoid(
        offset_mm=_MIDDLE_MM, amplitude_mm=_AMPLITUDE_MM, frequency_hz=CASES[case].frequency_hz, rate_hz=rate_hz,
        start=Start.MIDDLE, outward=profile == "dashed",
    )  # fmt: skip
    random = np.random.default_rng((seed, case, profile == "dashed"))
    friction = generated(case, Generator.III_B, motion)
    major = into_fresh_tissue(motion)
    cutting, other = np.zeros(len(motion)), np.zeros(len(motion))
    if hidden:
        cutting = np.where(major, _CUTTING_N + _CUTTING_PER_MM_S * motion.velocity_mm_s, 0.0)
        starts = random.random(len(motion)) < _MINOR_PER_S / rate_hz
        minor = np.convolve(starts, np.ones(round(_MINOR_S * rate_hz)))[: len(motion)] > 0
        cutting += np.where(minor & (motion.velocity_mm_s > 0) & ~major, _MINOR_N, 0.0)
        places = random.uniform(0, _MIDDLE_MM + _AMPLITUDE_MM, _BUBBLES)
        sizes = random.normal(0, _BUBBLE_N, _BUBBLES)
        bumps = np.exp(-(((motion.depth_mm[:, None] - places) / _BUBBLE_MM) ** 2))
        other = np.sign(motion.velocity_mm_s) * (bumps @ sizes)
    record = recorded(motion, friction + cutting + other, seed, NOISE_N if hidden else 0.0)
    return InsideRecord(case, profile, record, friction, cutting, major)


def predictors(case: int) -> dict[str, Friction]:
    """Return the models with the printed parameters, by label.

    Models I and II are returned twice: with the normal force Fn at the middle of the stroke, and with Fn = 1 N. Model
    II is also returned with Fn as a function of the inserted length L.
    """
    three = model_iii_b(case)
    middle = Motion.sampled(np.arange(2.0), np.full(2, _MIDDLE_MM))
    frozen = float(three.total_normal_force_n(middle)[0])
    return {
        "I": model_i(case).with_values(normal_force_n=frozen),
        "II": model_ii(case).with_values(normal_force_n=frozen),
        "III-A": AveragedLuGre(**{**vars(three), "profile": Profile.RIGHT}),
        "III-B": three,
        "I, Fn = 1 N": model_i(case),
        "II, Fn = 1 N": model_ii(case),
        "II, Fn(L)": type(model_ii(case))(**{**vars(model_ii(case)), "profile": Profile.ISOSCELES}),
    }


def prediction(folder: Path | None, note: Callable[[str], None], rate_hz: float) -> list[Comparison]:
    """Compare Table 3.6 with errors computed with and without hidden effects, and list errors of the cutting force.

    Draws Fig. 3.6 if a folder is given.
    """
    note("friction: prediction with the tip inside the tissue")
    rows, cutting, drawn = [], [], []
    for profile, printed in TABLE_3_6.items():
        for case in (1, 2):
            insertion = inside(case, profile, rate_hz=rate_hz)
            clean = inside(case, profile, hidden=False, rate_hz=rate_hz)
            models = predictors(case)
            errors = {label: insertion.error_mn(model) for label, model in models.items()}
            undisturbed = {label: clean.error_mn(model) for label, model in models.items()}
            for label in models:
                rows += _rows(profile, case, label, printed, errors[label], undisturbed[label])
            better = max(errors["III-A"], errors["III-B"]) < min(errors["I"], errors["II"])
            rows.append(Comparison(
                f"ch3/Table 3.6/{profile}, case {case}: both Models III better than I and II", "yes",
                "yes" if better else "no", "", Agreement.REPRODUCED if better else Agreement.NOT_REPRODUCED,
                "Fn(L) makes the difference: Model II with it is as good"
                if errors["II, Fn(L)"] < min(errors["I"], errors["II"]) else "",
                kind=Evidence.OWN_DATA,
            ))  # fmt: skip
            cutting.append(_cutting(insertion, models["III-B"]))
            if case == 2:
                drawn.append(insertion)
    if folder:
        models = predictors(2)
        shown = {label: models[label] for label in ("II", "III-B", "III-A")}
        draw_prediction(
            [(each.profile, each.record, each.major) for each in drawn], shown,
            folder / "fig_3_6_prediction.png",
        )  # fmt: skip
    return [*rows, *cutting]


def _rows(
    profile: str, case: int, label: str, printed: dict[str, tuple[float, float]], error: float, undisturbed: float
) -> list[Comparison]:
    """Compare one cell of Table 3.6 with the computed error; also list the error without hidden effects."""
    identity = f"ch3/Table 3.6/{profile}, case {case}, {label}"
    reason = f"{_HIDDEN}; {_CASES}"
    plain = Comparison(
        f"{identity}, no hidden effects", None, undisturbed, "mN", Agreement.OURS, kind=Evidence.OWN_DATA
    )
    if label not in printed:
        return [Comparison(identity, None, error, "mN", Agreement.OURS, reason, kind=Evidence.OWN_DATA), plain]
    if label in ("I", "II"):
        reason = f"{_FROZEN}; {reason}"
    return [measured(identity, printed[label][case - 1], error, "mN", reason, kind=Evidence.OWN_DATA), plain]


def _cutting(insertion: InsideRecord, friction: Friction) -> Comparison:
    """Return the RMS error of the estimated cutting force, measured - friction - inertia, during major cutting."""
    mass = NEEDLE_MASS_KG[CASES[insertion.case].needle]
    parts = cutting_force(insertion.record, friction, mass)
    error = (parts.cutting_n - insertion.cutting_n)[insertion.major]
    true = insertion.cutting_n[insertion.major]
    return Comparison(
        f"ch3/section 3.4.2/error of the cutting force, {insertion.profile}, case {insertion.case}", None,
        1e3 * float(np.sqrt(np.mean(error**2))), "mN", Agreement.OURS,
        f"measured - friction (III-B) - inertia, while fresh tissue is cut with {1e3 * true.mean():.0f} mN on average; "
        f"inertia at most {1e3 * np.abs(parts.inertia_n).max():.2f} mN; bubbles and noise remain",
        kind=Evidence.OWN_DATA,
    )  # fmt: skip


_COLOURS = (VERMILLION, BLUE, ORANGE)


def draw_prediction(
    records: Sequence[tuple[str, Record, NDArray[np.bool_]]], models: Mapping[str, Model], file: Path
) -> None:
    """Draw Fig. 3.6: one panel per (name, record, mask of major cutting), with the predicted forces of the models."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 5.6), layout="constrained")
    every = figure.subplots(len(records), 1, sharex=True, squeeze=False).flat
    for axes, (name, record, major) in zip(every, records, strict=True):
        motion = record.motion()
        axes.plot(motion.time_s, record["force_n"], color=GREY, linewidth=0.6, label="synthetic measurement")
        for (label, model), colour in zip(models.items(), _COLOURS, strict=True):
            style = "--" if label == "III-A" else "-"
            shown = f"Model {label}" + (", Fn frozen" if label == "II" else "")
            axes.plot(motion.time_s, simulate(model, motion).output, style, color=colour, linewidth=1.0, label=shown)
        low, high = axes.get_ylim()
        axes.fill_between(
            motion.time_s, low, high, where=major, color=SKY, alpha=0.25, linewidth=0, label="fresh tissue"
        )
        axes.set_ylim(low, high)
        axes.set_ylabel("axial force (N)")
        title(axes, f"{name} profile")
    axes.set_xlabel("time (s)")
    handles = axes.get_legend_handles_labels()
    figure.legend(*handles, loc="outside upper right", ncols=5, frameon=False, fontsize=8)
    caption(
        figure,
        "Fig. 3.6: needle B in tissue A, 0.08 Hz, 25 mm, tip inside. The measurement is Model III-B with the inserted "
        "length, plus cutting, minor cutting, air bubbles and noise of assumed amplitudes.",
    )
    save(figure, file)
