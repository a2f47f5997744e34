"""Motions that drive models, and records of trials."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from needleplan.artifacts import ShortRepr
from needleplan.errors import DataError, Mistake
from needleplan.signals._frame import RecordFrame

__all__ = [
    "FIBRE_COLUMNS",
    "IMAGE_COLUMNS",
    "UNITS",
    "Array",
    "ComplexArray",
    "Motion",
    "Record",
    "Role",
    "last_direction",
    "require_one_frame",
]

Array = NDArray[np.float64]
"""Array of double-precision numbers; docstrings state the shape."""

ComplexArray = NDArray[np.complex128]
"""Array of complex numbers, for gains, poles and zeros."""


@dataclass(frozen=True)
class Motion(ShortRepr):
    """A sampled motion of the needle; all fields have the shape (samples,), or are scalars for one instant.

    Parameters
    ----------
    time_s : Array
        Increasing times.
    depth_mm : Array
        Inserted depth.
    velocity_mm_s : Array
        Velocity along the axis.
    direction : Array
        Sign of the velocity: +1 in, -1 out. At rest it keeps its last value; it is 0 before the first movement.
    angle_rad : Array
        Rotation of the base about the axis of the needle.

    Examples
    --------
    >>> import numpy as np
    >>> from needleplan.signals import Motion
    >>> time = np.linspace(0.0, 2.0, 5)
    >>> Motion.sampled(time, 10.0 * time).velocity_mm_s
    array([10., 10., 10., 10., 10.])
    """

    time_s: Array
    depth_mm: Array
    velocity_mm_s: Array
    direction: Array
    angle_rad: Array

    @classmethod
    def sampled(
        cls, time_s: Array, depth_mm: Array, velocity_mm_s: Array | None = None, angle_rad: Array | None = None
    ) -> Motion:
        """Return the motion with the given samples; all arrays have the shape (samples,).

        Parameters
        ----------
        time_s, depth_mm : Array
            Times and depths.
        velocity_mm_s : Array, optional
            Velocities; their signs give the directions. The default is the central difference of the depth.
        angle_rad : Array, optional
            Rotation of the base. The default is zero.

        Returns
        -------
        Motion
            The motion.

        Raises
        ------
        DataError
            If there are fewer than two samples, the shapes differ, a number is not finite, or the times do not
            increase.
        """
        time = np.asarray(time_s, float)
        depth = np.asarray(depth_mm, float)
        if time.ndim != 1 or time.shape != depth.shape or time.size < 2:
            rule = f"must be a row of at least two numbers, as long as time_s, {time.shape}"
            raise DataError(Mistake("depth_mm", f"shape {depth.shape}", rule))
        if velocity_mm_s is None:
            if not (np.diff(time) > 0).all():
                raise DataError(Mistake("time_s", "", "must increase from sample to sample"))
            velocity = _central_difference(time, depth)
        else:
            velocity = np.asarray(velocity_mm_s, float)
        angle = np.zeros_like(time) if angle_rad is None else np.asarray(angle_rad, float)
        for name, values in (("time_s", time), ("depth_mm", depth), ("velocity_mm_s", velocity), ("angle_rad", angle)):
            if values.shape != time.shape:
                raise DataError(Mistake(name, f"shape {values.shape}", f"must be as long as time_s {time.shape}"))
            if not np.isfinite(values).all():
                first = int(np.flatnonzero(~np.isfinite(values))[0])
                raise DataError(Mistake(f"{name}[{first}]", str(values[first]), "must be a finite number"))
        if not (np.diff(time) > 0).all():
            first = int(np.flatnonzero(np.diff(time) <= 0)[0]) + 1
            raise DataError(Mistake(f"time_s[{first}]", str(time[first]), "must be greater than the time before it"))
        return cls(time, depth, velocity, last_direction(velocity), angle)

    def __len__(self) -> int:
        return int(np.size(self.time_s))

    def __getitem__(self, index: object) -> Motion:
        """Return the motion at selected samples (slice, mask or indices), or at one instant (integer)."""
        return Motion(*(getattr(self, each.name)[index] for each in fields(Motion)))

    def between(self, fraction: float) -> Motion:
        """Return the motion at `fraction` of each interval between samples, shape (samples - 1,).

        Time, depth, velocity and angle are interpolated linearly. The direction is the sign of the interpolated
        velocity, or the direction at the sample before if this velocity is zero.
        """
        rows = {each.name: getattr(self, each.name) for each in fields(Motion) if each.name != "direction"}
        moved = {name: values[:-1] + fraction * np.diff(values) for name, values in rows.items()}
        sign = np.sign(moved["velocity_mm_s"])
        return Motion(**moved, direction=np.where(sign == 0, self.direction[:-1], sign))

    @property
    def interval_s(self) -> Array:
        """Intervals between samples, shape (samples - 1,)."""
        return np.diff(self.time_s)

    @property
    def acceleration_mm_s2(self) -> Array:
        """Mean acceleration from the midpoint before to the midpoint after each sample, shape (samples,).

        The velocity at a midpoint is the median of three: of the two lines through the samples before and after it,
        and of their mean. So it is exact where the velocity is straight with a kink, as that of robots is.
        """
        time, velocity = self.time_s, self.velocity_mm_s
        if len(self) < 3:
            return np.zeros(len(self)) if len(self) < 2 else np.gradient(velocity, time)
        half, slope = np.diff(time) / 2, np.diff(velocity) / np.diff(time)
        before, after = np.append(slope[0], slope[:-1]), np.append(slope[1:], slope[-1])
        lines = velocity[:-1] + half * before, velocity[1:] - half * after, velocity[:-1] + half * slope
        middle = np.median(lines, axis=0)
        edges = np.concatenate([time[:1], (time[:-1] + time[1:]) / 2, time[-1:]])
        return np.asarray(np.diff(np.concatenate([velocity[:1], middle, velocity[-1:]])) / np.diff(edges))


def _central_difference(time: Array, depth: Array) -> Array:
    """Return the derivative of the depth (mm/s), shape (samples,): of second order, but of first order at both ends.

    The derivative is exactly zero where the depth is constant. NumPy's gradient leaves a rounding error there, and
    `last_direction` would return the sign of this error.
    """
    step = np.diff(time)
    slope = np.diff(depth) / step
    middle = (step[1:] * slope[:-1] + step[:-1] * slope[1:]) / (step[1:] + step[:-1])
    return np.concatenate([slope[:1], middle, slope[-1:]])


def last_direction(velocity: Array) -> Array:
    """Return the direction at each sample, shape (samples,): the sign of the velocity.

    If the velocity is zero, the direction is the last non-zero sign before it, or 0 if there is none.
    """
    sign = np.sign(velocity)
    moving = np.flatnonzero(sign)
    if not moving.size:
        return sign
    last = np.searchsorted(moving, np.arange(sign.size), side="right") - 1
    return np.where(last >= 0, sign[moving[np.maximum(last, 0)]], 0.0)


FIBRE_COLUMNS = tuple(f"fbg{sensor}_{axis}_per_mm" for sensor in range(1, 9) for axis in "yz")
"""Columns of the curvatures of up to eight sensors along the needle, the nearest to the tip first.

y is the curvature toward the bevel and z the curvature a quarter turn from it, in the axes of the needle.
"""

IMAGE_COLUMNS = ("image_u_mm", "image_v_mm")
"""Columns of the position of the tip in the image of an ultrasound probe."""

UNITS = {
    "time_s": "s",
    "depth_mm": "mm",
    "velocity_mm_s": "mm/s",
    "force_n": "N",
    "torque_n_mm": "N mm",
    "angle_rad": "rad",
    "x_mm": "mm",
    "y_mm": "mm",
    "z_mm": "mm",
    "duty_cycle": "parts of 1",
    **dict.fromkeys(FIBRE_COLUMNS, "1/mm"),
    **dict.fromkeys(IMAGE_COLUMNS, "mm"),
}
"""Unit of every column that a record can have, by the name of the column in data files."""


class Role(StrEnum):
    """The purpose of a trial."""

    TRAIN = "train"
    """For the identification of parameters."""

    HOLDOUT = "holdout"
    """For the validation of identified models only."""

    REFERENCE = "reference"
    """Without the effects that a diagnosis looks for: shows what is normal. Identification trains with it."""

    NOISE = "noise"
    """A measurement at rest, for the noise of the sensors."""


@dataclass(frozen=True)
class Record(ShortRepr):
    """One trial: named columns of one length in the units of `UNITS`.

    The constructor raises DataError if `time_s` is missing, a name is not in `UNITS`, or the shapes differ.

    Parameters
    ----------
    columns : dict of str to Array
        Columns of the shape (samples,); `time_s` is required.
    trial : str
        Name of the trial.
    role : Role
        Purpose of the trial.
    phase : tuple of str
        Name of the phase of every sample, or empty.
    digest : str
        Digest of the source file; empty for synthetic data.
    notes : tuple of str
        Remarks of the program that read the file, such as rows that were left out or suspicious units.
    frame : RecordFrame
        Frame of the depths and positions: name, origin, and who said so. The default is unknown.
    begun_s : float or None
        Time of the first sample, seconds since 1970; None if the file does not say.

    Examples
    --------
    >>> import numpy as np
    >>> from needleplan.signals import Record
    >>> record = Record({"time_s": np.arange(3.0), "depth_mm": np.arange(3.0), "force_n": np.full(3, 0.2)})
    >>> len(record), float(record["force_n"][0])
    (3, 0.2)
    """

    columns: dict[str, Array]
    trial: str = ""
    role: Role = Role.TRAIN
    phase: tuple[str, ...] = ()
    digest: str = ""
    notes: tuple[str, ...] = field(default=())
    frame: RecordFrame = RecordFrame()
    begun_s: float | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.columns, Mapping):
            rule = "must be a mapping from the names of columns to numbers"
            raise DataError(Mistake("columns", f"<{type(self.columns).__name__}>", rule), self.trial)
        if "time_s" not in self.columns:
            raise DataError(Mistake("time_s", "", "is missing"))
        columns = {}
        for name, values in self.columns.items():
            try:
                columns[name] = np.asarray(values, float)
            except (TypeError, ValueError) as error:
                raise DataError(Mistake(name, "", f"must hold numbers: {error}"), self.trial) from None
        unknown = [Mistake(name, "", f"must be one of {', '.join(UNITS)}") for name in columns if name not in UNITS]
        shape = columns["time_s"].shape
        unknown += [
            Mistake(name, f"shape {values.shape}", f"must be a row as long as time_s, {shape}")
            for name, values in columns.items()
            if values.shape != shape or values.ndim != 1
        ]
        if unknown:
            raise DataError(unknown, self.trial)
        object.__setattr__(self, "columns", columns)

    def __len__(self) -> int:
        return int(self.columns["time_s"].size)

    def __getitem__(self, name: str) -> Array:
        """Return a column, shape (samples,). Raises DataError if the trial does not have the column."""
        if name not in self.columns:
            raise DataError(Mistake(name, "", "is missing, and is needed here"), self.trial)
        return self.columns[name]

    def motion(self) -> Motion:
        """Return the motion of the trial from `depth_mm` and, if present, `velocity_mm_s` and `angle_rad`."""
        return Motion.sampled(
            self["time_s"], self["depth_mm"], self.columns.get("velocity_mm_s"), self.columns.get("angle_rad")
        )

    def with_column(self, name: str, values: Array) -> Record:
        """Return the record with a column added or replaced.

        Parameters
        ----------
        name : str
            Name of the column.
        values : numpy.ndarray
            Values, shape (samples,), in the unit that the name states.

        Returns
        -------
        Record
        """
        return replace(self, columns={**self.columns, name: values})

    def select(self, rows: Array | slice) -> Record:
        """Return the record with only the given rows (slice, mask or indices)."""
        columns = {name: values[rows] for name, values in self.columns.items()}
        phase = tuple(np.asarray(self.phase, object)[rows]) if self.phase else ()
        return replace(self, columns=columns, phase=phase)


def require_one_frame(records: Iterable[Record]) -> RecordFrame:
    """Return the frame that the trials of one fit, diagnosis or comparison have in common.

    Parameters
    ----------
    records : iterable of Record
        The records; those of noise are at rest and need no frame.

    Returns
    -------
    RecordFrame
        The frame of the first trial; an unknown one if there are none.

    Raises
    ------
    DataError
        If name or origin of the frames differ, with every trial that differs from the first one. An unknown frame
        differs from every known one.

    Examples
    --------
    >>> from needleplan.signals import FrameName, Record, RecordFrame, require_one_frame
    >>> surface = RecordFrame(FrameName.SURFACE, "entry")
    >>> records = [Record({"time_s": [0.0, 0.1]}, name, frame=surface) for name in ("first", "second")]
    >>> require_one_frame(records).name
    <FrameName.SURFACE: 'surface'>
    """
    trials = [record for record in records if record.role is not Role.NOISE]
    if not trials:
        return RecordFrame()
    first = trials[0]
    rule = (
        f"must be that of {first.trial or 'the first trial'}: {first.frame}. Bring all trials to one frame; if they "
        "are in one, name it in a column coordinate_frame, or with --frame for files that do not say"
    )
    mistakes = [
        Mistake(
            f"frame of {trial.trial or 'a trial'}",
            trial.frame.text,
            f"{trial.frame.provenance}; {rule}" if trial.frame.provenance else rule,
        )
        for trial in trials
        if (trial.frame.name, trial.frame.origin) != (first.frame.name, first.frame.origin)
    ]
    if mistakes:
        raise DataError(mistakes)
    return first.frame
