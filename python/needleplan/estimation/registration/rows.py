"""Rows of coordinates, checked."""

from __future__ import annotations

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.signals import Array

__all__ = ["rows_of"]


def rows_of(values: Array, name: str) -> Array:
    """Return values of shape (n, 3), finite numbers. Raises DataError."""
    rows = np.asarray(values, float)
    if rows.ndim != 2 or rows.shape[1] != 3 or not np.isfinite(rows).all():
        raise DataError(Mistake(name, f"shape {rows.shape}", "must have the shape (n, 3) and finite numbers"))
    return rows
