"""Curvature along the needle: what its sensors measure, minus what a model of the path of the tip says there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from needleplan.models import Model, SteeredModel, simulate
from needleplan.models.deflection import FibreSensors
from needleplan.models.effects import AugmentedModel
from needleplan.signals import FIBRE_COLUMNS, IMAGE_COLUMNS, Array, Record, Role

__all__ = ["curvature_remarks"]

# Standard deviation (1/mm) of the constant error of a sensor, as in the settings of the tip filter.
_BIAS_PER_MM = 1e-4
# Difference in standard deviations from which a remark names it.
_CLEAR = 3.0


def curvature_remarks(model: Model, records: Sequence[Record], fibre: FibreSensors | None) -> Iterator[str]:
    """Compare the curvature sensors along the needle with the model, and yield remarks.

    Each sensor that contradicts the model gets a remark. If no sensor does, one remark says that all agree. Further
    remarks name the columns of curvature sensors and of images that the diagnosis does not use. Records without such
    columns give no remark. Neighbouring readings share the tissue, so a mean counts one reading for each gauge length
    of path.
    """
    plant = model.plant if isinstance(model, AugmentedModel) else model
    plant = plant.whole if isinstance(plant, AugmentedModel) else plant
    sensed = [
        record for record in records if record.role is not Role.NOISE and set(FIBRE_COLUMNS) & set(record.columns)
    ]
    if any(set(IMAGE_COLUMNS) & set(record.columns) for record in records):
        yield f"tip in images: {' and '.join(IMAGE_COLUMNS)} are not used; a diagnosis compares x_mm, y_mm and z_mm"
    if not sensed:
        return
    if fibre is None or not isinstance(plant, SteeredModel):
        lacks = "the model file has no [fibre]" if fibre is None else "the model has no path of the tip in 3D"
        yield f"curvature along the needle: {FIBRE_COLUMNS[0]} and so on are not used, because {lacks}"
        return
    off, lengths = zip(*(_differences(plant, record, fibre) for record in sensed), strict=True)
    every, count = np.concatenate(off), np.maximum(np.sum(lengths, axis=0) / fibre.gauge_mm, 1.0)
    means, spread = np.nanmean(every, axis=0), np.nanstd(every, axis=0)
    sds = np.hypot(_BIAS_PER_MM, spread / np.sqrt(count)[:, None])
    clear = np.abs(means) > _CLEAR * sds
    for behind, mean, sd, is_clear in zip(fibre.from_tip_mm, 1e3 * means, 1e3 * sds, clear, strict=True):
        if is_clear.any():
            differs = f"{mean[0]:+.2g} 1/m toward the bevel and {mean[1]:+.2g} 1/m across it (sd {sd.max():.1g} 1/m)"
            yield f"curvature along the needle: {behind:g} mm behind the tip it differs from the model by {differs}"
    if not clear.any():
        within = f"agree with the model within {1e3 * sds.max():.1g} 1/m (sd)"
        yield f"curvature along the needle: {len(means)} sensors {within}"


def _differences(plant: SteeredModel, record: Record, fibre: FibreSensors) -> tuple[Array, Array]:
    """Return measured minus modelled curvatures (1/mm), shape (n, k, 2), and the path (mm) that each sensor passed.

    They are along the curvature of the model, to where the bevel was when the tip cut there, and across it.
    """
    motion = record.motion()
    roll = simulate(plant, motion).states[9]
    deepest = np.maximum.accumulate(motion.depth_mm)
    fresh = np.concatenate([[True], np.diff(deepest) > 0])
    cut, bend = deepest[fresh], plant.bend_per_mm(motion, roll)[:, fresh]
    place = motion.depth_mm[:, None] - np.array(fibre.from_tip_mm)
    modelled = np.interp(place, cut, bend[0]) + 1j * np.interp(place, cut, bend[1])
    measured = fibre.measured(record) @ np.array([1, 1j]) * np.exp(1j * roll)[:, None]
    begin = max(float(cut[0]), 0.0)
    off = (measured - modelled) * np.exp(-1j * np.angle(modelled))
    off = np.where(place > begin + fibre.gauge_mm / 2, off, np.nan)
    return np.stack([off.real, off.imag], axis=-1), np.maximum(np.max(place, axis=0) - begin, 0.0)
