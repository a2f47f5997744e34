"""`identify friction`: choice of a friction model, and its parameters, from recorded motion."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.identification._between_trials import with_scatter
from needleplan.identification._force_faults import without_faults
from needleplan.identification._identification import Finding, Identification, trials_by_role, undetermined
from needleplan.identification._moving_mass import FrictionOnSensor, moving_mass, on_sensor, stored, with_velocity
from needleplan.identification.friction_candidates import EXPONENTS, Mask, Score, candidates, fit_all, split
from needleplan.models import Fit, fit, residual_findings, simulate
from needleplan.models.friction import Friction, steady
from needleplan.plotting.canvas import BLUE, GREEN, GREY, ORANGE, VERMILLION, legend_below, title
from needleplan.signals import Array, Record, cycles

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["identify", "traded"]

_COLOURS = (BLUE, VERMILLION, GREEN, ORANGE)
_STYLES = ("-", "--", "-.", ":")

# Share of the variance of sigma2 explained by mu_c and alpha above which a remark reports the trade-off.
_TRADED = 0.95

# Relative range of the RMSE over the values of lambda below which a remark reports lambda as poorly determined.
_SAME_RMSE = 0.1


def identify(
    records: object,
    *,
    thickness_mm: float = 76.0,
    skip_cycles: int = 1,
    phases: Sequence[str] = (),
    exponents: Sequence[float] = EXPONENTS,
    models: Sequence[str] = (),
    smooth: Callable[[Array], Array] | None = None,
    mass: bool = False,
    offset: bool = False,
) -> Identification:
    """Fit friction models to records of a needle that moves in tissue, and choose one by Schwarz' criterion (BIC).

    Parameters
    ----------
    records : Record, table of columns such as a DataFrame, path of a data file, or list of these
        Trials with time_s, depth_mm and force_n, and velocity_mm_s if measured. Trials with the role holdout validate
        the models. Without such trials, the last cycle of each trial validates, and the chosen model is fitted again to
        all cycles.
    thickness_mm
        Thickness of the tissue. After the tip has left the tissue, the contact length is this thickness.
    skip_cycles
        Number of cycles that are masked at the beginning of each training trial; fewer if a trial has too few cycles.
    phases
        Phases of the trials that are used; all if empty.
    exponents
        Values of lambda for the models III-A and III-B.
    models
        Labels of the models to fit, of Karnopp, "Karnopp by direction", I, II, "II, Fn(L)", III-A, III-B; all if empty.
    smooth
        Filter of the force sensor, such as `MovingAverage(5).centred`. Without it, the fitted bristles are too soft,
        because a filtered force has smoother reversals.
    mass
        Whether to identify the moving mass together with the friction. The model has the effect `inertia` if the motion
        determines the mass; otherwise a remark gives the acceleration that would.
    offset
        Whether to identify an offset of the force sensor together with the friction. The model then has the effect
        `bias`, except where friction by direction is chosen, which takes up an offset.

    Returns
    -------
    Identification
        The model is a `Friction`, or an `AugmentedModel` of one; None if its fit did not converge.

    Raises
    ------
    DataError
        No trial has the role train, a column is missing, or `models` names no model.
    """
    trials = trials_by_role(records)
    holdout = trials.holdout
    train, faults = without_faults(trials.train)
    remarks = [*trials.remarks, *faults]
    raw = train
    if mass:
        train, holdout = (tuple(with_velocity(record) for record in some) for some in (train, holdout))
    mask: Mask = partial(steady, skip_cycles=_skipped(train, skip_cycles, remarks), phases=phases)
    chosen = candidates(train, exponents, models=models, thickness_mm=thickness_mm, reference_mm=thickness_mm)
    if not chosen:
        rule = "must be Karnopp, Karnopp by direction, I, II, III-B, or where the length varies, II, Fn(L) or III-A"
        raise DataError(Mistake("models", ", ".join(models), rule))
    if mass or offset:
        chosen = [on_sensor(candidate, mass=mass, offset=offset) for candidate in chosen]
    held_out = True
    if holdout:
        scores = fit_all(chosen, train, mask, holdout, partial(steady, skip_cycles=0), smooth)
        final = scores[0].fit
    else:
        before, last = split(mask)
        if not all(before(record).any() for record in train):
            remarks.append(
                "there is only one cycle: it is used for the fit, and nothing is held out; record at least two cycles"
            )
            before = last = mask
            held_out = False
        scores = fit_all(chosen, train, before, train, last, smooth)
        final = fit(scores[0].fit.model, train, free=scores[0].candidate.free, mask=mask, smooth=smooth)
    again = partial(fit, final.model, free=final.free, mask=mask, smooth=smooth)
    estimates = dict(final.estimates)
    if not mass:
        joint = with_scatter(final, train, smooth=smooth, mask=mask)
        final, remarks = joint.fit, [*remarks, *joint.remarks]
        estimates = dict(final.estimates)
    else:
        moved = moving_mass(final, raw, again)
        remarks += moved.remarks
        estimates = {"mass_kg": moved.estimate} | {
            name: estimate for name, estimate in estimates.items() if name != "mass_kg"
        }
        if not moved.estimate.identified:
            without = final.model.with_values(mass_kg=0.0)
            free = [name for name in final.free if name != "mass_kg"]
            final = fit(without, train, free=free, mask=mask, smooth=smooth)
        else:
            final = replace(final, estimates=estimates)
    model = stored(final) if mass or offset else final.model
    remarks += [_patch(train, final, thickness_mm), *_limits(scores, final)]
    return Identification(
        "friction", model if final.ok else None, estimates,
        tuple(_scores(scores, final, held_out)),
        (*_findings(scores, held_out), *residual_findings(final, train)), tuple(remarks),
        partial(_draw, records=train, scores=scores, mask=mask),
    )  # fmt: skip


def _skipped(train: Sequence[Record], skip_cycles: int, remarks: list[str]) -> int:
    """Return the number of cycles to skip: at most one less than the shortest trial has.

    Appends a remark if this is less than `skip_cycles`.
    """
    fewest = min(int(cycles(record.motion()).max()) for record in train)
    if fewest >= skip_cycles:
        return skip_cycles
    remarks.append(f"the shortest trial has {fewest + 1} cycles: {fewest} instead of {skip_cycles} are skipped")
    return fewest


def _patch(train: Sequence[Record], final: Fit, thickness_mm: float) -> str:
    """Return the remark about the assumed thickness and the inserted length, on which the parameters depend."""
    model = final.model.base if isinstance(final.model, FrictionOnSensor) else final.model
    assert isinstance(model, Friction)
    lengths = np.concatenate([model.inserted_mm(record.motion()) for record in train])
    return (
        f"assumed: the tissue is {thickness_mm:g} mm thick, with a normal force of {model.normal_force_n:g} N at that "
        f"length; the inserted length was {lengths.min():.0f} to {lengths.max():.0f} mm"
    )


def _scores(scores: Sequence[Score], final: Fit, held_out: bool) -> list[tuple[str, float, str]]:
    rows: list[tuple[str, float, str]] = [("RMSE of the model", final.rmse, "N"), ("samples", final.samples, "")]
    rows.append(("masked samples", final.masked, ""))
    for score in scores:
        rows.append((f"{score.candidate.label}: RMSE", score.fit.rmse, "N"))
        if held_out:
            rows.append((f"{score.candidate.label}: RMSE held out", score.held_out_rmse_n, "N"))
        rows.append((f"{score.candidate.label}: BIC above the best", score.bic - scores[0].bic, ""))
    return rows


def _findings(scores: Sequence[Score], held_out: bool) -> list[Finding]:
    best = scores[0]
    held = min(scores, key=lambda score: (math.isnan(score.held_out_rmse_n), score.held_out_rmse_n))
    same = held.candidate.label == best.candidate.label
    says = f"Schwarz' criterion selects {best.candidate.label}; the held-out error selects " + (
        "the same model" if same else f"{held.candidate.label} with {1e3 * held.held_out_rmse_n:.1f} mN"
    )
    if not held_out:
        says = f"Schwarz' criterion selects {best.candidate.label}; nothing is held out to confirm it"
    findings = [Finding("choice of the model", best.held_out_rmse_n if held_out else best.fit.rmse, None, says)]
    if len(scores) > 1:
        gap = scores[1].bic - best.bic
        strength = "decisive" if gap > 10 else "weak" if gap > 2 else "none"
        says = f"evidence against {scores[1].candidate.label}, the next best: {strength}"
        findings.append(Finding("gap to the next best", gap, None, says))
    return findings


def _limits(scores: Sequence[Score], final: Fit) -> list[str]:
    """Return remarks about parameters that the data do not determine."""
    remarks = undetermined({name: estimate for name, estimate in final.estimates.items() if name != "mass_kg"})
    remarks += final.trades
    if not final.ok:
        remarks.append(f"the fit of {scores[0].candidate.label} ended with: {final.status}")
    share = traded(final)
    if share > _TRADED:
        remarks.append(
            f"sigma2 and (mu_c, alpha) trade off: mu_c and alpha explain {100 * share:.0f} % of the variance of sigma2;"
            " a higher top speed would separate them"
        )
    averaged = [score for score in scores if hasattr(score.candidate.model, "exponent")]
    if len(averaged) > 1:
        errors = [score.fit.rmse for score in averaged]
        slopes = [score.fit.estimates["mu_c"].value for score in averaged]
        if max(errors) < (1 + _SAME_RMSE) * min(errors):
            remarks.append(
                f"lambda is poorly determined: over the values tried, the RMSE is {1e3 * min(errors):.1f} to "
                f"{1e3 * max(errors):.1f} mN, and mu_c {min(slopes):.2g} to {max(slopes):.2g}"
            )
    return remarks


def traded(found: Fit) -> float:
    """Return the share, 0 to 1, of the variance of sigma2 that mu_c and alpha explain.

    Returns 0 if the three were not fitted together, and 1 if their covariance is not finite.
    """
    if not {"sigma2", "mu_c", "alpha"} <= set(found.free):
        return 0.0
    rows = [found.free.index(name) for name in ("sigma2", "mu_c", "alpha")]
    covariance = found.covariance[np.ix_(rows, rows)]
    if not np.isfinite(covariance).all() or covariance[0, 0] <= 0:
        return 1.0
    scale = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(scale, scale)
    cross = correlation[0, 1:]
    return float(np.clip(cross @ np.linalg.pinv(correlation[1:, 1:]) @ cross, 0, 1))


def _draw(figure: Figure, records: Sequence[Record], scores: Sequence[Score], mask: Callable[[Record], Array]) -> None:
    """Draw force over velocity of the first record with the best model of each kind, and the best model's residual."""
    record, shown = records[0], _one_a_kind(scores)
    counts = mask(record)
    motion = record.motion()
    loops, left = figure.subplots(2, 1, gridspec_kw={"height_ratios": (3, 2)})
    loops.plot(
        motion.velocity_mm_s[counts], record["force_n"][counts], ".", color=GREY, markersize=2, alpha=0.6,
        label="measured", rasterized=True,
    )  # fmt: skip
    for rank, (score, colour, style) in enumerate(zip(shown, _COLOURS, _STYLES, strict=False)):
        force = simulate(score.fit.model, motion).output
        label = f"{_typeset(score.candidate.label)}, RMSE {1e3 * score.fit.rmse:.1f} mN"
        # The best model is drawn last, and the others are visible through it.
        order, width = 4 - 0.1 * rank, 1.0 + 0.6 * rank
        loops.plot(motion.velocity_mm_s[counts], force[counts], style, color=colour, linewidth=width, zorder=order,
                   label=label)  # fmt: skip
    loops.set_xlabel("velocity (mm/s)")
    loops.set_ylabel("axial force (N)")
    legend_below(loops)
    title(loops, f"{record.trial}: axial force over velocity".removeprefix(": "))
    best = scores[0]
    rest = 1e3 * (record["force_n"] - simulate(best.fit.model, motion).output)
    left.plot(motion.time_s, np.where(counts, rest, np.nan), color=_COLOURS[0], linewidth=0.5)
    left.axhline(0, color=GREY, linewidth=0.8)
    left.set_xlabel("time (s)")
    left.set_ylabel("residual (mN)")
    title(left, f"Measured minus simulated by {_typeset(best.candidate.label)}")


def _typeset(label: str) -> str:
    """Return the label of a candidate with its symbol as matplotlib typesets it."""
    return label.replace("lambda", r"$\lambda$ =")


def _one_a_kind(scores: Sequence[Score]) -> list[Score]:
    """Return the best score of each kind of model, best first, for at most four kinds."""
    kinds: dict[str, Score] = {}
    for score in scores:
        kinds.setdefault(score.candidate.label.split(",")[0], score)
    return list(kinds.values())[: len(_COLOURS)]
