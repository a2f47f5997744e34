"""Coverage-guided fuzzing of the parsers of device data: any bytes must give a value or a documented error.

`python benches/python/fuzz_parsers.py TARGET [-max_total_time=600] [CORPUS]`, with the targets below; libFuzzer gets
the other arguments. It ends with a crash and a file with the input, or with the number of inputs.
"""

from __future__ import annotations

import contextlib
import struct
import sys
import tempfile
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["needleplan.devices", "needleplan.recording"]):
    from needleplan.devices.ati import parse_configuration
    from needleplan.devices.ati.rdt import decode_records, encode_records
    from needleplan.devices.igtl import contents, crc64, poses
    from needleplan.devices.igtl.messages import MessageReader
    from needleplan.devices.ndi.commands import ReplyReader
    from needleplan.devices.ndi.frames import encode_bx, parse_bx, parse_tx
    from needleplan.devices.robot import RobotMachine, RobotState, SteadyDrive
    from needleplan.devices.robot.messages import decode, encode
    from needleplan.errors import ConfigurationError, DataError, ProtocolError
    from needleplan.recording import EVENT, FORCE, POSE, STAGE, Recorder, Recording, Session, recover


def sealed(data: bytes) -> bytes:
    """Return a datagram of the robot protocol with a correct checksum, which fuzzing would not find."""
    begin = b"NPLR" + data
    return begin + struct.pack("<I", zlib.crc32(begin))


def robot(data: bytes) -> None:
    """Check that decoding a datagram gives a message that encodes to the same bytes, or a ProtocolError."""
    try:
        message = decode(sealed(data))
    except ProtocolError:
        return
    assert encode(message) == sealed(data)


def machine(data: bytes) -> None:
    """Check that the robot answers any bytes with valid datagrams, and moves only while it is enabled."""
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
    """Check that a datagram gives records that encode to the same bytes, or a ProtocolError.

    Also parse the bytes as a configuration page, which may raise ConfigurationError only.
    """
    with contextlib.suppress(ProtocolError):
        assert encode_records(decode_records(data)) == data
    with contextlib.suppress(ConfigurationError):
        parse_configuration(data)


def ndi(data: bytes) -> None:
    """Check that any stream can be split into replies, and that each reply is parsed or raises ProtocolError."""
    reader = ReplyReader()
    reader.feed(data)
    while (reply := reader.next()) is not None:
        with contextlib.suppress(ProtocolError):
            if isinstance(reply, bytes):
                encode_bx(parse_bx(reply))
            else:
                parse_tx(reply)


_CONTENTS: dict[bytes, Callable[[bytes], object]] = {
    b"TRANSFORM": poses.decode_transform,
    b"POSITION": poses.decode_position,
    b"TDATA": poses.decode_tdata,
    b"QTDATA": poses.decode_qtdata,
    b"NDARRAY": contents.decode_array,
    b"POINT": contents.decode_points,
    b"STT_TDATA": contents.decode_start,
    b"RTS_TDATA": contents.decode_reply,
}


def igtl(data: bytes) -> None:
    """Check a stream of noise and a message with a correct checksum: its content is decoded or raises ProtocolError."""
    kind = list(_CONTENTS)[data[0] % len(_CONTENTS)] if data else b"POINT"
    body, noise = data[2:], data[:2]
    version = 1 + (data[1] & 1 if len(data) > 1 else 0)
    header = struct.pack(">H12s20sQQQ", version, kind, b"Needle", 0, len(body), crc64(body))
    reader = MessageReader()
    reader.feed(noise + header + body)
    while (message := reader.next()) is not None:
        with contextlib.suppress(ProtocolError):
            _CONTENTS[message.kind.encode()](message.content) if message.kind.encode() in _CONTENTS else None
    assert reader.pending <= len(header) + len(body) + len(noise)


def recording(data: bytes) -> None:
    """Check that a damaged, truncated recording is recovered or raises DataError; the same for single messages."""
    for kind in (FORCE, POSE, STAGE, EVENT):
        with contextlib.suppress(DataError):
            kind.decode(data)
    changed = bytearray(_recorded())
    for at in range(0, len(data) - 3, 3):
        changed[int.from_bytes(data[at : at + 2], "little") % len(changed)] = data[at + 2]
    with tempfile.TemporaryDirectory() as folder:
        partial, whole = Path(folder) / "run.mcap.partial", Path(folder) / "run.mcap"
        partial.write_bytes(changed[: len(changed) - (data[-1] if data else 0)])
        try:
            done = recover(partial, whole)
        except DataError:
            assert not whole.exists()
            return
        found = Recording.read(whole)
        assert sum(found.counts.values()) == done.messages


@cache
def _recorded() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        with Recorder(path, Session(monotonic_ns=0, wall_ns=0)) as recorder:
            channel = recorder.channel("/event", EVENT)
            for number in range(20):
                channel.put(number, {"name": "tick", "cause": "", "text": str(number)})
        return path.read_bytes()


TARGETS: dict[str, Callable[[bytes], None]] = {
    "robot": robot,
    "machine": machine,
    "ati": ati,
    "ndi": ndi,
    "igtl": igtl,
    "recording": recording,
}

if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1] not in TARGETS:
        sys.exit(f"must be one of {', '.join(TARGETS)}")
    target = TARGETS[sys.argv[1]]
    atheris.Setup([sys.argv[0], *sys.argv[2:]], lambda data: target(bytes(data)))
    atheris.Fuzz()
