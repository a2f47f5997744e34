"""The interfaces of stage, force sensor and tracker, their samples, and the validation common to all trackers.

A device is opened by its address (`udp://192.168.1.10:5005`), used as a context manager, and read with a timeout. Each
sample has a time and a sequence number, and is returned once. If the device reports a problem, the sample is not GOOD,
and its `notes` name the problem. If the device cannot be used any more, its methods raise DeviceFault with the cause.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from enum import StrEnum
from types import TracebackType
from typing import ClassVar, Protocol, Self

from needleplan.artifacts import CallRepr
from needleplan.devices.supervision import StageSupervisor
from needleplan.errors import LinkClosed

__all__ = [
    "Closing",
    "Device",
    "FibreSample",
    "ForceSample",
    "ForceSensor",
    "Health",
    "ImageSample",
    "PoseSample",
    "PoseValidator",
    "Sample",
    "SampledDevice",
    "Stage",
    "StageSample",
    "Stamp",
    "Tracker",
]

_FARTHEST_MM = 1e5  # largest coordinate of a coil; larger numbers are not a pose
_NAN = math.nan

_Triple = tuple[float, float, float]
_Quaternion = tuple[float, float, float, float]


class Closing(ABC):
    """Abstract base of objects that close at the end of their `with` block."""

    @abstractmethod
    def close(self) -> None:
        """Release all resources; closing again does nothing."""

    @contextmanager
    def closed_if_failing(self) -> Iterator[None]:
        """Close the object if the block fails, as at the end of a constructor."""
        try:
            yield
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class Health(StrEnum):
    """Whether a sample may be used."""

    GOOD = "good"
    SUSPECT = "suspect"
    """The device reports a problem, such as saturation or a bad fit; the sample must not be used for control."""

    MISSING = "missing"
    """The device answered without a measurement, for example because the coil is not visible."""


@dataclass(frozen=True)
class Stamp:
    """Arrival time and number of a sample.

    - `received_ns` is the time of arrival on the monotonic clock of this machine.
    - `sequence` is the number of the sample, from the device or, if the device sends no numbers, from its driver.
    - `lost` is the number of samples lost immediately before this sample.
    - `device_time_s` is the time of the sample on the clock of the device, or its sample count divided by its sample
      rate; None if the device sends neither. Its rate must differ from this machine's clock by at most 100 ppm, because
      the guard computes the age of a sample from it.
    """

    received_ns: int
    sequence: int
    lost: int = 0
    device_time_s: float | None = None


@dataclass(frozen=True)
class ForceSample(CallRepr):
    """A wrench at the base of the needle in N and N mm, in the frame of the sensor."""

    stamp: Stamp
    force_n: tuple[float, float, float]
    torque_n_mm: tuple[float, float, float]
    health: Health = Health.GOOD
    notes: tuple[str, ...] = field(default=())


@dataclass(frozen=True)
class PoseSample(CallRepr):
    """The pose of a tracked coil: position in mm, and a unit quaternion (w, x, y, z), in the frame of the tracker.

    The roll of a coil with five degrees of freedom is arbitrary. Position and quaternion are NaN if the health is
    MISSING. `error_mm` is the fit error that the tracker reports, NaN if it reports none.
    """

    stamp: Stamp
    position_mm: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]
    error_mm: float
    health: Health = Health.GOOD
    notes: tuple[str, ...] = field(default=())


@dataclass(frozen=True)
class FibreSample(CallRepr):
    """Curvatures of the needle in 1/mm at the sensors along its length, the nearest to the tip first.

    Each pair is the curvature toward the bevel, and the curvature a quarter turn from it, in the axes of the needle;
    NaN if a sensor is not readable.
    """

    stamp: Stamp
    curvatures_per_mm: tuple[tuple[float, float], ...]
    health: Health = Health.GOOD
    notes: tuple[str, ...] = field(default=())


@dataclass(frozen=True)
class ImageSample(CallRepr):
    """Position of the tip in the image of an ultrasound probe: coordinates u and v in mm, in the axes of the image.

    Both are NaN, and the health is MISSING, if the tip was not detected.
    """

    stamp: Stamp
    u_mm: float
    v_mm: float
    health: Health = Health.GOOD
    notes: tuple[str, ...] = field(default=())


@dataclass(frozen=True)
class StageSample(CallRepr):
    """State of the stage: depth (mm, positive into the tissue), velocity (mm/s), roll of the needle base (rad).

    `moving` is true if an axis has not completed its commanded motion.
    """

    stamp: Stamp
    depth_mm: float
    velocity_mm_s: float
    roll_rad: float
    moving: bool
    health: Health = Health.GOOD
    notes: tuple[str, ...] = field(default=())


class Device(Closing):
    """Abstract base of all devices; `noun` names the device in messages."""

    noun: ClassVar[str] = "device"
    _closed: bool = False

    @abstractmethod
    def close(self) -> None:
        """Release the device; a stage stops first. Closing again does nothing."""

    def _require_open(self) -> None:
        """Raise LinkClosed after `close`."""
        if self._closed:
            raise LinkClosed(f"the {self.noun} is closed")


class Stage(Device):
    """Abstract stage, which inserts and rotates the needle. Only one controller at a time may command it."""

    noun = "stage"

    @abstractmethod
    def insert(self, depth_mm: float, velocity_mm_s: float) -> None:
        """Begin a motion to a depth, inwards or outwards.

        Parameters
        ----------
        depth_mm : float
            Depth (mm).
        velocity_mm_s : float
            Positive speed (mm/s).

        Raises
        ------
        DeviceFault
            The stage cannot be used, or refuses the motion.
        """

    @abstractmethod
    def rotate(self, roll_rad: float, velocity_rad_s: float) -> None:
        """Begin a rotation of the needle base to a roll angle.

        Parameters
        ----------
        roll_rad : float
            Roll angle (rad).
        velocity_rad_s : float
            Positive speed (rad/s).

        Raises
        ------
        DeviceFault
            The stage cannot be used, or refuses the motion.
        """

    @abstractmethod
    def stop(self) -> None:
        """Stop both axes at once. `stop` may be called at any time, also during a fault. Raises DeviceFault."""

    def send_stop(self) -> None:
        """Send one stop without waiting for an answer, ahead of the `stop` that follows. Raises DeviceFault.

        A signal handler may call this method while its thread is within another method of the stage, so the method must
        wait for no lock. By default it does nothing.
        """

    @property
    def supervisor(self) -> StageSupervisor | None:
        """The supervisor that stops this stage without the program; None, as by default, if there is none."""
        return None

    @property
    def homed(self) -> bool | None:
        """Whether the stage knows its zero; None if it does not tell, as by default."""
        return None

    def home(self) -> None:
        """Tell the stage that a person has found its zero; by default do nothing. Raises DeviceFault."""

    def unhome(self) -> None:
        """Tell the stage that its zero is lost, until `home`; by default do nothing. Raises DeviceFault."""

    def measure(self, timeout_s: float) -> StageSample | None:
        """Return the next sample as `read` does, also during a fault that `read` would raise; by default call `read`.

        Whether a stage rests must be measured after a fault, too. Raises DeviceFault if the stage does not answer.
        """
        return self.read(timeout_s)

    def heartbeat(self) -> None:
        """Tell the watchdog of the stage that the controller is running. The stage stops if heartbeats cease.

        In an insertion, only the guard calls `heartbeat` (in `control.safety.GuardedStage.tick`). A program without a
        guard calls `heartbeat` in its control loop. A stage without a watchdog does nothing. Raises DeviceFault.
        """

    @abstractmethod
    def read(self, timeout_s: float) -> StageSample | None:
        """Return the next sample, or None after `timeout_s`. Raises DeviceFault."""


class ForceSensor(Device):
    """Abstract force sensor: measures the wrench at the base of the needle."""

    noun = "force sensor"

    @abstractmethod
    def bias(self) -> None:
        """Define the present wrench as zero for all later samples. Raises DeviceFault."""

    @abstractmethod
    def read(self, timeout_s: float) -> ForceSample | None:
        """Return the next sample, or None after `timeout_s`. Raises DeviceFault."""


class Tracker(Device):
    """Abstract tracker: measures the pose of a coil in the tip of the needle."""

    noun = "tracker"

    @abstractmethod
    def read(self, timeout_s: float) -> PoseSample | None:
        """Return the next pose sample, or None after `timeout_s`. Raises DeviceFault."""


class PoseValidator:
    """Base class that converts the poses of one tool to samples and compares each pose with the previous one.

    A sample with notes is SUSPECT. The subclass of each protocol also checks status fields and times, and stores each
    sample in `last`.
    """

    def __init__(self) -> None:
        self.last: PoseSample | None = None

    @staticmethod
    def are_plausible(numbers: Iterable[float]) -> bool:
        """Return whether all `numbers` of a pose are finite and at most 1e5 (100 m if they are lengths in mm)."""
        return all(math.isfinite(number) and abs(number) <= _FARTHEST_MM for number in numbers)

    @staticmethod
    def missing(stamp: Stamp, reason: str, notes: tuple[str, ...]) -> PoseSample:
        """Return a MISSING sample, with `reason` as its first note; position, quaternion and error are NaN."""
        return PoseSample(stamp, (_NAN,) * 3, (_NAN,) * 4, _NAN, Health.MISSING, (reason, *notes))

    def sample(
        self,
        stamp: Stamp,
        position_mm: _Triple,
        quaternion: _Quaternion,
        error_mm: float,
        notes: tuple[str, ...],
        most_step_mm: float,
    ) -> PoseSample:
        """Return the sample of a pose: GOOD without `notes`, else SUSPECT.

        The sample gets a further note if its position is more than `most_step_mm` from the last position. The
        quaternions q and -q describe the same rotation; the sample gets the quaternion closer to the last one. Without
        a last pose, or if the last sample is MISSING, nothing is compared.
        """
        last = None if self.last is None or self.last.health is Health.MISSING else self.last
        if last is not None:
            step_mm = math.dist(position_mm, last.position_mm)
            if step_mm > most_step_mm:
                notes += (f"a step of {step_mm:.3g} mm",)
        health = Health.SUSPECT if notes else Health.GOOD
        sample = PoseSample(stamp, position_mm, quaternion, error_mm, health, notes)
        if last is None or math.fsum(map(float.__mul__, quaternion, last.quaternion)) >= 0:
            return sample
        w, x, y, z = (-component for component in quaternion)
        return replace(sample, quaternion=(w, x, y, z))


Sample = StageSample | ForceSample | PoseSample | FibreSample | ImageSample


class SampledDevice(Protocol):
    """A device that returns samples one by one."""

    def read(self, timeout_s: float) -> Sample | None:
        """Return the next sample, or None after `timeout_s`."""

    def close(self) -> None:
        """Close the device."""
