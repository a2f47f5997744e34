"""Fuzzes what reads bytes from devices, guided by coverage: any bytes give a value or a ProtocolError, nothing else.

`python benches/python/fuzz_parsers.py TARGET [-max_total_time=600] [CORPUS]`, with the targets below; the rest is for
libFuzzer. It ends with a crash and the input in a file, or with the number of inputs tried.
"""

from __future__ import annotations

import contextlib
import struct
import sys
import zlib
from collections.abc import Callable

import atheris

with atheris.instrument_imports(include=["needleplan.devices"]):
    from needleplan.devices.ati import parse_configuration
    from needleplan.devices.ati.rdt import decode_records, encode_records
    from needleplan.devices.ndi.bx import encode_bx, parse_bx
    from needleplan.devices.ndi.replies import ReplyReader
    from needleplan.devices.ndi.tx import parse_tx
    from needleplan.devices.robot import RobotMachine, RobotState, SteadyDrive
    from needleplan.devices.robot.codec import decode, encode
    from needleplan.errors import ConfigurationError, ProtocolError


def sealed(data: bytes) -> bytes:
    """Return a datagram of the robot protocol with a right checksum: fuzzing does not guess those."""
    begin = b"NPLR" + data
    return begin + struct.pack("<I", zlib.crc32(begin))


def robot(data: bytes) -> None:
    """A datagram is a message that encodes to the same bytes, or a ProtocolError."""
    try:
        message = decode(sealed(data))
    except ProtocolError:
        return
    assert encode(message) == sealed(data)


def machine(data: bytes) -> None:
    """Whatever comes, the machine answers with sound datagrams, and moves only where it is enabled."""
    told, now_ns = RobotMachine(SteadyDrive()), 0
    while data:
        length, passed_ms = data[0] % 100, data[0] // 100 * 20
        now_ns += passed_ms * 1_000_000
        answer = told.receive(sealed(data[1 : 1 + length]), ("a", 1), now_ns)
        data = data[1 + length :]
        sent = told.tick(now_ns)
        for each in (answer, sent[0] if sent else b""):
            if each:
                decode(each)
        assert told.state is RobotState.ENABLED or not told.drive.advance(now_ns / 1e9).moving


def ati(data: bytes) -> None:
    """A datagram is records that encode to the same bytes, or a ProtocolError; a page a configuration or its error."""
    with contextlib.suppress(ProtocolError):
        assert encode_records(decode_records(data)) == data
    with contextlib.suppress(ConfigurationError):
        parse_configuration(data)


def ndi(data: bytes) -> None:
    """A stream of bytes is replies and damage; a reply is frames that encode again, or a ProtocolError."""
    reader = ReplyReader()
    reader.feed(data)
    while (reply := reader.next()) is not None:
        with contextlib.suppress(ProtocolError):
            if isinstance(reply, bytes):
                encode_bx(parse_bx(reply))
            else:
                parse_tx(reply)


TARGETS: dict[str, Callable[[bytes], None]] = {"robot": robot, "machine": machine, "ati": ati, "ndi": ndi}

if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1] not in TARGETS:
        sys.exit(f"must be one of {', '.join(TARGETS)}")
    target = TARGETS[sys.argv[1]]
    atheris.Setup([sys.argv[0], *sys.argv[2:]], lambda data: target(bytes(data)))
    atheris.Fuzz()
