"""Factors of positive definite matrices that rounding may make indefinite."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dtrtri

from needleplan.signals import Array

__all__ = ["RIDGE", "directions", "eliminated", "inverse_of", "inverse_root", "root_of", "swept"]

RIDGE = 1e-10
"""Relative ridge of normal matrices."""
# Share of the largest squared size below which a direction is rounding error.
_ROUNDING = 1e-10
# Least diagonal element: rounding may leave nothing of a positive one.
_LEAST = 1e-300


def directions(columns: Array) -> tuple[Array, Array]:
    """Return the left singular vectors of columns, shape (n, k), and their singular values, shape (k,).

    Directions without any size, next to the largest one, are left out.
    """
    values, vectors = np.linalg.eigh(columns.T @ columns)
    kept = values > _ROUNDING * values[-1:]
    sizes = np.sqrt(values[kept])
    return columns @ (vectors[:, kept] / sizes), sizes


def root_of(matrix: Array) -> Array:
    """Return the Cholesky factors of positive definite matrices (..., n, n), or of the nearest ones.

    Columns that are equal but for rounding, in units far above those of the noise, give eigenvalues below zero. These
    are lifted to the ridge, after the diagonal elements have been scaled to one.
    """
    try:
        return np.asarray(np.linalg.cholesky(matrix))
    except np.linalg.LinAlgError:
        scale = np.sqrt(np.maximum(np.einsum("...cc->...c", matrix), _LEAST))[..., None]
        values, vectors = np.linalg.eigh(matrix / (scale * scale.swapaxes(-1, -2)))
        lifted = np.sqrt(np.maximum(values, RIDGE * values[..., -1:]))[..., None] * vectors.swapaxes(-1, -2)
        upper = np.linalg.qr(lifted, mode="r")
        signs = np.sign(np.einsum("...cc->...c", upper))
        return np.asarray(scale * (signs[..., None] * upper).swapaxes(-1, -2))


def inverse_of(matrix: Array) -> Array:
    """Return the inverse of positive definite matrices (t, f, f), scaled to unit diagonals first."""
    if not matrix.shape[1]:
        return matrix
    scale = 1 / np.sqrt(np.maximum(np.einsum("tff->tf", matrix), _LEAST))
    whole = scale[:, :, None] * scale[:, None] * matrix + RIDGE * np.eye(matrix.shape[1])
    return np.asarray(scale[:, :, None] * scale[:, None] * np.linalg.inv(whole))


def inverse_root(root: Array) -> Array:
    """Return the inverse of lower triangular matrices (t, n, n) with positive diagonals."""
    return np.asarray([dtrtri(each.T)[0].T for each in root]) if root.size else root


def eliminated(matrix: Array, count: int) -> tuple[Array, Array]:
    """Return the Schur complements of the first `count` rows of positive definite matrices, and the log determinants.

    [[A, B], [B', C]] gives C - B'A^-1 B, shape (t, n - count, n - count), and log det A, shape (t,).
    """
    root = root_of(matrix)
    rest = root[:, count:, count:]
    return rest @ rest.swapaxes(1, 2), 2 * np.log(np.einsum("tcc->tc", root)[:, :count]).sum(axis=1)


def swept(matrix: Array, count: int) -> tuple[Array, Array]:
    """Return positive definite matrices (n, n, ...) with their first `count` rows swept, and log determinants of these.

    [[A, B], [B', C]] becomes [[A^-1, A^-1 B], [-B'A^-1, C - B'A^-1 B]]. For thousands of small matrices, stacked along
    the last axes, this is many times as fast as LAPACK, which takes them one by one. Pivots that rounding leaves below
    the ridge are lifted to it. Source: J. H. Goodnight, A tutorial on the SWEEP operator, The American Statistician 33
    (1979).
    """
    found, log_determinant = matrix.copy(), np.zeros(matrix.shape[2:])
    for row in range(count):
        pivot = np.maximum(found[row, row], RIDGE * np.abs(matrix[row, row]))
        log_determinant += np.log(pivot)
        across = found[row] / pivot
        across[row] = 1 / pivot
        down = found[:, row].copy()
        found -= down[:, None] * across
        found[:, row] = -down / pivot
        found[row] = across
    return found, log_determinant
