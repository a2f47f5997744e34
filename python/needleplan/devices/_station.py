"""The three devices of an insertion with their common clock, and the stream of their samples."""

from __future__ import annotations

import queue
import threading
from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Collection, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING, TypeVar

from needleplan.artifacts import CallRepr
from needleplan.bystander import WITHIN_S, StopOutcome
from needleplan.devices._base import Closing, Device, ForceSensor, Sample, SampledDevice, Stage, Tracker
from needleplan.devices._clock import Clock, SystemClock, VirtualClock
from needleplan.devices._halting import halt
from needleplan.devices._opening import Address
from needleplan.errors import AddressError, DeviceFault, Mistake

if TYPE_CHECKING:
    from needleplan.devices.robot import MotionLimits
    from needleplan.models.deflection import FibreSensors
    from needleplan.models.path import ImagePlane

__all__ = [
    "Feed",
    "ReadDevice",
    "Source",
    "Station",
    "ThreadedFeed",
    "TurnFeed",
    "open_stage",
    "open_station",
    "read_directly",
    "require_schemes",
    "stop_stage",
]

# Time (s) that a reading thread waits for a sample before it checks whether the feed was closed
_READ_TIMEOUT_S = 0.1


class Source(StrEnum):
    """One of the devices of a station; the safety guard watches the first three."""

    FORCE = "force"
    POSE = "pose"
    STAGE = "stage"
    FIBRE = "fibre"
    IMAGE = "image"


ReadDevice = Callable[[Source, SampledDevice, float], Sample | None]
"""Function that reads one sample of a device with a timeout (s). The function of the guard also validates it."""


def read_directly(_: Source, device: SampledDevice, timeout_s: float) -> Sample | None:
    """Return the next sample of a device without validation.

    Parameters
    ----------
    _ : Source
        Kind of the device; not used.
    device : SampledDevice
        Device that is read.
    timeout_s : float
        Longest time to wait (s).

    Returns
    -------
    Sample or None
        None if there is no sample within `timeout_s`.
    """
    return device.read(timeout_s)


@dataclass
class Station(CallRepr, Closing):
    """The devices of an insertion (stage, force sensor and tracker) and the clock that timestamps their samples.

    `fibre` and `plane` are the curvature sensors of the needle and the image plane of an ultrasound probe, whose
    devices are in `more`.
    """

    stage: Stage
    force_sensor: ForceSensor
    tracker: Tracker
    clock: Clock
    more: Mapping[Source, SampledDevice] = field(default_factory=dict, kw_only=True)
    fibre: FibreSensors | None = field(default=None, kw_only=True)
    plane: ImagePlane | None = field(default=None, kw_only=True)

    @property
    def devices(self) -> dict[Source, SampledDevice]:
        """The devices by source; the stage is first because it has the highest sample rate."""
        return {Source.STAGE: self.stage, Source.FORCE: self.force_sensor, Source.POSE: self.tracker, **self.more}

    def feed(self, read: ReadDevice = read_directly) -> Feed:
        """Return the stream of samples, which calls `read` for each sample.

        The stream is a TurnFeed if the clock is a VirtualClock, else a ThreadedFeed.
        """
        return TurnFeed(self, read) if isinstance(self.clock, VirtualClock) else ThreadedFeed(self, read)

    def close(self) -> None:
        """Close all devices, the stage first; closing again does nothing."""
        with ExitStack() as closing:
            for device in (*self.more.values(), self.tracker, self.force_sensor, self.stage):
                closing.callback(device.close)


class Feed(Closing):
    """Abstract stream of the samples of all three devices."""

    @abstractmethod
    def next(self, timeout_s: float) -> Sample | None:
        """Return the next sample, or None after `timeout_s`. Raises the DeviceFault of any device."""


class TurnFeed(Feed):
    """Feed for simulated time: reads the devices in turn, because waiting for one device advances the common clock.

    The feed waits for the stage, which has the highest sample rate, and then reads all available samples of the other
    devices.
    """

    def __init__(self, station: Station, read: ReadDevice = read_directly) -> None:
        self._station, self._read = station, read
        self._waiting: deque[Sample] = deque()

    def next(self, timeout_s: float) -> Sample | None:
        """Return the next sample, or None after `timeout_s`. Raises the DeviceFault of any device."""
        waiting = self._waiting
        if not waiting:
            samples: list[Sample] = []
            for source, device in self._station.devices.items():
                if source is Source.STAGE:
                    first = self._read(source, device, timeout_s)
                    samples += [first] if first is not None else []
                    continue
                while (sample := self._read(source, device, 0.0)) is not None:
                    samples.append(sample)
            if len(samples) > 1:
                samples.sort(key=_received)
            waiting.extend(samples)
        return waiting.popleft() if waiting else None

    def close(self) -> None:
        """Discard the samples that `next` has not returned."""
        self._waiting.clear()


class ThreadedFeed(Feed):
    """Feed for real time: reads each device in its own thread, so that a slow tracker does not delay the others."""

    def __init__(self, station: Station, read: ReadDevice = read_directly) -> None:
        self._queue: queue.SimpleQueue[Sample | DeviceFault] = queue.SimpleQueue()
        self._read = read
        self._closing = threading.Event()
        self._threads = [
            threading.Thread(target=self._read_on, args=(source, device), name=f"read {source}", daemon=True)
            for source, device in station.devices.items()
        ]
        for thread in self._threads:
            thread.start()

    def next(self, timeout_s: float) -> Sample | None:
        """Return the next sample, or None after `timeout_s`. Raises the DeviceFault of any device."""
        try:
            sample = self._queue.get(timeout=max(timeout_s, 0.0))
        except queue.Empty:
            return None
        if isinstance(sample, DeviceFault):
            raise sample
        return sample

    def close(self) -> None:
        """Stop the threads and wait for their end."""
        self._closing.set()
        for thread in self._threads:
            thread.join()

    def _read_on(self, source: Source, device: SampledDevice) -> None:
        while not self._closing.is_set():
            try:
                sample = self._read(source, device, _READ_TIMEOUT_S)
            except DeviceFault as fault:
                self._queue.put(fault)
                return
            except Exception as error:  # a thread that dies silently would look like a device without samples
                self._queue.put(DeviceFault(f"{source}: {error!r}"))
                return
            if sample is not None:
                self._queue.put(sample)


def _received(sample: Sample) -> int:
    return sample.stamp.received_ns


_Opened = TypeVar("_Opened", bound=Device)


def open_station(robot: str, force: str, tracker: str, motion: MotionLimits | None = None) -> Station:
    """Open the real devices at three addresses and return them as a station.

    Parameters
    ----------
    robot : str
        Address of the stage.
    force : str
        Address of the force sensor.
    tracker : str
        Address of the tracker.
    motion : MotionLimits, optional
        Limits that a robot (`udp://`, `serial://`) is asked for, for its session. Default: the limits of the robot.

    Returns
    -------
    Station

    Raises
    ------
    AddressError
        An address is wrong.
    ConfigurationError
        The configuration of a device cannot be used.
    DeviceFault
        A device cannot be used. Devices that were already opened are then closed.
    """
    require_schemes(robot, force, tracker)
    with ExitStack() as opened:
        # The stage is opened last, so that no device that can move is enabled while another one is being opened.
        force_sensor = _opened(_FORCES, force, opened)
        opened_tracker = _opened(_TRACKERS, tracker, opened)
        robots = {**_ROBOTS, **dict.fromkeys(("udp", "serial"), lambda address: _robot(address, motion))}
        stage = _opened(robots, robot, opened)
        opened.pop_all()
    return Station(stage, force_sensor, opened_tracker, SystemClock())


def require_schemes(robot: str, force: str, tracker: str, *, also: Collection[str] = ()) -> dict[str, str]:
    """Return the schemes of the addresses of the three devices.

    Parameters
    ----------
    robot : str
        Address of the stage.
    force : str
        Address of the force sensor.
    tracker : str
        Address of the tracker.
    also : collection of str, optional
        Schemes that are permitted besides the schemes of the drivers.

    Returns
    -------
    dict
        Schemes by the keys `--robot`, `--force-sensor` and `--tracker`.

    Raises
    ------
    AddressError
        An address cannot be parsed, or its scheme is not permitted. The error lists all mistakes.
    """
    addresses = {"--robot": robot, "--force-sensor": force, "--tracker": tracker}
    known = {"--robot": [*_ROBOTS, *also], "--force-sensor": [*_FORCES, *also], "--tracker": [*_TRACKERS, *also]}
    schemes, wrong = {}, []
    for name, address in addresses.items():
        try:
            schemes[name] = Address.parse(address).scheme
        except AddressError as error:
            wrong += [replace(mistake, key=name) for mistake in error.mistakes]
    if wrong:
        raise AddressError(wrong)
    mistakes = [
        Mistake(name, addresses[name], f"must begin with {', '.join(f'{scheme}://' for scheme in known[name])}")
        for name, scheme in schemes.items() if scheme not in known[name]
    ]  # fmt: skip
    if mistakes:
        raise AddressError(mistakes)
    return schemes


def open_stage(address: str) -> Stage:
    """Open the stage at an address and take control of it; nothing moves.

    Raises AddressError if the address is wrong, ConfigurationError if the configuration of the stage cannot be used,
    and DeviceFault if the stage cannot be used.
    """
    return _ROBOTS[_scheme_of_robot(address)](address)


def stop_stage(
    address: str, within_s: float = WITHIN_S, on_alarm: Callable[[StopOutcome], object] | None = None
) -> StopOutcome:
    """Stop both axes of the stage at an address, whoever controls it, until the needle is measured at rest.

    A robot (`udp://`, `serial://`) is stopped without taking control: the stop is sent again and again. Drives
    (`canopen://`) are opened for the stop.

    Parameters
    ----------
    address : str
        Address of the stage.
    within_s : float, optional
        Longest time (s).
    on_alarm : callable, optional
        Called with the present outcome once if the needle still moves, and once if its position is unknown.

    Returns
    -------
    StopOutcome

    Raises
    ------
    AddressError
        The address is wrong.
    ConfigurationError
        The configuration of the drives cannot be used.
    DeviceFault
        The stage cannot be used, or the needle is not measured at rest within `within_s`.
    """
    if _scheme_of_robot(address) != "canopen":
        from needleplan.devices.robot import stop_robot

        return stop_robot(address, within_s, on_alarm)
    with open_stage(address) as stage:
        outcome = halt(stage, within_s, on_alarm)
    if not outcome.is_confirmed:
        raise DeviceFault(outcome.why_not(address))
    return outcome


def _scheme_of_robot(address: str) -> str:
    try:
        scheme = Address.parse(address).scheme
    except AddressError as error:
        raise AddressError([replace(mistake, key="--robot") for mistake in error.mistakes]) from None
    if scheme not in _ROBOTS:
        rule = f"must begin with {', '.join(f'{each}://' for each in _ROBOTS)}"
        raise AddressError(Mistake("--robot", address, rule))
    return scheme


def _opened(openers: Mapping[str, Callable[[str], _Opened]], address: str, opened: ExitStack) -> _Opened:
    device = openers[Address.parse(address).scheme](address)
    opened.callback(_close, device)
    return device


def _close(device: Device) -> None:
    with suppress(DeviceFault):
        device.close()


def _robot(address: str, motion: MotionLimits | None = None) -> Stage:
    from needleplan.devices.robot import RobotStage

    return RobotStage.open(address, limits=motion)


def _drives(address: str) -> Stage:
    from needleplan.devices.cia402 import CanopenStage

    return CanopenStage.open(address)


def _net_ft(address: str) -> ForceSensor:
    from needleplan.devices.ati import NetFt

    return NetFt.open(address)


def _ndi(address: str) -> Tracker:
    from needleplan.devices.ndi import NdiTracker

    return NdiTracker.open(address)


def _igtl(address: str) -> Tracker:
    from needleplan.devices.igtl import IgtlTracker

    return IgtlTracker.open(address)


_ROBOTS: dict[str, Callable[[str], Stage]] = {"udp": _robot, "canopen": _drives, "serial": _robot}
_FORCES: dict[str, Callable[[str], ForceSensor]] = {"udp": _net_ft}
_TRACKERS: dict[str, Callable[[str], Tracker]] = {"serial": _ndi, "tcp": _ndi, "igtl": _igtl}
