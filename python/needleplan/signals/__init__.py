"""Signals: motions, records and filters. This package contains no needle or tissue models."""

from needleplan.signals._averaged import (
    AveragedMotion,
    SpannedMotion,
    averaged_motion,
    averaged_record,
    parts_of,
)
from needleplan.signals._filters import (
    AverageStream,
    DiscreteFilter,
    FilterStream,
    MovingAverage,
    VelocityMethod,
    VelocityRecord,
    velocity_without_delay,
)
from needleplan.signals._frame import FrameName, RecordFrame
from needleplan.signals._given import records_of
from needleplan.signals._lag import lag_taps, lagged, recurrence
from needleplan.signals._moves import LEAST_ROOM_MM, Dwell, Insert, Limits, Program, Rotate
from needleplan.signals._noise import SensorNoise, combine_axes, fit_axes, fit_noise, scatter
from needleplan.signals._observer import FAST_ALPHA1, HighGainObserver, ObserverForm, ObserverStream, Projection
from needleplan.signals._profiles import Start, cycles, insertion_cycles, lspb, sinusoid
from needleplan.signals._record import (
    FIBRE_COLUMNS,
    IMAGE_COLUMNS,
    UNITS,
    Array,
    Motion,
    Record,
    Role,
    require_one_frame,
)
from needleplan.signals._rigid_error import RigidError
from needleplan.signals._sensor_faults import fault_notes, saturated_samples, spike_samples, still_parts
from needleplan.signals._sine import Sine, dominant_frequency_hz, lag_rad, sine_at
from needleplan.signals._standing import MeasuredMotion, rest_before_entry
from needleplan.signals._tracker import TrackerEstimate, TrackerFilter, TrackerModel, TrackerStream

__all__ = [
    "FAST_ALPHA1",
    "FIBRE_COLUMNS",
    "IMAGE_COLUMNS",
    "LEAST_ROOM_MM",
    "UNITS",
    "Array",
    "AverageStream",
    "AveragedMotion",
    "DiscreteFilter",
    "Dwell",
    "FilterStream",
    "FrameName",
    "HighGainObserver",
    "Insert",
    "Limits",
    "MeasuredMotion",
    "Motion",
    "MovingAverage",
    "ObserverForm",
    "ObserverStream",
    "Program",
    "Projection",
    "Record",
    "RecordFrame",
    "RigidError",
    "Role",
    "Rotate",
    "SensorNoise",
    "Sine",
    "SpannedMotion",
    "Start",
    "TrackerEstimate",
    "TrackerFilter",
    "TrackerModel",
    "TrackerStream",
    "VelocityMethod",
    "VelocityRecord",
    "averaged_motion",
    "averaged_record",
    "combine_axes",
    "cycles",
    "dominant_frequency_hz",
    "fault_notes",
    "fit_axes",
    "fit_noise",
    "insertion_cycles",
    "lag_rad",
    "lag_taps",
    "lagged",
    "lspb",
    "parts_of",
    "records_of",
    "recurrence",
    "require_one_frame",
    "rest_before_entry",
    "saturated_samples",
    "scatter",
    "sine_at",
    "sinusoid",
    "spike_samples",
    "still_parts",
    "velocity_without_delay",
]
