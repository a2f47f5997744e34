"""Rotations of a frame that goes along a path, all at once: quaternions (w, x, y, z) with a leading axis of four."""

from __future__ import annotations

import numpy as np

from needleplan.signals import Array

__all__ = ["axes_of", "quaternion_of", "quaternions_along"]


def quaternions_along(turns_rad: Array, start: Array) -> Array:
    """Return the rotation after each of n turns, shape (4, n + 1), the first being `start`, shape (4,).

    `turns_rad`, shape (3, n), are rotation vectors in the frame that is turned. Products of neighbours are joined in
    log2(n) passes over all of them.
    """
    angle = np.sqrt((turns_rad**2).sum(axis=0))
    each = np.concatenate([np.cos(angle / 2)[None], np.sinc(angle / (2 * np.pi)) / 2 * turns_rad])
    whole = np.concatenate([start[:, None], each], axis=1)
    reach = 1
    while reach < whole.shape[1]:
        whole = np.concatenate([whole[:, :reach], _product(whole[:, :-reach], whole[:, reach:])], axis=1)
        reach *= 2
    return np.asarray(whole / np.sqrt((whole**2).sum(axis=0)))


def axes_of(quaternions: Array) -> tuple[Array, Array, Array]:
    """Return the three axes of turned frames, shape (3, ...) each."""
    w, x, y, z = quaternions
    return (
        np.array([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]),
        np.array([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)]),
        np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]),
    )


def quaternion_of(tangent: Array, normal: Array) -> Array:
    """Return the rotation of a frame with these first two axes, shape (3,) each, orthonormal; shape (4,)."""
    binormal = np.cross(tangent, normal)
    m = np.column_stack([tangent, normal, binormal])
    squares = np.array([1 + np.trace(m), *(1 + 2 * m[i, i] - np.trace(m) for i in range(3))])
    # The greatest of the four is far from zero; the others follow from it.
    k = int(squares.argmax())
    found = np.empty(4)
    found[k] = 0.5 * np.sqrt(squares[k])
    sums = {(0, 1): m[2, 1] - m[1, 2], (0, 2): m[0, 2] - m[2, 0], (0, 3): m[1, 0] - m[0, 1],
            (1, 2): m[0, 1] + m[1, 0], (1, 3): m[0, 2] + m[2, 0], (2, 3): m[1, 2] + m[2, 1]}  # fmt: skip
    for other in range(4):
        if other != k:
            found[other] = sums[min(k, other), max(k, other)] / (4 * found[k])
    return found


def _product(first: Array, second: Array) -> Array:
    a, b, c, d = first
    e, f, g, h = second
    return np.stack([
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    ])  # fmt: skip
