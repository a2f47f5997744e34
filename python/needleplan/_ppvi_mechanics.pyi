"""Loops of the mechanics in `_ppvi`, a stub of its own; at run time there is no module of this name."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["dragged", "path_corrected", "path_moved", "rod_stations", "slid", "yielding"]

def slid(
    velocity_mm_s: NDArray[np.float64], time_s: NDArray[np.float64], lengths_mm: Sequence[float], start: float
) -> NDArray[np.float64]: ...
def yielding(
    velocity_mm_s: NDArray[np.float64], time_s: NDArray[np.float64], length_mm: float, yields: Sequence[float]
) -> NDArray[np.float64]: ...
def dragged(
    velocity_mm_s: NDArray[np.float64],
    time_s: NDArray[np.float64],
    largest_mm: NDArray[np.float64],
    lag_s: float,
    presliding_mm: float,
    start: tuple[float, float],
) -> NDArray[np.float64]: ...
def rod_stations(
    *,
    lengths_mm: NDArray[np.float64],
    places_mm: NDArray[np.float64],
    intrinsic_per_mm: NDArray[np.float64],
    boundaries_mm: Sequence[float],
    start_per_mm: Sequence[float],
    torsion_ratio: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]: ...
def path_moved(
    state: NDArray[np.float64],
    covariance: NDArray[np.float64],
    piece: tuple[float, float, float, float, bool],
    planned_per_mm: float,
    noise: Sequence[float],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...
def path_corrected(
    state: NDArray[np.float64],
    covariance: NDArray[np.float64],
    columns: Sequence[int],
    model: Sequence[Sequence[float]],
    innovation: Sequence[float] | NDArray[np.float64],
    *,
    variance: float,
    gate: float,
) -> tuple[float, tuple[NDArray[np.float64], NDArray[np.float64]]]: ...
