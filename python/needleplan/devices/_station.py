"""The three devices of a run with their common clock, and their samples in the order of arrival."""

from __future__ import annotations

import queue
import threading
from abc import abstractmethod
from collections import deque
from dataclasses import dataclass
from enum import StrEnum

from needleplan.devices._base import Closing, ForceSample, ForceSensor, PoseSample, Stage, StageSample, Tracker
from needleplan.devices._clock import Clock, VirtualClock
from needleplan.errors import DeviceFault

__all__ = ["Feed", "Sample", "Source", "Station", "ThreadedFeed", "TurnFeed"]

Sample = StageSample | ForceSample | PoseSample

_AT_MOST_S = 0.1  # timeout of a reading thread, which delays its end


class Source(StrEnum):
    """One of the three devices."""

    FORCE = "force"
    POSE = "pose"
    STAGE = "stage"


@dataclass
class Station:
    """The devices of an insertion, and the clock of their stamps."""

    stage: Stage
    force_sensor: ForceSensor
    tracker: Tracker
    clock: Clock

    def feed(self, stage: Stage) -> Feed:
        """Return the samples of the devices, in the way that the clock needs: in turn, or by threads.

        `stage` replaces the stage of the station; it is the guarded one.
        """
        station = Station(stage, self.force_sensor, self.tracker, self.clock)
        return TurnFeed(station) if isinstance(self.clock, VirtualClock) else ThreadedFeed(station)


class Feed(Closing):
    """Abstract stream of the samples of all three devices."""

    failed: Source | None = None
    """The device that raised the DeviceFault in `next`."""

    @abstractmethod
    def next(self, timeout_s: float) -> Sample | None:
        """Return the next sample, or None after `timeout_s`. Raises the DeviceFault of any device."""


class TurnFeed(Feed):
    """Reads the devices in turn: for simulated time, where waiting for one device advances the time of all.

    It waits for the stage, which is the fastest device, and then takes the available samples of the others.
    """

    def __init__(self, station: Station) -> None:
        self._station = station
        self._waiting: deque[Sample] = deque()

    def next(self, timeout_s: float) -> Sample | None:
        """Return the next sample, or None after `timeout_s`. Raises the DeviceFault of any device."""
        waiting = self._waiting
        if not waiting:
            station = self._station
            self.failed = Source.STAGE
            first = station.stage.read(timeout_s)
            found: list[Sample] = [first] if first is not None else []
            for source, sensor in ((Source.FORCE, station.force_sensor), (Source.POSE, station.tracker)):
                self.failed = source
                while (sample := sensor.read(0.0)) is not None:
                    found.append(sample)
            self.failed = None
            if len(found) > 1:
                found.sort(key=_received)
            waiting.extend(found)
        return waiting.popleft() if waiting else None

    def close(self) -> None:
        """Discard the samples that were not taken."""
        self._waiting.clear()


class ThreadedFeed(Feed):
    """Reads each device in its own thread: for real time, where a slow tracker must not delay the others."""

    def __init__(self, station: Station) -> None:
        self._queue: queue.SimpleQueue[Sample | tuple[Source, DeviceFault]] = queue.SimpleQueue()
        self._ending = threading.Event()
        devices: dict[Source, Stage | ForceSensor | Tracker] = {
            Source.STAGE: station.stage, Source.FORCE: station.force_sensor, Source.POSE: station.tracker,
        }  # fmt: skip
        self._threads = [
            threading.Thread(target=self._read, args=(source, device), name=f"read {source}", daemon=True)
            for source, device in devices.items()
        ]
        for thread in self._threads:
            thread.start()

    def next(self, timeout_s: float) -> Sample | None:
        """Return the next sample, or None after `timeout_s`. Raises the DeviceFault of any device."""
        try:
            found = self._queue.get(timeout=max(timeout_s, 0.0))
        except queue.Empty:
            return None
        if isinstance(found, tuple):
            self.failed, fault = found
            raise fault
        return found

    def close(self) -> None:
        """End the threads."""
        self._ending.set()
        for thread in self._threads:
            thread.join()

    def _read(self, source: Source, device: Stage | ForceSensor | Tracker) -> None:
        while not self._ending.is_set():
            try:
                sample = device.read(_AT_MOST_S)
            except DeviceFault as fault:
                self._queue.put((source, fault))
                return
            except Exception as error:  # otherwise a failed thread would look like a silent device
                self._queue.put((source, DeviceFault(f"{source}: {error!r}")))
                return
            if sample is not None:
                self._queue.put(sample)


def _received(sample: Sample) -> int:
    return sample.stamp.received_ns
