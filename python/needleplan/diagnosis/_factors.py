"""Factors of positive definite matrices that rounding may make indefinite."""

from __future__ import annotations

import numpy as np

from needleplan.signals import Array

__all__ = ["RIDGE", "inverse_of", "root_of", "solved"]

RIDGE = 1e-10
"""Relative ridge of normal matrices."""
# Least diagonal element: rounding may leave nothing of a positive one.
_LEAST = 1e-300


def root_of(matrix: Array) -> Array:
    """Return the Cholesky factors of positive definite matrices (..., n, n), or of the nearest ones.

    Columns that are equal but for rounding, in units far above those of the noise, give eigenvalues below zero. These
    are lifted to the ridge.
    """
    try:
        return np.asarray(np.linalg.cholesky(matrix))
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(matrix)
        lifted = np.sqrt(np.maximum(values, RIDGE * values[..., -1:]))[..., None] * vectors.swapaxes(-1, -2)
        upper = np.linalg.qr(lifted, mode="r")
        signs = np.sign(np.einsum("...cc->...c", upper))
        return np.asarray((signs[..., None] * upper).swapaxes(-1, -2))


def inverse_of(matrix: Array) -> Array:
    """Return the inverse of positive definite matrices (t, f, f), scaled to unit diagonals first."""
    if not matrix.shape[1]:
        return matrix
    scale = 1 / np.sqrt(np.maximum(np.einsum("tff->tf", matrix), _LEAST))
    whole = scale[:, :, None] * scale[:, None] * matrix + RIDGE * np.eye(matrix.shape[1])
    return np.asarray(scale[:, :, None] * scale[:, None] * np.linalg.inv(whole))


def solved(matrix: Array, right: Array) -> Array:
    """Return the solutions x, (t, f, m), of matrix x = right with positive definite matrices (t, f, f)."""
    try:
        return np.asarray(np.linalg.solve(matrix, right))
    except np.linalg.LinAlgError:
        return inverse_of(matrix) @ right
