"""Peers of the diagnosis by regression alone: PySINDy's STLSQ, bagged STLSQ, and LASSO with Schwarz' criterion.

The peers get favourable input: the residual of the calibrated base, whitened by the sensor noise, with the
sensitivities of the base projected out, and for each effect the column of its grid that explains most of the residual.
A peer names every effect with a nonzero coefficient.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np

from needleplan.diagnosis import Diagnosis, Library
from needleplan.signals import Array

# Number of bootstrap samples, and share of them in which a coefficient must be nonzero to count.
BAGS = 50
INCLUDED = 0.6
THRESHOLDS = np.geomspace(0.5, 30.0, 14)
"""Candidate thresholds of a coefficient, in standard deviations of the noise (the columns have length 1)."""


def named(found: Diagnosis, library: Library, seed: int) -> dict[str, list[str]]:
    """Return by peer the names of the effects that it finds in the training data of a diagnosis."""
    from sklearn.linear_model import LassoLarsIC

    names, columns, target = _problem(found, library)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        threshold = _threshold(columns, target)
        lasso = LassoLarsIC(criterion="bic", fit_intercept=False).fit(columns, target)
        return {
            "stlsq": _nonzero(names, _stlsq(columns, target, threshold)),
            "bagged": _nonzero(names, _bagged(columns, target, threshold, seed)),
            "lasso": _nonzero(names, lasso.coef_),
        }


def _problem(found: Diagnosis, library: Library) -> tuple[list[str], Array, Array]:
    cases = found.calibration.training
    candidates = library.entries([case.motion for case in cases])
    columns, target = [], []
    for case in cases:
        each = case.whiten(library.sensitivities(found.calibration.model, case.motion, candidates))
        q = np.linalg.qr(case.whitened.base)[0]
        columns.append(each - q @ (q.T @ each))
        target.append(case.whitened.residual - q @ (q.T @ case.whitened.residual))
    stacked, left = np.vstack(columns), np.concatenate(target)
    length = np.linalg.norm(stacked, axis=0)
    good = length > 1e-6 * length.max()
    stacked = stacked / np.where(good, length, 1.0)
    seen = np.where(good, np.abs(stacked.T @ left), 0.0)
    best = [each.first + int(seen[each.first : each.last].argmax()) for each in candidates]
    kept = [(each.effect.name, place) for each, place in zip(candidates, best, strict=True) if good[place]]
    return [name for name, _ in kept], stacked[:, [place for _, place in kept]], left


def _threshold(columns: Array, target: Array) -> float:
    """Return the threshold with which STLSQ has the best Schwarz criterion, for noise of standard deviation 1."""
    scores = []
    for each in THRESHOLDS:
        sizes = _stlsq(columns, target, float(each))
        left = target - columns @ sizes
        scores.append(float(left @ left) + np.count_nonzero(sizes) * np.log(len(target)))
    return float(THRESHOLDS[int(np.argmin(scores))])


def _stlsq(columns: Array, target: Array, threshold: float) -> Array:
    from pysindy.optimizers import STLSQ

    fitted = STLSQ(threshold=threshold, alpha=1e-6, unbias=True).fit(columns, target[:, None])
    return np.asarray(fitted.coef_[0], float)


def _bagged(columns: Array, target: Array, threshold: float, seed: int) -> Array:
    """Return for each coefficient the share of bootstrap samples in which it is nonzero; 0 if at most `INCLUDED`."""
    from pysindy.optimizers import STLSQ, EnsembleOptimizer

    np.random.seed(seed % 2**32)  # noqa: NPY002  PySINDy draws from the global generator
    each = STLSQ(threshold=threshold, alpha=1e-6, unbias=True)
    bagged = EnsembleOptimizer(each, bagging=True, n_models=BAGS).fit(columns, target[:, None])
    share = np.mean([np.abs(np.asarray(one)[0]) > 0 for one in bagged.coef_list], axis=0)
    return np.where(share > INCLUDED, share, 0.0)


def _nonzero(names: Sequence[str], sizes: Array) -> list[str]:
    return [name for name, size in zip(names, sizes, strict=True) if size != 0]
