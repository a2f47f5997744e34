"""Choice of a relaxing force: number of capsules, a layer, and number of Maxwell branches.

Members are fitted in this order:

1. the spring with friction,
2. with the largest 1 to 4 sudden drops of the force as capsules, each with a stiffness of the tissue beyond,
3. the best of these with one and with two branches, if the motion can show a relaxation,
4. the same again with a layer that begins without a drop.

With held-out trials, the member with the fewest parameters is chosen whose held-out RMSE is at most `_GAIN` above the
smallest. Without them, Schwarz' criterion (BIC) with the effective number of samples chooses.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.identification._between_trials import with_scatter
from needleplan.identification._force_figure import draw_force
from needleplan.identification._force_record import Drop, force_drops
from needleplan.identification._identification import Finding, Identification, Trials, averaged, undetermined
from needleplan.identification.friction_candidates import Mask, effective_samples, rmse_n
from needleplan.models import Fit, FitStatus, RelaxingForce, fit, residual_findings
from needleplan.models.force import BOUNDARIES
from needleplan.signals import Array, MovingAverage, Record

__all__ = ["Member", "can_relax", "choose_member", "fit_members", "identify_relaxing"]

# Share by which the held-out RMSE of a member with fewer parameters may be larger than the smallest.
_GAIN = 0.02
# Share of the range of the force that counts as a capsule, if the force drops by it within this travel (mm).
_DROP, _DROP_MM = 0.15, 2.0
# Smallest distance of two capsules (mm).
_APART_MM = 1.0
# Share of the range of the force that counts as contact.
_CONTACT = 0.03
# Starts of the growth of the stiffness (1/mm), and places of the layer as shares of the depth.
_GROWTHS, _PLACES = (0.03, 0.4), (0.3, 0.6)
# Stiffness and time constant (s) from which the first and the second branch are fitted. Starts near 0 keep the fit at
# least as good as without the branch.
_BRANCHES = (((0.5, 0.3), (0.02, 3.0)), ((0.5, 10.0), (0.02, 0.3)))
# Largest number of evaluations of one fit.
_EVALUATIONS = 60
# Duration of a dwell (s), and ratio of two speeds, that show a relaxation.
_DWELL_S, _SPEEDS = 0.5, 1.5


@dataclass(frozen=True)
class Member:
    """A fitted model of the family: label, fit, RMSE on held-out trials (N; NaN without such trials), and BIC."""

    label: str
    fit: Fit
    held_out_rmse_n: float
    bic: float

    @property
    def model(self) -> RelaxingForce:
        """The fitted model."""
        assert isinstance(self.fit.model, RelaxingForce)
        return self.fit.model


@dataclass
class _Fitter:
    """Fits members to `train` and scores them on `held`."""

    train: Sequence[Record]
    held: Sequence[Record]
    mask: Mask
    held_mask: Mask
    smooth: Callable[[Array], Array] | None

    def best(self, label: str, starts: Sequence[RelaxingForce], free: tuple[str, ...]) -> Member:
        """Return the member with the smallest residual over several starts."""
        fits = [_fitted(self, start, free) for start in starts]
        best = min(fits, key=lambda candidate: candidate.rmse)
        held = rmse_n(best.model, self.held, self.held_mask, self.smooth) if self.held else math.nan
        return Member(label, best, held, math.nan)


def _fitted(fitter: _Fitter, start: RelaxingForce, free: tuple[str, ...]) -> Fit:
    return fit(
        start, fitter.train, free=free, mask=fitter.mask, smooth=fitter.smooth, max_evaluations=_EVALUATIONS,
    )  # fmt: skip


def choose_member(members: Sequence[Member]) -> Member:
    """Choose the member with the fewest parameters of those with about the least held-out RMSE.

    Without held-out trials, choose the member with the least BIC.
    """
    if math.isnan(members[0].held_out_rmse_n):
        return min(members, key=lambda member: member.bic)
    least = min(member.held_out_rmse_n for member in members)
    good = [member for member in members if member.held_out_rmse_n <= (1 + _GAIN) * least]
    return min(good, key=lambda member: (len(member.fit.free), member.held_out_rmse_n))


def fit_members(
    train: Sequence[Record],
    held: Sequence[Record] = (),
    *,
    mask: Mask,
    held_mask: Mask | None = None,
    smooth: Callable[[Array], Array] | None = None,
    capsules: int = BOUNDARIES,
    most_branches: int = 2,
) -> list[Member]:
    """Fit the models of the family to `train`, and return them in the order of the fits, with their scores on `held`.

    `mask` and `held_mask` select samples, `smooth` filters the simulated force. `capsules` is the largest number of
    capsules, `most_branches` that of branches. Raises DataError if no sample has a force.
    """
    fitter = _Fitter(train, held, mask, held_mask or mask, smooth)
    base = ("contact_mm", "stiffness", "growth", "friction")
    begin = _start(train, mask)
    members = [fitter.best("spring", [begin.with_values(growth=growth) for growth in _GROWTHS], base)]
    drops = _drops(train)[:capsules]
    for count in range(1, len(drops) + 1):
        members.append(_with_capsules(fitter, begin, sorted(drops[:count], key=lambda drop: drop.peak_mm), base))
    structure = choose_member(_with_bic(members))
    members += _with_branches(fitter, structure, most_branches)
    if len(drops) < BOUNDARIES:
        layered = _with_layer(fitter, structure)
        members += [layered, *_with_branches(fitter, layered, most_branches)]
    return _with_bic(members)


def _with_capsules(fitter: _Fitter, begin: RelaxingForce, drops: Sequence[Drop], base: tuple[str, ...]) -> Member:
    """Fit the member with a capsule at every drop, which are in the order of depth.

    For each growth, the stiffness of every tissue starts from the rise of the force to the next drop. The friction
    starts from the valleys.
    """
    count = len(drops)
    names = [f"boundary_{number}_mm" for number in range(1, count + 1)]
    ratios = [f"ratio_{number}" for number in range(1, count + 1)]
    deepest = max(float(np.max(record["depth_mm"])) for record in fitter.train)
    last = max(float(np.nanmax(record["force_n"][record["depth_mm"] > 0.98 * deepest])) for record in fitter.train)
    first = drops[0].peak_mm
    rubbing = min(
        (drop.valley_n / (drop.valley_mm - first) for drop in drops[1:]), default=last / (deepest - first) / 2
    )
    ends = [drop.peak_mm for drop in drops] + [deepest]
    tops, bottoms = [drop.peak_n for drop in drops] + [last], [0.0, *(drop.valley_n for drop in drops)]
    starts = []
    for growth in _GROWTHS:
        lengths = np.maximum(np.diff([min(begin.contact_mm, 0.9 * first), *ends]), _APART_MM)
        rises = np.array(tops) - bottoms - np.concatenate([[0.0], max(rubbing, 0.0) * lengths[1:]])
        stiff = np.maximum(rises, 0.05 * max(tops)) * growth / np.expm1(growth * lengths)
        starts.append(
            begin.with_values(
                **dict(zip(names, ends, strict=False)),
                **dict(zip(ratios, np.clip(stiff[1:] / stiff[0], 1e-2, 1e2), strict=True)),
                stiffness=stiff[0], growth=growth, friction=max(rubbing, 0.0), cutting=max(drops[0].valley_n, 0.0),
            )
        )  # fmt: skip
    label = f"{count} capsule{'s' * (count > 1)}"
    return fitter.best(label, starts, (*base, "cutting", *names, *ratios))


def _with_layer(fitter: _Fitter, before: Member) -> Member:
    """Fit a member with a layer in addition."""
    number = len(before.model.boundaries) + 1
    free = (*before.fit.free, f"boundary_{number}_mm", f"ratio_{number}")
    deepest = max(float(np.max(record["depth_mm"])) for record in fitter.train)
    starts = [
        before.model.with_values(**{f"boundary_{number}_mm": share * deepest, f"breaks_{number}": 0.0})
        for share in _PLACES
    ]
    return fitter.best(f"{before.label}, a layer", starts, free)


def _with_branches(fitter: _Fitter, before: Member, most: int) -> Iterator[Member]:
    """Fit a member with one branch in addition, and with two, up to `most`."""
    free, model = before.fit.free, before.model
    for branch, (said, begins) in enumerate(zip(("one branch", "two branches"), _BRANCHES, strict=True), 1):
        if branch <= most:
            free = (*free, f"branch_{branch}", f"time_{branch}_s")
            starts = [model.with_values(**{f"branch_{branch}": g, f"time_{branch}_s": tau}) for g, tau in begins]
            member = fitter.best(f"{before.label}, {said}", starts, free)
            model = member.model
            yield member


def _with_bic(members: Sequence[Member]) -> list[Member]:
    """Return the members with their BIC, for the effective number of samples of the best fit."""
    best = min(members, key=lambda member: member.fit.rmse)
    count = effective_samples(best.fit.residuals)
    return [
        replace(member, bic=count * math.log(max(member.fit.rmse, 1e-12) ** 2) + len(member.fit.free) * math.log(count))
        for member in members
    ]


def _drops(train: Sequence[Record]) -> list[Drop]:
    """Return sudden drops of the force, the largest first, at most `BOUNDARIES`."""
    found: list[Drop] = []
    for record in train:
        force = record["force_n"][np.isfinite(record["force_n"])]
        if force.size and np.ptp(force):
            found += force_drops(record, least_n=_DROP * float(np.ptp(force)), within_mm=_DROP_MM)
    drops: list[Drop] = []
    for drop in sorted(found, key=lambda drop: -drop.drop_n):
        if all(abs(drop.peak_mm - other.peak_mm) > _APART_MM for other in drops):
            drops.append(drop)
    return drops[:BOUNDARIES]


def _start(train: Sequence[Record], mask: Mask) -> RelaxingForce:
    """Return a spring from the contact to the largest force of the first part of the insertion."""
    inward = [
        np.flatnonzero(mask(record) & np.isfinite(record["force_n"]) & (record.motion().direction > 0))
        for record in train
    ]
    depth = np.concatenate([record["depth_mm"][rows] for record, rows in zip(train, inward, strict=True)])
    force = np.concatenate([record["force_n"][rows] for record, rows in zip(train, inward, strict=True)])
    if not force.size:
        raise DataError(Mistake("force_n", "", "has no finite value during an insertion"))
    most = float(np.max(force))
    low = depth[force < _CONTACT * most]
    peak = float(depth[np.argmax(force)])
    before = low[low < peak]
    contact = float(np.clip(np.percentile(before, 95), 0.0, 0.9 * peak)) if before.size else 0.0
    return RelaxingForce(contact_mm=contact, stiffness=max(most, 1e-3) / max(peak - contact, 1.0) / 3)


def can_relax(train: Sequence[Record]) -> bool:
    """Return whether the motion can show a relaxation: a dwell, or speeds that differ."""
    speeds = []
    for record in train:
        motion = record.motion()
        speed = np.abs(motion.velocity_mm_s)
        moving = speed > 0.05 * float(np.max(speed, initial=0.0))
        edges = np.flatnonzero(np.diff(np.concatenate([[0], (~moving).astype(int), [0]])))
        starts, ends = edges[::2], np.minimum(edges[1::2], len(motion) - 1)
        begun = motion.direction[starts] != 0
        if bool((begun & (motion.time_s[ends] - motion.time_s[starts] >= _DWELL_S)).any()):
            return True
        speeds += [float(number) for number in np.percentile(speed[moving], (10, 90))] if moving.any() else []
    return bool(speeds) and max(speeds) > _SPEEDS * max(min(speeds), 1e-9)


def identify_relaxing(
    trials: Trials, train: Sequence[Record], faults: Sequence[str], sensor: MovingAverage, mask: Mask
) -> Identification:
    """Identify a relaxing force from `train`, the trials without faults; `mask` selects samples of a record."""
    smooth = sensor.apply if sensor.samples > 1 else None
    shown = can_relax(train)
    members = fit_members(train, trials.holdout, mask=mask, smooth=smooth, most_branches=2 if shown else 0)
    chosen = choose_member(members)
    joint = with_scatter(chosen.fit, train, smooth=smooth, mask=mask)
    joint_fit, model = joint.fit, replace(chosen, fit=joint.fit).model
    scores: list[tuple[str, float, str]] = [("RMSE of the fit", joint_fit.rmse, "N")]
    least = min(member.bic for member in members)
    for member in members:
        scores.append((f"{member.label}: RMSE", member.fit.rmse, "N"))
        if trials.holdout:
            scores.append((f"{member.label}: RMSE held out", member.held_out_rmse_n, "N"))
        scores.append((f"{member.label}: BIC above the smallest", member.bic - least, ""))
    scores += [("samples", joint_fit.samples, ""), ("masked samples", joint_fit.masked, "")]
    by = "the held-out trials" if trials.holdout else "Schwarz' criterion (nothing is held out)"
    says = f"{by} chose: {chosen.label}, of {len(members)} members"
    choice = Finding("choice of the member", chosen.held_out_rmse_n if trials.holdout else chosen.bic, None, says)
    remarks = [*trials.remarks, *faults, *joint.remarks, *undetermined(joint_fit.estimates), *joint_fit.trades]
    if not shown:
        remarks.append(
            "there is one speed and no dwell, so that a branch hardly differs from a stiffer spring: branches were not "
            "tried; record a dwell of some seconds or a second speed to identify the relaxation"
        )
    if not joint_fit.ok:
        remarks.append(f"the fit ended with: {joint_fit.status}; other parameters may fit better")
    kept = None if joint_fit.status is FitStatus.DIVERGED else model
    return Identification(
        "force", kept, dict(joint_fit.estimates), tuple(scores), (choice, *residual_findings(joint_fit, train)),
        (*remarks, averaged(sensor.samples)),
        partial(draw_force, model=model, records=[*train, *trials.holdout], sensor=sensor, counts=mask),
    )  # fmt: skip
