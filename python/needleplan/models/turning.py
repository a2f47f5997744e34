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
    share = np.sinc(angle / (2 * np.pi)) / 2
    # w + x i + y j + z k is a + b j with a = w + x i, b = y + z i: two complex numbers, and fewer passes.
    a = np.append(start[0] + 1j * start[1], np.cos(angle / 2) + 1j * (share * turns_rad[0]))
    b = np.append(start[2] + 1j * start[3], share * (turns_rad[1] + 1j * turns_rad[2]))
    reach = 1
    while reach < a.size:
        a1, b1, a2, b2 = a[:-reach], b[:-reach], a[reach:], b[reach:]
        a[reach:], b[reach:] = a1 * a2 - b1 * b2.conj(), a1 * b2 + b1 * a2.conj()
        reach *= 2
    whole = np.array([a.real, a.imag, b.real, b.imag])
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
    (a, b, c), (d, e, f) = tangent.tolist(), normal.tolist()
    m = np.array([[a, d, b * f - c * e], [b, e, c * d - a * f], [c, f, a * e - b * d]])
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    squares = np.array([1 + trace, *(1 + 2 * m[i, i] - trace for i in range(3))])
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
