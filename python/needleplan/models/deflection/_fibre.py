"""Fibre Bragg gratings (FBG) along a needle: places of the sensors, and their curvatures from the strains of the cores.

A core at the angle a_c from the normal n of the needle, at the radius r, has the strain of equation (6) of
docs/explanation/needle-shape.md::

    strain_c = common - r (kn cos a_c + kb sin a_c)

`common` contains the axial strain and the temperature, which are the same in all cores of a place. Three cores
determine kn, kb and `common`; with two cores, a change of temperature would look like a curvature.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from needleplan.artifacts import ShortRepr
from needleplan.config import ConfigTable, Number, NumberList, ruled
from needleplan.errors import DataError, Mistake, ModelError
from needleplan.signals import FIBRE_COLUMNS, Array, Record

__all__ = ["FibreCurvatures", "FibreSensors"]

# Largest strain that a glass fibre survives for long; a core with a larger one, or without a reading, is broken.
_LARGEST_STRAIN = 0.01

# Smallest share of the best conditioned cores that the remaining cores of a place must have to determine a curvature.
_LEAST_CONDITION = 0.1


def _gauge_is_in_the_needle(from_tip_mm: tuple[float, ...], gauge_mm: float) -> Iterator[Mistake]:
    if from_tip_mm[0] < gauge_mm / 2:
        rule = f"must begin at half of gauge_mm, {gauge_mm / 2:g}, or more: a grating does not reach beyond the tip"
        yield Mistake("from_tip_mm", f"{from_tip_mm[0]:g}", rule)


@dataclass(frozen=True)
class FibreCurvatures(ShortRepr):
    """Curvatures of a needle from the strains of its cores.

    Parameters
    ----------
    curvature_per_mm : numpy.ndarray
        Curvatures kn and kb, shape (n, k, 2); NaN at a place with fewer than three readable cores.
    common_strain : numpy.ndarray
        Strain that all cores of a place have, shape (n, k): axial strain and temperature.
    notes : tuple of str
        A remark for each broken core.

    Examples
    --------
    >>> from needleplan.models.deflection import FibreSensors
    >>> FibreSensors(from_tip_mm=(10.0,), core_radius_mm=0.1).curvatures([[[1e-4, 1e-4, 1e-4]]]).common_strain
    array([[0.0001]])
    """

    curvature_per_mm: Array
    common_strain: Array
    notes: tuple[str, ...]


@dataclass(frozen=True)
class FibreSensors(ConfigTable, key="fibre", error=ModelError, between=(_gauge_is_in_the_needle,)):
    """Curvature sensors along a needle, of one to eight places, the nearest to the tip first.

    Raises ModelError with every value outside of its rule.

    Examples
    --------
    >>> from needleplan.models.deflection import FibreSensors
    >>> FibreSensors(from_tip_mm=(10.0, 35.0, 70.0, 100.0)).columns[:2]
    ('fbg1_y_per_mm', 'fbg1_z_per_mm')
    """

    from_tip_mm: tuple[float, ...] = ruled(
        NumberList("mm", 1, len(FIBRE_COLUMNS) // 2, "the distances from the tip, the nearest sensor first")
    )
    """Distances of the sensors from the tip."""

    gauge_mm: float = ruled(Number("mm", above=0, at_most=20), 5.0)
    """Length of a grating, over which it averages the curvature."""

    core_angles_rad: tuple[float, ...] = ruled(NumberList("rad", 3, 16), (0.0, 2 * math.pi / 3, 4 * math.pi / 3))
    """Angles of the cores from the normal of the needle, toward its binormal."""

    core_radius_mm: float = ruled(Number("mm", above=0, at_most=5), 0.4)
    """Distance of the cores from the axis of the needle."""

    @classmethod
    def at(cls, from_tip_mm: Sequence[float]) -> Self:
        """Return sensors at distances from the tip, with a gauge that fits in front of the first one.

        Parameters
        ----------
        from_tip_mm : sequence of float
            Distances from the tip (mm), the nearest sensor first.

        Returns
        -------
        FibreSensors

        Raises
        ------
        ModelError
            The distances do not increase from 0 or more.
        """
        return cls(tuple(from_tip_mm), min(5.0, 2 * from_tip_mm[0]) or 5.0)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns of a data file that hold the curvatures: y and z of each sensor."""
        return FIBRE_COLUMNS[: 2 * len(self.from_tip_mm)]

    def curvatures(self, strain: ArrayLike) -> FibreCurvatures:
        """Return the curvatures from the strains of the cores; a change of temperature does not change them.

        Parameters
        ----------
        strain : array_like
            Strains relative to the straight needle, shape (n, k, cores); NaN if a core is not readable.

        Returns
        -------
        FibreCurvatures

        Raises
        ------
        DataError
            The shape differs from the sensors, or the broken cores leave no sensor that determines a curvature.
        """
        read = np.asarray(strain, float)
        if read.ndim != 3 or read.shape[1:] != (len(self.from_tip_mm), len(self.core_angles_rad)):
            rule = f"must be (samples, sensors, cores) = (n, {len(self.from_tip_mm)}, {len(self.core_angles_rad)})"
            raise DataError(Mistake("strain", f"shape {read.shape}", rule))
        angles, radius = np.array(self.core_angles_rad), self.core_radius_mm
        design = np.column_stack([np.ones_like(angles), -radius * np.cos(angles), -radius * np.sin(angles)])
        broken = ~(np.abs(read) <= _LARGEST_STRAIN)
        found = np.full((*read.shape[:2], 3), np.nan)
        notes = []
        for sensor, place in enumerate(self.from_tip_mm):
            for core in np.flatnonzero(broken[:, sensor].any(axis=0)):
                count = int(broken[:, sensor, core].sum())
                notes.append(
                    f"core {core + 1} of the sensor {place:g} mm from the tip is not readable in {count} of "
                    f"{len(read)} samples: is it broken?"
                )
            for pattern in np.unique(broken[:, sensor], axis=0):
                cores = design[~pattern]
                sizes = (
                    np.linalg.svd(cores / [1.0, radius, radius], compute_uv=False) if len(cores) >= 3 else [1.0, 0.0]
                )
                if sizes[-1] < _LEAST_CONDITION * sizes[0]:
                    continue
                rows = (broken[:, sensor] == pattern).all(axis=1)
                found[rows, sensor] = read[rows, sensor][:, ~pattern] @ np.linalg.pinv(cores).T
        if read.size and not np.isfinite(found).any():
            rule = "must leave three readable cores at a sensor: with two, temperature looks like curvature"
            raise DataError(Mistake("strain", "; ".join(notes), rule))
        return FibreCurvatures(found[:, :, 1:], found[:, :, 0], tuple(notes))

    def measured(self, record: Record) -> Array:
        """Return the curvatures of a record.

        Parameters
        ----------
        record : Record
            Record with the columns `columns`.

        Returns
        -------
        numpy.ndarray
            Curvatures kn and kb (1/mm), shape (samples, k, 2); NaN where nothing was measured.

        Raises
        ------
        DataError
            A column is missing, or the record has more sensors than the needle.
        """
        there = [name for name in FIBRE_COLUMNS if name in record.columns]
        mistakes = [
            Mistake(name, "", "is missing or empty: leave a sensor without readings out of the distances, and renumber")
            for name in self.columns
            if name not in there
        ]
        rule = f"is not a sensor of the needle, which has {len(self.from_tip_mm)} in from_tip_mm"
        mistakes += [Mistake(name, "", rule) for name in there if name not in self.columns]
        if mistakes:
            raise DataError(mistakes, record.trial)
        return np.stack([record[name] for name in self.columns], axis=-1).reshape(len(record), -1, 2)

    def require_length(self, length_mm: float) -> Iterator[Mistake]:
        """Yield a mistake if a needle of the length (mm) is shorter than its sensors.

        Parameters
        ----------
        length_mm : float
            Length of the needle.

        Yields
        ------
        Mistake
        """
        if self.from_tip_mm[-1] + self.gauge_mm / 2 > length_mm:
            half = f"half of gauge_mm, {self.gauge_mm / 2:g}"
            rule = f"must end within the needle, which is {length_mm:g} mm long, with {half}"
            yield Mistake("fibre.from_tip_mm", f"{self.from_tip_mm[-1]:g}", rule)
