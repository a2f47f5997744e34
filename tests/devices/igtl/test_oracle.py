"""pyigtl, an independent implementation: the same bytes, and conversations over TCP in both directions."""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from needleplan.devices.igtl import IgtlPoseLimits, IgtlTracker, PlusServer, SlicerServer
from needleplan.devices.igtl.contents import (
    Point,
    decode_points,
    encode_points,
    encode_polyline,
    encode_string,
)
from needleplan.devices.igtl.messages import IgtlMessage, MessageReader, encode_message, stamp_of
from needleplan.devices.igtl.poses import IgtlPose, decode_transform, encode_transform
from tests.devices.igtl.bench import TIP, plus
from tests.devices.igtl.decoding import decode_string

pyigtl = pytest.importorskip("pyigtl", reason="the independent implementation pyigtl is not installed (extra: test)")

TIME_S = 1_700_000_000.25
TURNED = IgtlPose((10.5, -20.0, 30.25), (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0))
MATRIX = np.array([[0, 0, 1, 10.5], [0, 1, 0, -20], [-1, 0, 0, 30.25], [0, 0, 0, 1]], dtype=float)
POINTS = [
    Point("Target", (80.0, 5.0, 0.0), "Target", (255, 0, 0, 255), 2.0, "CT"),
    Point("Entry", (0.0, -5.5, 0.125), "Plan", (0, 255, 0, 128), 0.0, ""),
]
LINE = [(0.0, 0.0, 0.0), (1.0, 2.0, 3.0), (4.0, 5.0, -6.5)]


def theirs(version: int) -> dict[str, Any]:
    messages = {
        "TRANSFORM": pyigtl.TransformMessage(MATRIX, timestamp=TIME_S, device_name="Needle"),
        "STRING": pyigtl.StringMessage("step 12", timestamp=TIME_S, device_name="Needle"),
        "POINT": pyigtl.PointMessage(
            positions=[each.position_mm for each in POINTS], names=[each.name for each in POINTS],
            rgba_colors=[each.colour for each in POINTS], diameters=[each.diameter_mm for each in POINTS],
            groups=[each.group for each in POINTS], owners=[each.owner for each in POINTS],
            timestamp=TIME_S, device_name="Needle",
        ),
        "POLYDATA": pyigtl.PolyDataMessage(
            points=np.array(LINE), lines=np.array([3, 0, 1, 2]), timestamp=TIME_S, device_name="Needle"
        ),
    }  # fmt: skip
    for each in messages.values():
        each.header_version = version
        each.metadata = {"TransformStatus": "OK", "by": "us"} if version == 2 else {}
    return messages


def ours(kind: str, version: int) -> IgtlMessage:
    content = {
        "TRANSFORM": encode_transform(TURNED),
        "STRING": encode_string("step 12"),
        "POINT": encode_points(POINTS),
        "POLYDATA": encode_polyline(LINE),
    }[kind]
    metadata = {"TransformStatus": "OK", "by": "us"} if version == 2 else {}
    return IgtlMessage(kind, "Needle", content, stamp_of(TIME_S), version, metadata=metadata)


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("kind", ["TRANSFORM", "STRING", "POINT", "POLYDATA"])
def test_the_same_bytes_for_the_same_message(kind: str, version: int) -> None:
    their_bytes = theirs(version)[kind].pack()
    reader = MessageReader()
    reader.feed(their_bytes)
    understood = reader.next()
    assert understood is not None
    expected = ours(kind, version)
    if kind == "TRANSFORM":
        # A rotation from a quaternion is exact to the last bit or two.
        pose = decode_transform(understood.content)
        assert pose.position_mm == TURNED.position_mm
        assert pose.quaternion == pytest.approx(TURNED.quaternion, abs=1e-7)
        assert understood.metadata == expected.metadata
    else:
        assert understood == expected
        assert encode_message(expected) == their_bytes


@pytest.mark.parametrize("version", [1, 2])
def test_it_unpacks_what_we_pack(version: int) -> None:
    for kind in ("TRANSFORM", "STRING", "POINT"):
        data = encode_message(ours(kind, version))
        message = pyigtl.MessageBase.create_message(kind)
        message.unpack(pyigtl.MessageBase.parse_header(data[:58]), data[58:])
        assert message.timestamp == TIME_S
        assert message.metadata == ({"TransformStatus": "OK", "by": "us"} if version == 2 else {})
        if kind == "TRANSFORM":
            assert message.matrix == pytest.approx(MATRIX, abs=1e-6)
        elif kind == "STRING":
            assert message.string == "step 12"
        else:
            assert message.positions == [each.position_mm for each in POINTS]
            assert message.names == [each.name for each in POINTS]
            assert message.rgba_colors == [each.colour for each in POINTS]


@pytest.fixture
def their_client() -> Iterator[tuple[SlicerServer, Any]]:
    with SlicerServer(port=0, interval_s=0.001) as server:
        client = pyigtl.OpenIGTLinkClient(server.host, server.port)
        yield server, client
        client.stop()


def test_its_client_reads_our_server(their_client: tuple[SlicerServer, Any]) -> None:
    server, client = their_client
    server.show_tip(TURNED.position_mm, TURNED.quaternion, TIME_S)
    server.show_target((80.0, 5.0, 0.0))
    server.show_note("step 12")
    assert client.wait_for_message("NeedleTip", timeout=20).matrix == pytest.approx(MATRIX, abs=1e-6)
    assert client.wait_for_message("Target", timeout=20).positions == [(80, 5, 0)]
    assert client.wait_for_message("NeedleNote", timeout=20).string == "step 12"


def test_its_client_reads_our_simulated_plus() -> None:
    with PlusServer(plus()) as server:
        client = pyigtl.OpenIGTLinkClient(server.host, server.port)
        message = client.wait_for_message(TIP, timeout=20)
        client.stop()
    assert message.matrix[1:3, 3] == pytest.approx([-20, -150])


def test_our_tracker_reads_its_server() -> None:
    before = {each: signal.getsignal(each) for each in (signal.SIGTERM, signal.SIGINT)}
    server = pyigtl.OpenIGTLinkServer(port=0, local_server=True)
    try:
        for step in range(100):
            matrix = MATRIX.copy()
            matrix[0, 3] += 0.01 * step
            message = pyigtl.TransformMessage(matrix, timestamp=TIME_S + 0.025 * step, device_name="Needle")
            server.send_message(message, wait=False)
        address = f"igtl://127.0.0.1:{server.server_address[1]}/Needle?rate_hz=40"
        with IgtlTracker.open(address, limits=IgtlPoseLimits(start_s=20, silence_s=20, late_s=1e3)) as tracker:
            samples = [tracker.read(20) for _ in range(100)]
        assert [each.stamp.sequence for each in samples if each] == list(range(100))
        assert samples[-1] is not None
        assert samples[-1].position_mm == pytest.approx((10.5 + 0.99, -20, 30.25), abs=1e-5)
        assert samples[-1].quaternion == pytest.approx(TURNED.quaternion, abs=1e-6)
    finally:
        server.communication_thread_stop_requested = True
        server.stop()
        for each, handler in before.items():
            signal.signal(each, handler)
        time.sleep(0)


def test_the_other_kinds_are_understood_by_us_alone() -> None:
    """What pyigtl does not know it must at least pass over: the codec of those kinds has no oracle."""
    assert pyigtl.MessageBase.create_message("TDATA") is None
    assert decode_string(ours("STRING", 1).content) == "step 12"
    assert decode_points(ours("POINT", 1).content) == tuple(POINTS)
