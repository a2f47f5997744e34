"""A simulated ATI Net F/T box with selectable faults; it sends the same bytes as a real box.

`NetFtBox` has neither socket nor clock. `BoxLink` connects a client to the box within one process on a virtual clock;
`NetFtServer` offers the box by UDP and HTTP in real time. The wrench is a function of time.
"""

from __future__ import annotations

import contextlib
import math
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from needleplan.artifacts import CallRepr
from needleplan.devices._base import Closing
from needleplan.devices.ati._configuration import FORCE_UNITS, TORQUE_UNITS
from needleplan.devices.ati.rdt import RdtCommand, RdtRecord, decode_request, encode_records
from needleplan.errors import ProtocolError

__all__ = ["BoxFaults", "BoxSettings", "NetFtBox", "NetFtServer", "Peer"]

Peer = tuple[str, int]
_Wrench = Callable[[float], tuple[float, float, float, float, float, float]]
_MEASUREMENTS_PER_S = 7000  # rate (Hz) at which the box measures; it sends every `divisor`-th measurement
_WRAP = 1 << 32


@dataclass
class BoxSettings(CallRepr):
    """Active configuration of the simulated box."""

    counts_per_force: float = 1_000_000
    counts_per_torque: float = 1_000_000
    force_unit: str = "N"
    torque_unit: str = "N-m"
    product: str = "Ethernet 6-Axis F/T Sensor"
    divisor: int = 35
    """The box sends 7000 / `divisor` records per second."""

    def xml(self, bias: tuple[int, ...] = ()) -> bytes:
        """Return the content of the page `netftapi2.xml`, with the bias of the box if given."""
        tags = {
            "prodname": self.product, "setserial": "FT00000", "runstat": "0x00000000", "comrdte": "Enabled",
            "comrdtrate": round(_MEASUREMENTS_PER_S / self.divisor), "comrdtbsiz": 1,
            "cfgcpf": f"{self.counts_per_force:g}" if self.counts_per_force < 1 else f"{self.counts_per_force:.0f}",
            "cfgcpt": f"{self.counts_per_torque:g}" if self.counts_per_torque < 1 else f"{self.counts_per_torque:.0f}",
            "scfgfu": self.force_unit, "scfgtu": self.torque_unit, "runrate": _MEASUREMENTS_PER_S,
        }  # fmt: skip
        if bias:
            tags["setbias"] = ";".join(map(str, bias))
        body = "".join(f"<{name}>{value}</{name}>" for name, value in tags.items())
        return f'<?xml version="1.0" encoding="UTF-8"?><netft>{body}</netft>'.encode()


@dataclass
class BoxFaults(CallRepr):
    """Faults that the simulated box shows from now on."""

    silent: bool = False
    """Whether no records are sent."""

    lose: int = 0
    """Number of the next records that are not sent."""

    duplicate: int = 0
    """Number of the next records that are sent twice."""

    reorder: int = 0
    """Number of the next records that are held back and sent after the record that follows them."""

    freeze: bool = False
    """Whether the box repeats its last measurement in all records."""

    deaf_to_bias: bool = False
    """Whether the box ignores bias commands."""

    status: int = 0
    """Bits that are set in the status word of all records."""

    instead: list[bytes] = field(default_factory=list)
    """Datagrams that are sent before the next record."""


class NetFtBox:
    """The simulated box; `wrench` returns three forces (N) and three torques (N mm) at a time in s."""

    rdt_sequence: int
    ft_sequence: int

    def __init__(self, wrench: _Wrench, settings: BoxSettings | None = None) -> None:
        self.wrench = wrench
        self.settings: BoxSettings = BoxSettings() if settings is None else settings
        self.faults: BoxFaults = BoxFaults()
        self.client: Peer | None = None
        self.rdt_sequence = self.ft_sequence = 0
        self.before_first = 0
        """Sequence number before the first record of a stream; a value close to 2^32 makes the number wrap soon."""

        self._left: int | None = None
        self._latched = 0
        self._bias = (0, 0, 0, 0, 0, 0)
        self._counts = self._bias
        self._held: list[bytes] = []

    def request(self, datagram: bytes, sender: Peer) -> None:
        """Execute a request from `sender`; like a real box, ignore datagrams that are not requests."""
        try:
            command, samples = decode_request(datagram)
        except ProtocolError:
            return
        if command in (RdtCommand.START, RdtCommand.START_BUFFERED, RdtCommand.START_MULTI_UNIT):
            self.client, self.rdt_sequence, self._left = sender, self.before_first, samples or None
            self._held.clear()
        elif command is RdtCommand.STOP and sender == self.client:
            self.client = None
        elif command is RdtCommand.RESET_LATCH:
            self._latched = 0
        elif command is RdtCommand.BIAS and not self.faults.deaf_to_bias:
            self._bias = tuple(map(sum, zip(self._counts, self._bias, strict=True)))  # type: ignore[assignment]

    def exceed_threshold(self) -> None:
        """Latch a threshold condition, as if a force threshold configured in the box had been exceeded."""
        self._latched = 0x8001_0000

    def reboot(self) -> None:
        """Simulate a power dip: the box loses its bias and its client, and both sequence numbers restart at 0."""
        self.client = None
        self.rdt_sequence = self.ft_sequence = self._latched = 0
        self._bias = (0, 0, 0, 0, 0, 0)

    def page(self) -> bytes:
        """Return the content of the configuration page, with the present bias."""
        return self.settings.xml(self._bias)

    def skip(self, records: int) -> None:
        """Measure without sending: advance both sequence numbers by the time of `records` records."""
        if not self.faults.freeze:
            self.ft_sequence = (self.ft_sequence + records * self.settings.divisor) % _WRAP
        if self.client is not None:
            self.rdt_sequence = (self.rdt_sequence + records) % _WRAP

    def step(self, time_s: float) -> list[bytes]:
        """Measure the wrench at `time_s` unless frozen, and return the datagrams for `client`, if any."""
        if not self.faults.freeze:
            self.ft_sequence = (self.ft_sequence + self.settings.divisor) % _WRAP
            self._counts = self._measure(time_s)
        if self.client is None or self._left == 0:
            return []
        if self._left is not None:
            self._left -= 1
        self.rdt_sequence = (self.rdt_sequence + 1) % _WRAP
        status = self.faults.status | self._latched
        record = encode_records([RdtRecord(self.rdt_sequence, self.ft_sequence, status, self._counts)])
        return self._through_faults(record)

    def _measure(self, time_s: float) -> tuple[int, int, int, int, int, int]:
        n = self.settings.counts_per_force / FORCE_UNITS.get(self.settings.force_unit, 1.0)
        n_mm = self.settings.counts_per_torque / TORQUE_UNITS.get(self.settings.torque_unit, 1.0)
        factors = (n, n, n, n_mm, n_mm, n_mm)
        values = zip(self.wrench(time_s), factors, self._bias, strict=True)
        return tuple(max(min(round(value * factor) - bias, 2**31 - 1), -(2**31)) for value, factor, bias in values)  # type: ignore[return-value]

    def _through_faults(self, record: bytes) -> list[bytes]:
        faults = self.faults
        if faults.silent:
            return []
        before, faults.instead = faults.instead, []
        if faults.lose:
            faults.lose -= 1
            return before
        if faults.reorder:
            faults.reorder -= 1
            self._held.append(record)
            return before
        held, self._held = self._held, []
        twice = faults.duplicate > 0
        faults.duplicate -= twice
        return [*before, record, *([record] if twice else []), *held]


class NetFtServer(Closing):
    """Offers a simulated box on this machine: RDT at the UDP port `port`, the configuration page at `http_port`."""

    host: str
    port: int

    def __init__(self, box: NetFtBox, host: str = "127.0.0.1", port: int = 0, http_port: int = 0) -> None:
        self.box = box
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((host, port))
        self._http = ThreadingHTTPServer((host, http_port), _pages(box))
        self.host, self.port = self._socket.getsockname()
        self.http_port: int = self._http.server_port
        self._stopping = threading.Event()
        self._threads = [
            threading.Thread(target=work, daemon=True)
            for work in (self._stream, lambda: self._http.serve_forever(poll_interval=0.02))
        ]
        for thread in self._threads:
            thread.start()

    @property
    def address(self) -> str:
        """The address by which a client opens the box."""
        return f"udp://{self.host}:{self.port}?http_port={self.http_port}"

    def _stream(self) -> None:
        began = due = time.monotonic()
        while not self._stopping.is_set():
            period_s = self.box.settings.divisor / _MEASUREMENTS_PER_S
            due += period_s
            # After a pause of this process the box has gone on measuring; only its records are missing.
            missed = max(math.ceil((time.monotonic() - due) / period_s) - 20, 0)
            self.box.skip(missed)
            due += missed * period_s
            self._listen_until(due)
            for datagram in self.box.step(due - began):
                if self.box.client is not None:
                    with contextlib.suppress(OSError):
                        self._socket.sendto(datagram, self.box.client)

    def _listen_until(self, due: float) -> None:
        while (left_s := due - time.monotonic()) > 0:
            self._socket.settimeout(left_s)
            try:
                datagram, sender = self._socket.recvfrom(2048)
            except OSError:
                continue
            self.box.request(datagram, sender)

    def close(self) -> None:
        """Stop serving, and close the sockets."""
        self._stopping.set()
        self._http.shutdown()
        for thread in self._threads:
            thread.join()
        self._http.server_close()
        self._socket.close()


def _pages(box: NetFtBox) -> type[BaseHTTPRequestHandler]:
    class _Page(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            known = self.path.split("?")[0] == "/netftapi2.xml"
            body = box.page() if known else b"not found"
            self.send_response(200 if known else 404)
            self.send_header("Content-Type", "text/xml")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: object) -> None:
            del format, args

    return _Page
