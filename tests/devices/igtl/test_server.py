"""The server for Slicer, read over TCP by our own parser: what is shown, and who cannot delay it."""

from __future__ import annotations

import math
import socket
import time
from collections.abc import Callable, Iterator

import pytest

from needleplan.devices import Closing, Link, open_link
from needleplan.devices.igtl import IgtlPoseLimits, IgtlTracker, MessageServer, Shown, SlicerServer, StatusCode
from needleplan.devices.igtl.contents import (
    IgtlStatus,
    Point,
    Sensor,
    Unit,
    decode_points,
    decode_reply,
)
from needleplan.devices.igtl.messages import IgtlMessage, MessageReader, encode_message
from needleplan.devices.igtl.poses import decode_transform
from needleplan.errors import AddressError, DeviceFault, InputError
from tests.devices.igtl.decoding import decode_polyline, decode_sensor, decode_status, decode_string

LONG_S = 20.0
"""Longer than anything takes on a machine with other things to do."""


class Reading(Closing):
    """A client that keeps what comes."""

    def __init__(self, server: MessageServer) -> None:
        self.link: Link = open_link(f"tcp://{server.host}:{server.port}")
        self.reader = MessageReader()
        self.seen: list[IgtlMessage] = []

    def close(self) -> None:
        self.link.close()

    def until(self, enough: Callable[[IgtlMessage], bool]) -> IgtlMessage:
        """Read until a message is the one that is waited for."""
        end_s = time.monotonic() + LONG_S
        while time.monotonic() < end_s:
            while (message := self.reader.next()) is not None:
                self.seen.append(message)
                if enough(message):
                    return message
            self.reader.feed(self.link.receive(0.5))
        raise AssertionError([(each.kind, each.device) for each in self.seen])


@pytest.fixture
def server() -> Iterator[SlicerServer]:
    with SlicerServer(port=0, interval_s=0.001) as opened:
        yield opened


def wait_for(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + LONG_S
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.002)


def test_all_that_is_shown_comes_to_every_client(server: SlicerServer) -> None:
    line = [(float(x), 0.1 * x * x, 0.0) for x in range(500)]
    server.show_tip((1.0, 2.0, 3.0), (0.8, 0.0, 0.6, 0.0), time_s=1_700_000_000.5)
    server.show_target((80.0, 5.0, 0.0), diameter_mm=2.0)
    server.show_plan(line)
    server.show_path(line[:2])
    server.show_force((0.1, 0.0, -1.5), (3.0, 0.0, 0.0))
    server.show_state("PAUSED", StatusCode.MANUAL, "the operator asked for it")
    server.show_note("step 12: rotate")
    # The second client comes when all has been sent, and gets what is known at once.
    for _ in range(2):
        found: dict[str, IgtlMessage] = {}
        with Reading(server) as client:
            while len(found) < 8:
                message = client.until(lambda _: True)
                found[message.device] = message
        assert set(found) == {str(each) for each in Shown}
        tip = decode_transform(found["NeedleTip"].content)
        assert tip.position_mm == (1, 2, 3)
        assert tip.quaternion == pytest.approx((0.8, 0, 0.6, 0))
        assert found["NeedleTip"].time_s == 1_700_000_000.5
        assert decode_points(found["Target"].content) == (
            Point("Target", (80, 5, 0), "Target", (255, 64, 64, 255), 2.0),
        )
        assert decode_polyline(found["PlannedPath"].content)[-1] == pytest.approx(line[-1], rel=1e-6)
        assert len(decode_polyline(found["ExecutedPath"].content)) == 2
        assert decode_sensor(found["Force"].content) == Sensor((0.1, 0.0, -1.5), Unit.NEWTON)
        assert decode_sensor(found["Torque"].content) == Sensor((3.0, 0.0, 0.0), Unit.NEWTON_MILLIMETRE)
        expected = IgtlStatus(StatusCode.MANUAL, "PAUSED", "the operator asked for it")
        assert decode_status(found["NeedleState"].content) == expected
        assert decode_string(found["NeedleNote"].content) == "step 12: rotate"


def test_a_client_that_does_not_read_delays_nobody() -> None:
    line = [(float(x), 0.0, 0.0) for x in range(5000)]
    with SlicerServer(port=0, interval_s=0.0005) as server:
        deaf = socket.create_connection((server.host, server.port))
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        reading = Reading(server)
        wait_for(lambda: server.clients == 2)
        spent_s = []
        for number in range(400):
            begin_s = time.thread_time()
            server.show_tip((float(number), 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
            server.publish("POLYDATA", "PlannedPath", b"x" * 100_000)
            spent_s.append(time.thread_time() - begin_s)
            time.sleep(0.0005)
        # 40 MB were published; what waits for the one who does not read is one message of each kind.
        reading.until(
            lambda message: message.kind == "TRANSFORM" and decode_transform(message.content).position_mm[0] == 399
        )
        assert server.clients == 2
        assert sum(spent_s) < 1.0
        numbers = [decode_transform(each.content).position_mm[0] for each in reading.seen if each.kind == "TRANSFORM"]
        assert numbers == sorted(set(numbers))
        server.show_plan(line)
        reading.until(lambda message: len(message.content) == 40 + 16 * 5000 + 4)
        deaf.close()
        reading.close()


def test_a_client_that_takes_nothing_is_dropped() -> None:
    with SlicerServer(port=0, interval_s=0.0005, stalled_s=0.2) as server:
        deaf = socket.create_connection((server.host, server.port))
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        wait_for(lambda: server.clients == 1)
        end_s = time.monotonic() + LONG_S
        while not server.dropped:
            server.publish("POLYDATA", "PlannedPath", bytes(200_000))
            time.sleep(0.002)
            assert time.monotonic() < end_s
        wait_for(lambda: server.clients == 0)
        deaf.close()


@pytest.fixture
def client(server: SlicerServer) -> Iterator[Reading]:
    with Reading(server) as opened:
        yield opened


def test_queries_are_answered(server: SlicerServer, client: Reading) -> None:
    server.show_tip((1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0))
    server.show_state("ENABLED")
    client.until(lambda message: message.kind == "STATUS")

    def ask(kind: str, device: str) -> IgtlMessage:
        client.link.send(encode_message(IgtlMessage(kind, device)))
        return client.until(lambda _: True)

    assert ask("GET_TRANSFOR", "NeedleTip").device == "NeedleTip"
    assert ask("GET_STATUS", "").device == "NeedleState"
    nothing = ask("GET_TRANSFOR", "Probe")
    assert (nothing.kind, nothing.device, nothing.content) == ("TRANSFORM", "Probe", b"")
    reply = ask("STT_TRANSFOR", "NeedleTip")
    assert reply.kind == "RTS_TRANSFOR"
    assert decode_reply(reply.content)
    reply = ask("STT_TDATA", "")
    assert reply.kind == "RTS_TDATA"
    assert not decode_reply(reply.content)


def test_a_client_that_sends_garbage_is_still_served(server: SlicerServer, client: Reading) -> None:
    client.link.send(bytes(range(256)) * 500)
    server.show_note("hello")
    assert decode_string(client.until(lambda _: True).content) == "hello"


def test_clients_come_and_go(server: SlicerServer) -> None:
    for number in range(5):
        client = Reading(server)
        server.show_note(str(number))
        client.until(lambda message, text=str(number): decode_string(message.content) == text)  # type: ignore[misc]
        client.link.close()
    wait_for(lambda: server.clients == 0)
    server.show_note("to nobody")


def test_our_tracker_reads_our_server(server: SlicerServer) -> None:
    server.show_tip((1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0))
    with IgtlTracker.open(f"{server.address}/NeedleTip", limits=IgtlPoseLimits(start_s=LONG_S)) as tracker:
        sample = tracker.read(1)
        assert sample is not None
        assert sample.position_mm == (1, 2, 3)


def test_what_is_not_a_number_is_refused_where_it_is_said(server: SlicerServer) -> None:
    with pytest.raises(InputError, match="tip"):
        server.show_tip((math.nan, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="PlannedPath"):
        server.show_plan([(0.0, 0.0, 0.0), (1e300, 0.0, 0.0)])
    with pytest.raises(InputError, match="at most 20 bytes"):
        server.show_state("a state with a very long name")
    with pytest.raises(InputError, match="at most 20 bytes"):
        server.publish("STRING", "a device with a very long name", b"")


def test_a_port_that_is_taken_is_a_fault_and_a_closed_server_says_so(server: SlicerServer) -> None:
    with pytest.raises(DeviceFault, match=f"{server.port} cannot be served"):
        SlicerServer.open(f"igtl://127.0.0.1:{server.port}")
    server.close()
    server.close()
    with pytest.raises(DeviceFault, match="is closed"):
        server.show_note("x")
    with SlicerServer.open(f"igtl://127.0.0.1:{server.port}") as again:
        assert again.address == f"igtl://127.0.0.1:{server.port}"


@pytest.mark.parametrize("address", ["tcp://127.0.0.1", "igtl://127.0.0.1/x", "igtl://127.0.0.1?rate=1", "igtl://"])
def test_wrong_addresses_are_refused(address: str) -> None:
    with pytest.raises(AddressError):
        SlicerServer.open(address)
