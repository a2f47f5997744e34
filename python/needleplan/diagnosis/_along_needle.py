"""Sensors along the needle and images of its tip: what they measure, minus what a model of the path of the tip says."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy import stats

from needleplan.models import Model, ModelFile, SteeredModel, simulate
from needleplan.models.deflection import FibreSensors
from needleplan.models.effects import AugmentedModel
from needleplan.models.path import ImagePlane
from needleplan.signals import FIBRE_COLUMNS, IMAGE_COLUMNS, Array, Record, Role

__all__ = ["curvature_remarks", "image_remarks", "sensor_remarks"]

# Standard deviation (1/mm) of the constant error of a sensor, as in the settings of the tip filter.
_BIAS_PER_MM = 1e-4
# Difference in standard deviations from which a remark names it.
_CLEAR = 3.0
# Path length (mm) over which images share the error of the path; a mean counts one image for each.
_SHARED_MM = 5.0


def sensor_remarks(model: Model, records: Sequence[Record], file: ModelFile) -> list[str]:
    """Return the remarks of `curvature_remarks` and `image_remarks`, with the sensors of a model file."""
    return [*curvature_remarks(model, records, file.fibre), *image_remarks(model, records, file.ultrasound)]


def curvature_remarks(model: Model, records: Sequence[Record], fibre: FibreSensors | None) -> Iterator[str]:
    """Compare the curvature sensors along the needle with the model, and yield remarks.

    Each sensor that contradicts the model gets a remark. If no sensor does, one remark says that all agree, or that the
    diagnosis does not use them. Records without such columns give no remark. Neighbouring readings share the tissue, so
    a mean counts one reading for each gauge length of path.
    """
    plant, sensed = _plant(model), _with(FIBRE_COLUMNS[:1], records)
    if not sensed:
        return
    if fibre is None or not isinstance(plant, SteeredModel):
        yield f"curvature along the needle: {FIBRE_COLUMNS[0]} and so on {_unused(fibre is None, 'fibre')}"
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


def image_remarks(model: Model, records: Sequence[Record], plane: ImagePlane | None) -> Iterator[str]:
    """Compare the positions of the tip in images with the model, and yield one remark, or none without such columns.

    The positions are those of the tip that the model has when an image arrives. A late image is therefore behind.
    """
    plant, seen = _plant(model), _with(IMAGE_COLUMNS, records)
    if not seen:
        return
    if plane is None or not isinstance(plant, SteeredModel):
        yield f"tip in images: {' and '.join(IMAGE_COLUMNS)} {_unused(plane is None, 'ultrasound')}"
        return
    off, steps, lengths = [], [], 0.0
    for record in seen:
        tip = simulate(plant, record.motion()).output.T
        apart = np.stack([record[name] for name in IMAGE_COLUMNS], 1) - (tip - plane.origin_mm) @ plane.axes[:2].T
        known = np.isfinite(apart).all(axis=1) & (record["depth_mm"] > 0)
        off.append(apart[known])
        steps.append(np.diff(apart[known], axis=0))
        lengths += float(np.ptp(record["depth_mm"][known])) if known.any() else 0.0
    every = np.concatenate(off)
    if len(every) < 2:
        return
    # Medians, because a detection may be an outlier. The noise is that of successive detections; the variance of a
    # median is pi/2 times that of a mean.
    mean = np.median(every, axis=0)
    noise = stats.median_abs_deviation(np.concatenate(steps), axis=0, scale="normal") / np.sqrt(2)
    sd = np.sqrt(np.pi / 2 / max(min(lengths / _SHARED_MM, len(every)), 1.0)) * noise
    said = "differ from" if (np.abs(mean) > _CLEAR * sd).any() else "agree with"
    yield (
        f"tip in images: {len(every)} detections {said} the model: {mean[0]:+.2g} mm along u and {mean[1]:+.2g} mm "
        f"along v (sd {sd.max():.1g} mm)"
    )


def _plant(model: Model) -> Model:
    """Return the model without effects of its sensors."""
    plant = model.plant if isinstance(model, AugmentedModel) else model
    return plant.whole if isinstance(plant, AugmentedModel) else plant


def _with(columns: Sequence[str], records: Sequence[Record]) -> list[Record]:
    return [record for record in records if record.role is not Role.NOISE and set(columns) <= set(record.columns)]


def _unused(lacks_table: bool, table: str) -> str:
    lacks = f"the model file has no [{table}]" if lacks_table else "the model has no path of the tip in 3D"
    return f"are not used, because {lacks}"


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
