"""Signals: motions, records and filters; nothing here knows a needle or a tissue."""

from needleplan.signals.array import Array, ComplexArray
from needleplan.signals.discrete import DiscreteFilter, FilterStream
from needleplan.signals.harmonic import Sine, dominant_frequency_hz, lag_rad, sine_at
from needleplan.signals.motion import Motion
from needleplan.signals.moving_average import AverageStream, MovingAverage
from needleplan.signals.observer import FAST_ALPHA1, HighGainObserver, ObserverForm, ObserverStream, Projection
from needleplan.signals.profiles import insertion_cycles, lspb
from needleplan.signals.record import Record, Role
from needleplan.signals.sinusoid import Start, cycles, sinusoid
from needleplan.signals.tracker import TrackerEstimate, TrackerFilter, TrackerModel, TrackerStream
from needleplan.signals.velocity import VelocityMethod, VelocityRecord, velocity_without_delay

__all__ = [
    "FAST_ALPHA1",
    "Array",
    "AverageStream",
    "ComplexArray",
    "DiscreteFilter",
    "FilterStream",
    "HighGainObserver",
    "Motion",
    "MovingAverage",
    "ObserverForm",
    "ObserverStream",
    "Projection",
    "Record",
    "Role",
    "Sine",
    "Start",
    "TrackerEstimate",
    "TrackerFilter",
    "TrackerModel",
    "TrackerStream",
    "VelocityMethod",
    "VelocityRecord",
    "cycles",
    "dominant_frequency_hz",
    "insertion_cycles",
    "lag_rad",
    "lspb",
    "sine_at",
    "sinusoid",
    "velocity_without_delay",
]
