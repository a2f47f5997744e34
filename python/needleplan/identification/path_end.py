"""The end of an insertion, predicted from its beginning and from earlier insertions.

The mean path of the earlier insertions, in the planes xy and xz, has an entry pose, a curvature by depth and a
direction of bending. The tip filter, which `needleplan insert` has too, begins with this path, takes the measured
positions of the beginning down to the depth u, and continues to the end: equations (1) to (6) of
docs/explanation/tip-estimation.md.

The deviations of the filter follow from its settings, and these needles scatter less or more. So each earlier insertion
is predicted from the others in the same way, also from its beginning down to u. Its errors, measured minus predicted,
follow the law of a series (`population.next_insertion`) with a level around 0 and without a drift: a needle that
becomes straight ends on one side of its prediction in all insertions. The scatter that is assumed without them is that
of a direction after the rest of the path. The forecast of the error of this insertion is added to the prediction of the
filter, and its region is the region of the end.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needleplan.artifacts import ShortRepr
from needleplan.devices import FibreSample, ImageSample, PoseSample, StageSample, Stamp
from needleplan.errors import DataError, Mistake
from needleplan.estimation import Registration, TipFilter, TipSettings
from needleplan.identification._curvature_trial import insertion_of
from needleplan.identification._entry_population import TipPrediction, mean_path, predict_tip
from needleplan.identification._frames import frame_remarks, odd_remarks
from needleplan.identification._insertion_path import EntryPath
from needleplan.identification._series_order import in_order, require_different
from needleplan.identification._shape_choice import shaped_paths
from needleplan.identification.population import deviation_mm, next_insertion
from needleplan.models.deflection import FibreSensors
from needleplan.models.path import ImagePlane
from needleplan.recording import read_records
from needleplan.signals import IMAGE_COLUMNS, Array, Record, Role, records_of, require_one_frame

__all__ = ["PredictedEnd", "predict_end"]

# Standard deviation (rad) of the direction of a measured position: it is unknown.
_UNKNOWN_RAD = 2.0

# Length (mm) of the path, centred at the end, whose samples give the measured end.
_AT_END_MM = 2.0

_NANO = 1e9


@dataclass(frozen=True)
class _Sensors:
    """Curvature sensors, image plane and age (s) of an image when it arrives; None: their columns are not used."""

    fibre: FibreSensors | None = None
    plane: ImagePlane | None = None
    image_latency_s: float = 0.0

    def curvatures(self, record: Record) -> Array:
        """Return the curvatures (1/mm) of a record, shape (samples, sensors, 2); no sensors without `fibre`."""
        return self.fibre.measured(record) if self.fibre else np.empty((len(record), 0, 2))

    def places(self, record: Record) -> Array:
        """Return the positions (mm) of the tip in images, shape (samples, 2); NaN without `plane`."""
        if self.plane is None:
            return np.full((len(record), 2), np.nan)
        return np.stack([record[name] for name in IMAGE_COLUMNS], axis=1)


@dataclass(frozen=True)
class PredictedEnd(ShortRepr):
    """Predicted position (mm) of the tip at the depth `depth_mm`, in the frame of the records.

    - `y_mm`, `z_mm`: predicted position. All values of z are None if z_mm is missing or constant in a record.
    - `y_region_mm`, `z_region_mm`: lower and upper limit of a rectangle that contains the tip with probability 95 %.
    - `until_mm`, `samples`: depth and number of the samples of this insertion that the prediction uses.
    - `before`: prediction without samples of this insertion, from the earlier insertions alone.
    - `remarks`: earlier insertions that seem not to belong to the others, and their order.
    - `measured_mm`: measured y and z at `depth_mm`; None if the record ends at a smaller depth.
    """

    depth_mm: float
    y_mm: float
    y_region_mm: tuple[float, float]
    z_mm: float | None
    z_region_mm: tuple[float, float] | None
    until_mm: float
    samples: int
    before: TipPrediction
    measured_mm: tuple[float, float | None] | None
    remarks: tuple[str, ...] = ()

    @property
    def error_mm(self) -> float | None:
        """Distance (mm) of the predicted from the measured end; None if it was not measured."""
        return None if self.measured_mm is None else _apart((self.y_mm, self.z_mm), self.measured_mm)

    @property
    def inside(self) -> bool | None:
        """Whether the measured end is in the region; None if it was not measured."""
        if self.measured_mm is None:
            return None
        sides = [(self.y_region_mm, self.measured_mm[0])]
        if self.z_region_mm is not None and self.measured_mm[1] is not None:
            sides.append((self.z_region_mm, self.measured_mm[1]))
        return all(low <= value <= high for (low, high), value in sides)

    def record(self) -> dict[str, Any]:
        """Return the JSON record that `needleplan predict --json` prints."""
        values = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "before"}
        return values | {
            "error_mm": self.error_mm, "inside": self.inside,
            "before_mm": [self.before.y_mm, self.before.z_mm],
            "before_region_mm": [self.before.y_region_mm, self.before.z_region_mm],
        }  # fmt: skip

    def lines(self) -> list[str]:
        """Return the lines that `needleplan predict` prints."""
        told = [f"end at a depth of {self.depth_mm:.4g} mm, from {self.samples} samples to {self.until_mm:.4g} mm"]
        for axis, value, region, earlier in (
            ("y", self.y_mm, self.y_region_mm, self.before.y_mm),
            ("z", self.z_mm, self.z_region_mm, self.before.z_mm),
        ):
            if value is not None and region is not None:
                reach = f"(95 % region {region[0]:.2f} to {region[1]:.2f})"
                told.append(f"  {axis} {value:.2f} mm {reach}; by the earlier insertions alone {earlier:.2f} mm")
        if self.measured_mm is not None:
            y, z = self.measured_mm
            place = f"y {y:.2f} mm" + (f", z {z:.2f} mm" if z is not None else "")
            alone = _apart((self.before.y_mm, self.before.z_mm), self.measured_mm)
            where = "in" if self.inside else "outside of"
            told.append(
                f"  measured {place}: {self.error_mm:.2f} mm from it, {where} the region; {alone:.2f} mm from the "
                "prediction by the earlier insertions alone"
            )
        return told


def predict_end(
    beginning: object,
    earlier: object,
    *,
    depth_mm: float | None = None,
    until_mm: float | None = None,
    skip_mm: float = 0.0,
    layers: int | None = None,
    fibre: FibreSensors | None = None,
    plane: ImagePlane | None = None,
    image_latency_s: float = 0.0,
) -> PredictedEnd:
    """Predict the end of an insertion without rotation from its beginning and from earlier insertions.

    Parameters
    ----------
    beginning : Record, table of columns such as a DataFrame, or path of a data file
        The insertion: time_s, depth_mm (or x_mm) and y_mm in mm; also z_mm if all records have it.
    earlier : list of these
        Earlier insertions of the needle into the same tissue, in the same frame.
    depth_mm : float, optional
        Depth of the end. Default: the depth that all earlier insertions reach.
    until_mm : float, optional
        Samples beyond this depth are left out. Default: all samples count.
    skip_mm : float
        Depth above which samples are left out.
    layers : int, optional
        Number of layers of the curvature, as of `curvature.identify`.
    fibre : FibreSensors, optional
        Curvature sensors of the needle, whose columns all records have; they continue the path where the position of
        the tip is missing.
    plane : ImagePlane, optional
        Image plane of an ultrasound probe in the frame of the records, all of which have the columns of its images.
    image_latency_s : float
        Age of an image when it arrives.

    Returns
    -------
    PredictedEnd
        The predicted end.

    Raises
    ------
    DataError
        The beginning has no sample, or has passed the end; frames differ, or a record lacks a column.

    Examples
    --------
    >>> import numpy as np
    >>> from needleplan.identification import predict_end
    >>> from needleplan.signals import Record
    >>> def arc(curvature, length, name):
    ...     depth = np.arange(0.0, length, 1.0)
    ...     y = curvature * depth**2 / 2 + np.random.default_rng(len(name)).normal(0, 0.05, depth.size)
    ...     return Record({"time_s": depth / 5, "x_mm": depth, "y_mm": y, "z_mm": 0 * depth}, name)
    >>> end = predict_end(arc(0.0011, 50, "third"), [arc(0.001, 100, "a"), arc(0.0012, 100, "bb")], depth_mm=95)
    >>> abs(end.y_mm - 0.0011 * 95**2 / 2) < 0.5
    True

    """
    for name, value in (("depth_mm", depth_mm), ("until_mm", until_mm)):
        if value is not None and not 0 < value < np.inf:
            raise DataError(Mistake(name, f"{value:g}", "must be a finite number of mm above 0"))
    begun = records_of(beginning, read_records)
    if len(begun) != 1:
        raise DataError(Mistake("beginning", "", f"must hold one insertion, not {len(begun)}"))
    (record,) = begun
    trials, remarks = in_order([replace(each, role=Role.TRAIN) for each in records_of(earlier, read_records)])
    require_one_frame([record, *trials])
    require_different([record, *trials])
    in_space = all("z_mm" in trial.columns and np.ptp(trial["z_mm"]) > 0 for trial in (record, *trials))
    fitted = [
        [insertion_of(trial, plane=plane, segments=1, skip_mm=skip_mm) for trial in trials]
        for plane in ("xy", "xz")[: 1 + in_space]
    ]
    remarks += [*frame_remarks(fitted[0]), *odd_remarks(fitted[0])]
    planes = [shaped_paths(plane, layers).paths for plane in fitted]
    end = min(path.deepest_mm for path in planes[0]) if depth_mm is None else depth_mm
    sensors = _Sensors(fibre, plane, image_latency_s)
    used = _used(record, skip_mm, np.inf if until_mm is None else until_mm, sensors)
    if not used.size:
        raise DataError(
            Mistake("depth_mm", "", "has no sample with a position between skip_mm and until_mm"), record.trial
        )
    until = float(np.maximum.accumulate(_depth(record))[used[-1]])
    if until >= end:
        rule = f"has passed the end at {end:.4g} mm; until_mm leaves samples out"
        raise DataError(Mistake("depth_mm", f"{until:.4g}", rule), record.trial)
    errors = [_error(planes, number, trial, end, until, skip_mm, sensors) for number, trial in enumerate(trials)]
    known = np.array([error for error in errors if error is not None]).reshape(-1, len(planes))
    error = next_insertion(known, deviation_mm(end - until), level_sd=1.0, ordered=False)
    place = _predicted(planes, record, used, end, sensors)
    (y, *z), (side, *second) = (place + error.values).tolist(), error.moved(place).regions
    return PredictedEnd(
        end, y, side, z[0] if in_space else None, second[0] if in_space else None,
        until, used.size, predict_tip(planes[0], planes[1] if in_space else [], end), _measured(record, end, in_space),
        tuple(remarks),
    )  # fmt: skip


def _error(
    planes: Sequence[Sequence[EntryPath]],
    number: int,
    trial: Record,
    end_mm: float,
    until_mm: float,
    skip_mm: float,
    sensors: _Sensors,
) -> Array | None:
    """Return the measured minus the predicted end (mm) of an earlier insertion, predicted from the others.

    None if there is no other insertion, or the beginning or the end of this one was not measured.
    """
    others = [[*paths[:number], *paths[number + 1 :]] for paths in planes]
    rows, measured = _used(trial, skip_mm, until_mm, sensors), _measured(trial, end_mm, len(planes) > 1)
    if not others[0] or not rows.size or measured is None:
        return None
    return np.array(measured[: len(planes)], float) - _predicted(others, trial, rows, end_mm, sensors)


def _used(record: Record, skip_mm: float, until_mm: float, sensors: _Sensors) -> NDArray[np.intp]:
    """Return the numbers of the samples of a record that count."""
    depth = np.maximum.accumulate(_depth(record))
    known = np.isfinite(record["y_mm"])
    known |= np.isfinite(sensors.curvatures(record)).any(axis=(1, 2)) | np.isfinite(sensors.places(record)).all(axis=1)
    return np.flatnonzero(known & (depth > skip_mm) & (depth <= until_mm))


def _predicted(
    planes: Sequence[Sequence[EntryPath]],
    record: Record,
    used: NDArray[np.intp],
    end_mm: float,
    sensors: _Sensors,
) -> Array:
    """Return y, or y and z (mm), at the end by the filter, from samples of a record and earlier paths."""
    depth = np.maximum.accumulate(_depth(record))
    start, roll, bend = _begun(planes, float(depth[used[-1]]))
    settings = TipSettings(angle_sd_rad=_UNKNOWN_RAD, image_latency_s=sensors.image_latency_s)
    tip_filter = TipFilter(Registration(), start, lambda x_mm, *_: bend(x_mm), settings, sensors.fibre, sensors.plane)
    curvatures, seen = sensors.curvatures(record).tolist(), sensors.places(record).tolist()
    along = record["x_mm"] if "x_mm" in record.columns else _depth(record)
    aside = record["z_mm"] if len(planes) > 1 else np.zeros(len(record))
    for number, row in enumerate(used.tolist()):
        now = Stamp(round(_NANO * (1 + record["time_s"][row] - record["time_s"][0])), number)
        tip_filter.predict(StageSample(now, float(depth[row]), 0.0, roll, moving=True))
        place = (float(along[row]), float(record["y_mm"][row]), float(aside[row]))
        tip_filter.update(PoseSample(now, place, (1.0, 0.0, 0.0, 0.0), math.nan))
        if sensors.fibre:
            tip_filter.update_fibre(FibreSample(now, tuple((y, z) for y, z in curvatures[row])))
        if sensors.plane:
            tip_filter.update_image(ImageSample(now, *seen[row]))
    state, _ = tip_filter.ahead(end_mm - float(depth[used[-1]]))
    return state[1 : 1 + len(planes)]


def _begun(
    planes: Sequence[Sequence[EntryPath]], until_mm: float
) -> tuple[tuple[float, ...], float, Callable[[float], float]]:
    """Return the mean of earlier paths: entry pose, roll of bending (rad), and curvature (1/mm) at an x (mm).

    `planes` holds the paths in the plane xy, and in 3D also those in xz. The pose is x, y (mm), heading (rad), z (mm),
    elevation (rad); z and elevation are 0 in the plane. The needle is assumed to bend in one plane: the roll is the
    direction of its mean curvature up to the depth `until_mm`, as a calibration of the base would find it, and the
    curvature is that of the plane xy, scaled to the plane of bending.
    """
    means = [mean_path(paths) for paths in planes]
    bends = [float(mean.shape.curvature(mean.values[2:], np.linspace(0, until_mm, 101)).mean()) for mean in means]
    in_space = len(means) > 1
    y, heading = means[0].values[:2].tolist()
    z, elevation = means[1].values[:2].tolist() if in_space else (0.0, 0.0)
    sideways, upwards = bends[0], bends[1] if in_space else 0.0
    scale = math.hypot(upwards, sideways) / (sideways or 1.0)
    flat, coefficients = means[0].shape, means[0].values[2:]

    def bend(x_mm: float) -> float:
        return scale * float(flat.curvature(coefficients, np.array([x_mm]))[0])

    return (0.0, y, heading, z, elevation), math.atan2(upwards, sideways), bend


def _depth(record: Record) -> Array:
    """Return the depth (mm); x if the record has no depth."""
    return record["depth_mm" if "depth_mm" in record.columns else "x_mm"]


def _measured(record: Record, end_mm: float, in_space: bool) -> tuple[float, float | None] | None:
    """Return the medians of y and z (mm) about the end, or None if no sample is there."""
    near = (np.abs(_depth(record) - end_mm) <= _AT_END_MM / 2) & np.isfinite(record["y_mm"])
    if not near.any():
        return None
    return float(np.median(record["y_mm"][near])), float(np.median(record["z_mm"][near])) if in_space else None


def _apart(one: tuple[float, float | None], other: tuple[float, float | None]) -> float:
    """Return the distance (mm) of two ends, in 3D if both have z."""
    return math.hypot(one[0] - other[0], 0.0 if one[1] is None or other[1] is None else one[1] - other[1])
