"""Curvatures along the needle (NDARRAY), and the tip in an image (POINT), from an OpenIGTLink server."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from needleplan.devices._base import Device, FibreSample, Health, ImageSample, Stamp
from needleplan.devices._clock import Clock, Deadline, SystemClock
from needleplan.devices._links import Link
from needleplan.devices.igtl._tracker import named_address, names_of, open_named
from needleplan.devices.igtl.contents import decode_array, decode_points
from needleplan.devices.igtl.messages import MessageReader
from needleplan.devices.igtl.poses import FrameTimes, IgtlPoseLimits
from needleplan.errors import ConfigurationError, DeviceFault, LinkClosed, Mistake

__all__ = ["NeedleSensor", "open_fibre", "open_images"]

Convert = Callable[[bytes, Stamp, Health, tuple[str, ...]], "FibreSample | ImageSample"]


class NeedleSensor(Device):
    """Receives over `link` the messages of one kind of the device `name`, which `convert` makes samples of.

    If not `needs_crc`, messages with the checksum 0 are accepted. The constructor waits for the first message; raises
    ConfigurationError if none arrives within `limits.start_s`, DeviceFault if the messages cannot be used.
    """

    def __init__(
        self, link: Link, kind: str, name: str, convert: Convert, *, needs_crc: bool = True,
        limits: IgtlPoseLimits | None = None, clock: Clock | None = None,
    ) -> None:  # fmt: skip
        self._link, self._kind, self._convert = link, kind, convert
        self.name: str = name
        self._clock: Clock = SystemClock() if clock is None else clock
        self.limits: IgtlPoseLimits = IgtlPoseLimits() if limits is None else limits
        self._reader = MessageReader({kind}, needs_crc=needs_crc)
        self._times = FrameTimes(self.limits, noun=name)
        self._heard_ns = self._clock.now_ns()
        self._fault: DeviceFault | None = None
        with self.closed_if_failing():
            self._first = self._next(Deadline(self._clock, self.limits.start_s))
            if self._first is None:
                rule = (
                    f"must be the device of a {kind} that the server sends; in {self.limits.start_s:g} s there was none"
                )
                raise ConfigurationError(Mistake("name", name, rule), "sensor")

    def read(self, timeout_s: float) -> FibreSample | ImageSample | None:
        """Return the next sample, or None after `timeout_s`.

        Raises DeviceFault if no new message arrives for `limits.silence_s`, a message has another shape, its time goes
        back, or the connection is lost, and then at every call; LinkClosed after `close`.
        """
        if self._fault is not None:
            raise self._fault
        sample, self._first = self._first, None
        try:
            sample = sample or self._next(Deadline(self._clock, timeout_s))
            silent_s = (self._clock.now_ns() - self._heard_ns) / 1e9
            if sample is None and silent_s >= self.limits.silence_s:
                raise DeviceFault(f"{self.name}: no new {self._kind} for {silent_s:.3g} s")
        except DeviceFault as fault:
            self._fault = fault
            raise
        return sample

    def _next(self, deadline: Deadline) -> FibreSample | ImageSample | None:
        asked = False
        while True:
            message = self._reader.next()
            if message is None:
                if asked and deadline.passed:
                    return None
                if self._reader.damaged >= self.limits.damaged:
                    raise DeviceFault(f"{self.name}: {self._reader.damaged} damaged messages: is this OpenIGTLink?")
                self._reader.feed(self._link.receive(deadline.left_s))
                asked = True
                continue
            now_ns = self._clock.now_ns()
            timed = self._times.take(message.timestamp, now_ns) if self.name in names_of(message) else None
            if timed is not None:
                self._heard_ns = now_ns
                self._reader.damaged = 0
                stamp, notes = timed
                return self._convert(message.content, stamp, Health.SUSPECT if notes else Health.GOOD, notes)

    def close(self) -> None:
        """Close the connection. Closing again does nothing."""
        self._fault = LinkClosed(f"{self.name}: the sensor is closed")
        self._link.close()


def open_fibre(address: str, sensors: int) -> NeedleSensor:
    """Open `igtl://host[:18944]/NAME[?crc=absent&timeout_s=3]`: curvatures (1/mm) of a number of sensors as NDARRAY.

    The array has the shape (sensors, 2), as `FibreSample.curvatures_per_mm`. Raises AddressError, ConfigurationError
    and DeviceFault.
    """

    def convert(content: bytes, stamp: Stamp, health: Health, notes: tuple[str, ...]) -> FibreSample:
        array = decode_array(content)
        if array.shape != (sensors, 2):
            raise DeviceFault(f"{address}: NDARRAY of the shape {array.shape} instead of {(sensors, 2)}")
        readable = np.where(np.isfinite(array), array, np.nan)
        return FibreSample(stamp, tuple((float(y), float(z)) for y, z in readable), health, notes)

    parsed, name, needs_crc = named_address(address)
    return NeedleSensor(open_named(parsed), "NDARRAY", name, convert, needs_crc=needs_crc)


def open_images(address: str) -> NeedleSensor:
    """Open `igtl://host[:18944]/NAME[?crc=absent&timeout_s=3]`: the tip in images as POINT, x and y in mm.

    A message without a point is an image without the tip. Raises AddressError, ConfigurationError and DeviceFault.
    """

    def convert(content: bytes, stamp: Stamp, health: Health, notes: tuple[str, ...]) -> ImageSample:
        points = decode_points(content)
        if len(points) > 1:
            raise DeviceFault(f"{address}: POINT with {len(points)} points instead of the tip alone")
        u_mm, v_mm = points[0].position_mm[:2] if points else (math.nan, math.nan)
        if not math.isfinite(u_mm + v_mm):
            return ImageSample(stamp, math.nan, math.nan, Health.MISSING, notes)
        return ImageSample(stamp, u_mm, v_mm, health, notes)

    parsed, name, needs_crc = named_address(address)
    return NeedleSensor(open_named(parsed), "POINT", name, convert, needs_crc=needs_crc)
