"""Isolability: which effects the given motions can separate.

Sensitivities are weighted for noise and heterogeneity and compared with the base model projected out. Let a be the
sensitivity of one effect and b the sensitivities of another effect at all of its grid points. Then

    imitated = max over b of (a'b)^2 / (a'a b'b)

with a at the grid point that has the median energy among the visible grid points. If `imitated` is 1, no number of such
trials separates the two effects.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from needleplan.artifacts import CallRepr
from needleplan.diagnosis._factors import directions
from needleplan.diagnosis.calibration import Calibration
from needleplan.diagnosis.catalogue import Library
from needleplan.signals import Array

__all__ = ["Isolability", "isolability"]

# Squared correlation above which two effects count as hard to separate.
_ALIKE_SHARE = 0.8
# Share of a sensitivity's energy left by the base model, below which the effect counts as invisible.
_INVISIBLE = 1e-6


@dataclass(frozen=True)
class Isolability(CallRepr):
    """Shares in which effects imitate each other.

    `imitated[i, j]` is the share (0 to 1) of effect i that effect j imitates; NaN if effect i is invisible.
    """

    effects: tuple[str, ...]
    imitated: Array

    def alike(self) -> tuple[tuple[str, str, float], ...]:
        """Return the pairs (effect, imitator, imitated share) with a share of at least 0.8, the largest first."""
        found = [
            (self.effects[i], self.effects[j], float(self.imitated[i, j]))
            for i in range(len(self.effects))
            for j in range(len(self.effects))
            if i != j and self.imitated[i, j] >= _ALIKE_SHARE
        ]
        return tuple(sorted(found, key=lambda each: -each[2]))


def isolability(
    calibration: Calibration, library: Library, heterogeneity_sd: float, *, smooth: bool = False
) -> Isolability:
    """Compute how far the effects of a library imitate each other in the motions of the training trials.

    Parameters
    ----------
    calibration
        Calibrated training trials with the noise of the sensor.
    library
        Effects to compare.
    heterogeneity_sd
        Standard deviation of the tissue's properties along the path, as a share of their means.
    smooth
        Whether the tissue varies slowly along the path; by default it is rough.

    Returns
    -------
    Isolability
        Shares of the effects' sensitivities that other effects imitate, with base model and tissue projected out.
    """
    trials = calibration.training
    entries = library.entries([trial.motion for trial in trials])
    parts, raw = [], np.zeros(max(entry.last for entry in entries))
    for trial in trials:
        whitened = trial.whiten(library.sensitivities(calibration.model, trial.motion, entries))
        raw += (whitened**2).sum(axis=0)
        base = trial.whitened.base
        both, q = np.hstack([base, whitened]), base.shape[1]
        # Factor (1 + h^2 variance)^(-1/2) along each orthonormal mode of the tissue.
        modes, sds = directions(trial.tissue[int(smooth)])
        share = 1 - 1 / np.hypot(1, heterogeneity_sd * sds)
        both -= modes @ (share[:, None] * (modes.T @ both))
        basis = np.linalg.qr(both[:, :q])[0]
        parts.append(both[:, q:] - basis @ (basis.T @ both[:, q:]))
    left = np.vstack(parts)
    energy = (left**2).sum(axis=0)
    seen = energy > _INVISIBLE * raw
    unit = left / np.sqrt(np.where(seen, energy, 1.0))
    imitated = np.full((len(entries), len(entries)), np.nan)
    visible = [np.arange(entry.first, entry.last)[seen[entry.first : entry.last]] for entry in entries]
    shown = [i for i, places in enumerate(visible) if places.size]
    middles = [int(visible[i][np.argsort(energy[visible[i]], kind="stable")[visible[i].size // 2]]) for i in shown]
    likeness = np.where(seen, (unit[:, middles].T @ unit) ** 2, 0.0)
    for i, alike in zip(shown, likeness, strict=True):
        for j, other in enumerate(entries):
            imitated[i, j] = 1.0 if i == j else np.clip(alike[other.first : other.last].max(), 0.0, 1.0)
    return Isolability(tuple(entry.effect.name for entry in entries), imitated)
