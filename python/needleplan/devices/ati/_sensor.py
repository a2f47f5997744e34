"""Force sensor ATI Net F/T or Ethernet Axia.

The box sends records only to the client that requested them last, until this client stops the stream. If the box
reports a passing problem, the sample is SUSPECT. If the sensor cannot be used any more, every read raises DeviceFault
until `start` is called. Only a person may decide to call `start`, because the bias may be lost.
"""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from statistics import fmean, pstdev

from needleplan.artifacts import CallRepr
from needleplan.config import Integer
from needleplan.devices._base import ForceSample, ForceSensor, Health, Stamp
from needleplan.devices._clock import Clock, Deadline, SystemClock
from needleplan.devices._links import Link, UdpLink
from needleplan.devices._opening import LAST_PORT, Address, open_link
from needleplan.devices.ati._bias import BiasWatch, Poll
from needleplan.devices.ati._configuration import Configuration, fetch_configuration
from needleplan.devices.ati.rdt import (
    RDT_PORT,
    RdtCommand,
    RdtCounts,
    RdtOrder,
    RdtRecord,
    RdtSeverity,
    StreamWatch,
    decode_records,
    encode_request,
    read_status,
)
from needleplan.errors import AddressError, DeviceFault, LinkClosed, Mistake, ProtocolError

__all__ = ["ForceLimits", "NetFt", "Plausibility"]

_FULL = (1 << 31) - 1  # largest count of a record; at this count, the sensor is saturated
_Three = tuple[float, float, float]


@dataclass(frozen=True)
class ForceLimits(CallRepr):
    """Limits above which a sample is SUSPECT, a bias is refused, or the sensor raises DeviceFault.

    The defaults suit a needle robot: a needle does not withstand 50 N, and a puncture does not change the force by 10 N
    within one sample. They detect a damaged cable, not a puncture.
    """

    silence_s: float = 0.1  # time without a record after which the sensor raises DeviceFault
    start_s: float = 0.3  # longest time from a start request to the first record; the request is sent three times
    most_force_n: float = 50.0  # force above which a sample is SUSPECT
    most_torque_n_mm: float = 5000.0  # torque above which a sample is SUSPECT
    step_n: float = 10.0  # change of a force from one sample to the next above which a sample is SUSPECT
    stuck_samples: int = 50  # number of samples with six equal counts in succession from which they are SUSPECT
    frozen_samples: int = 10  # number of records with equal `ft_sequence` at which the sensor raises DeviceFault
    malformed: int = 50  # number of unusable datagrams in succession at which the sensor raises DeviceFault
    bias_samples: int = 20  # number of samples that are averaged before and after a bias
    steady_n: float = 0.1  # standard deviation of a force above which a bias is refused
    unloaded_n: float = 0.5  # force on a biased sensor above which a further bias is refused (needle under load)
    poll_s: float = 0.5  # time between two readings of the configuration page, which tell a foreign bias


@dataclass
class Plausibility:
    """Checks each wrench: finite, within its limits, counts not saturated, not stuck, no large force step."""

    limits: ForceLimits
    _counts: tuple[int, ...] = ()
    _same: int = 0
    _force_n: _Three | None = field(default=None)

    def forget(self) -> None:
        """Forget the previous wrench, so that the next wrench may differ by any amount, as after a bias."""
        self._force_n, self._counts, self._same = None, (), 0

    def notes(self, record: RdtRecord, force_n: _Three, torque_n_mm: _Three) -> tuple[str, ...]:
        """Record a wrench and return its problems; () if it is plausible."""
        notes = []
        self._same = self._same + 1 if record.counts == self._counts else 1
        self._counts = record.counts
        if self._same >= self.limits.stuck_samples:
            notes.append(f"the same wrench {self._same} times")
        if any(not -_FULL <= count < _FULL for count in record.counts):
            notes.append("counts at the end of their range")
        if not all(map(math.isfinite, (*force_n, *torque_n_mm))):
            notes.append("not finite")
        elif max(map(abs, force_n)) > self.limits.most_force_n:
            notes.append(f"more than {self.limits.most_force_n:g} N")
        elif max(map(abs, torque_n_mm)) > self.limits.most_torque_n_mm:
            notes.append(f"more than {self.limits.most_torque_n_mm:g} N mm")
        if self._force_n is not None:
            step_n = max(abs(now - before) for now, before in zip(force_n, self._force_n, strict=True))
            if not step_n <= self.limits.step_n:
                notes.append(f"a step of {step_n:.3g} N")
        self._force_n = force_n
        return tuple(notes)


_ATTEMPTS = 3  # number of times that a start request or a bias command is sent
_RATE_ERROR = 0.01  # relative error of the count of measurements within which the box has not been switched off
_SETTLING_S = 1.0  # time (s), over all attempts, in which the force must become zero after a bias


class NetFt(ForceSensor):
    """Force sensor that is read by RDT over `link`; the function `configure` returns the configuration of the box.

    The constructor calls `start` and raises its errors.
    """

    def __init__(
        self,
        link: Link,
        configure: Callable[[], Configuration],
        *,
        limits: ForceLimits | None = None,
        clock: Clock | None = None,
    ) -> None:
        self._link, self._configure = link, configure
        self._clock: Clock = SystemClock() if clock is None else clock
        self.limits: ForceLimits = ForceLimits() if limits is None else limits
        self._pending: deque[tuple[RdtRecord, int]] = deque()
        self._fault: DeviceFault | None = None
        self._closed = self._biased = self._biasing = False
        self._last: tuple[RdtRecord, int] | None = None
        """The last accepted record, and the time (ns) at which it was received."""

        self._poll: Poll | None = None
        self._configuration: Configuration
        with self.closed_if_failing():
            self.start()

    @classmethod
    def open(cls, address: str, *, limits: ForceLimits | None = None) -> NetFt:
        """Open `udp://host[:49152][?http_port=80&slot=2]` and start the stream.

        The options are:

        - `http_port`: port of the configuration page, by default 80.
        - `slot`: configuration to read, from 0 to 15, by default the active one.
        - `local_port`: receiving port of this machine, by default any free port.

        Raises AddressError if the address is wrong, ConfigurationError if the configuration of the box cannot be used,
        DeviceFault if the box does not answer.
        """
        parsed = Address.parse(address)
        if parsed.scheme != "udp":
            raise AddressError(Mistake("address", address, "a Net F/T is reached by udp://host"))
        parsed.only(("http_port", "slot", "local_port"))
        host, port = parsed.network(RDT_PORT)
        http_port = parsed.option("http_port", Integer(1, LAST_PORT), 80)
        slot = parsed.option("slot", Integer(0, 15), None)
        local = {name: value for name, value in parsed.options.items() if name == "local_port"}
        link = open_link(Address("udp", host, port, options=local))
        sensor = cls(link, lambda: fetch_configuration(host, http_port, slot), limits=limits)
        sensor._poll = Poll(sensor.check_configuration, sensor.limits.poll_s)
        return sensor

    @property
    def configuration(self) -> Configuration:
        """Configuration of the box, read at the last `start`."""
        return self._configuration

    @property
    def counts(self) -> RdtCounts:
        """Numbers of received, lost, repeated, late, malformed and frozen records since the last `start`."""
        return self._watch.counts

    @property
    def unknown_senders(self) -> int:
        """Number of datagrams that were dropped because another sender sent them; 0 if the link is not UDP."""
        return self._link.unknown_senders if isinstance(self._link, UdpLink) else 0

    @property
    def local_port(self) -> int:
        """UDP port of this machine that receives the records; 0 if the link is not UDP."""
        return self._link.local_port if isinstance(self._link, UdpLink) else 0

    def start(self) -> None:
        """Read the configuration, request the stream (up to three times), and wait for the first record.

        If the box has run without interruption since the last session and has the same bias, the bias of that session
        still holds: a new bias under load is refused. Otherwise the box may have lost its bias.

        Raises ConfigurationError if the configuration cannot be used, DeviceFault if the configuration cannot be read
        or no record arrives.
        """
        before: tuple[int, ...] | None = self._configuration.bias if self._last is not None else None
        self._fault = None
        self._malformed = self._starts = 0
        self._configuration = now = self._configure()
        self._units = now.newton_per_count, now.newton_mm_per_count
        self._watch, self._plausible, self._bias_watch = StreamWatch(), Plausibility(self.limits), BiasWatch()
        self._pending.clear()
        self._link.send(encode_request(RdtCommand.STOP))
        while self._link.receive(0):
            pass
        self._last_ns = self._clock.now_ns()
        for _ in range(_ATTEMPTS):
            self._link.send(encode_request(RdtCommand.START))
            self._starts += 1
            deadline = Deadline(self._clock, self.limits.start_s)
            while not self._pending and not deadline.passed:
                self._take(self._link.receive(deadline.left_s))
            if self._pending:
                self._biased &= self._continues() and now.bias == before
                return
        waited_s = _ATTEMPTS * self.limits.start_s
        raise self._give_up(f"no record within {waited_s:g} s of the start request; check the port and the firewall")

    def _continues(self) -> bool:
        """Return whether the first record of a session shows that the box has measured on since the last session."""
        if self._last is None:
            return False
        (last, last_ns), (first, first_ns) = self._last, self._pending[0]
        expected = (first_ns - last_ns) / 1e9 * self._configuration.measuring_hz
        measured = (first.ft_sequence - last.ft_sequence) % (1 << 32)
        return abs(measured - expected) <= _RATE_ERROR * expected + self._configuration.measuring_hz

    def read(self, timeout_s: float) -> ForceSample | None:
        """Return the next sample, or None after `timeout_s`.

        Raises DeviceFault if the sensor cannot be used, and then at every call until `start`. Raises LinkClosed if the
        link is closed.
        """
        self._require_open()
        if self._fault is not None:
            raise self._fault
        deadline = Deadline(self._clock, timeout_s)
        while True:
            while self._pending:
                sample = self._validate(*self._pending.popleft())
                if sample is not None:
                    return sample
            silent_s = (self._clock.now_ns() - self._last_ns) / 1e9
            wait_s = min(deadline.left_s, max(self.limits.silence_s - silent_s, 0.0))
            data = self._link.receive(wait_s)
            self._take(data)
            if self._pending:
                continue
            silent_s = (self._clock.now_ns() - self._last_ns) / 1e9
            if silent_s >= self.limits.silence_s:
                raise self._give_up(
                    f"silent for {silent_s:.3g} s; check cable and power, and whether another client uses the sensor"
                )
            if deadline.passed:
                return None

    def bias(self) -> None:
        """Define the present wrench as zero, and verify that the measured force has become zero.

        Raises DeviceFault if the force is not steady, a sensor that is already biased is under load, samples remain
        SUSPECT, or the force does not become zero. At the first bias after `start`, a constant load cannot be
        detected.
        """
        mean_n, deviation_n = self._look("bias")
        if max(deviation_n) > self.limits.steady_n:
            raise DeviceFault(f"bias refused: the force is not steady ({max(deviation_n):.3g} N standard deviation)")
        if self._biased and max(map(abs, mean_n)) > self.limits.unloaded_n:
            raise DeviceFault(f"bias refused: the needle is under load ({max(map(abs, mean_n)):.3g} N)")
        self._biasing = True
        try:
            self._bias()
            self._configuration = self._configure()
        finally:
            self._biasing = False
            self._bias_watch.forget()

    def _bias(self) -> None:
        mean_n: list[float] = []
        for _ in range(_ATTEMPTS):
            self._link.send(encode_request(RdtCommand.BIAS))
            deadline = Deadline(self._clock, _SETTLING_S / _ATTEMPTS)
            while not deadline.passed:
                mean_n, _ = self._look("bias", strict=False)
                if max(map(abs, mean_n)) <= self.limits.steady_n:
                    self._biased = True
                    self._plausible.forget()
                    return
        raise DeviceFault(f"bias failed: the box still reports {max(map(abs, mean_n)):.3g} N")

    def reset_latch(self) -> None:
        """Clear the threshold condition that is latched in the box. Raises LinkClosed."""
        self._link.send(encode_request(RdtCommand.RESET_LATCH))

    def check_configuration(self) -> None:
        """Read the configuration again; do nothing while `bias` is at work.

        Raises DeviceFault if the configuration or the bias of the box has changed since the last `start` or `bias`, and
        then `read` raises it too. Raises DeviceFault or ConfigurationError if the configuration cannot be read or used.
        """
        before = self._configuration
        now = self._configure()
        if self._biasing or before is not self._configuration or now == before:
            return
        if now.bias != before.bias:
            raise self._give_up("another client has biased it; examine the force, unload the needle and bias again")
        raise self._give_up(f"its configuration has changed from {before} to {now}")

    def close(self) -> None:
        """Stop the stream and close the link. Closing again does nothing."""
        if not self._closed:
            self._closed = True
            if self._poll is not None:
                self._poll.close()
            with contextlib.suppress(LinkClosed):
                self._link.send(encode_request(RdtCommand.STOP))
            self._link.close()

    def _look(self, purpose: str, strict: bool = True) -> tuple[list[float], list[float]]:
        """Read `bias_samples` successive samples and return mean and standard deviation (N) of each force component.

        If `strict`, a sample that is not GOOD restarts the series. Raises DeviceFault if a sample is missing or no
        series is completed.
        """
        forces_n: list[tuple[float, float, float]] = []
        why: tuple[str, ...] = ()
        for _ in range(_ATTEMPTS * self.limits.bias_samples):
            sample = self.read(self.limits.silence_s)
            if sample is None:
                raise DeviceFault(f"{purpose} refused: no sample")
            if strict and sample.health is not Health.GOOD:
                why = sample.notes
                forces_n.clear()
                continue
            forces_n.append(sample.force_n)
            if len(forces_n) == self.limits.bias_samples:
                axes = list(zip(*forces_n, strict=True))
                return [fmean(axis) for axis in axes], [pstdev(axis) for axis in axes]
        raise DeviceFault(f"{purpose} refused: {', '.join(why)}")

    def _take(self, datagram: bytes) -> None:
        """Decode a datagram and queue its records for `read`; count it if it is malformed."""
        if not datagram:
            return
        try:
            records = decode_records(datagram)
        except ProtocolError as error:
            self._watch.counts.malformed += 1
            self._count_malformed(str(error))
            return
        now_ns = self._clock.now_ns()
        self._pending.extend((record, now_ns) for record in records)

    def _count_malformed(self, why: str) -> None:
        self._malformed += 1
        if self._malformed >= self.limits.malformed:
            raise self._give_up(f"{self._malformed} datagrams in succession do not belong to this stream: {why}")

    def _validate(self, record: RdtRecord, now_ns: int) -> ForceSample | None:
        arrival = self._watch.see(record, now_ns)
        if arrival.order is RdtOrder.IMPLAUSIBLE:
            self._count_malformed("sequence numbers far from the last ones")
        if arrival.order is RdtOrder.RESTARTED:
            raise self._give_up("it was switched off and on: its bias is lost")
        if arrival.order not in (RdtOrder.NEXT, RdtOrder.AFRESH):
            return None
        self._malformed, self._last_ns, self._last = 0, now_ns, (record, now_ns)
        if arrival.order is RdtOrder.AFRESH:
            self._starts -= 1  # each start request of this program begins one stream
            if self._starts <= 0:
                raise self._give_up("its stream was started again, but not by this program; is there another client?")
        severity, notes = read_status(record.status, self._configuration.product)
        if severity is RdtSeverity.FAULT:
            raise self._give_up(f"status 0x{record.status:08X}: {', '.join(notes)}")
        if arrival.frozen >= self.limits.frozen_samples:
            raise self._give_up(f"it has not measured for {arrival.frozen} records")
        if arrival.frozen:
            notes += ("no new measurement",)
        fx, fy, fz, tx, ty, tz = record.counts
        n, n_mm = self._units
        force_n, torque_n_mm = (fx * n, fy * n, fz * n), (tx * n_mm, ty * n_mm, tz * n_mm)
        notes += self._plausible.notes(record, force_n, torque_n_mm)
        if arrival.order is RdtOrder.AFRESH:
            notes += ("the stream was restarted",)
        if not notes and not self._biasing and self._bias_watch.see((*force_n, *torque_n_mm)):
            raise self._give_up("all forces became zero within one sample under load; has another client biased it?")
        # A record without a new measurement does not tell the time of the box.
        measured_s = None if arrival.frozen else arrival.measured / self._configuration.measuring_hz
        stamp = Stamp(now_ns, record.rdt_sequence, arrival.lost, measured_s)
        return ForceSample(stamp, force_n, torque_n_mm, Health.SUSPECT if notes else Health.GOOD, notes)

    def _give_up(self, why: str) -> DeviceFault:
        self._fault = DeviceFault(f"force sensor: {why}")
        return self._fault
