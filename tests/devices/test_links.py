from __future__ import annotations

import socket

import pytest

from needleplan.devices import Deadline, VirtualClock
from needleplan.devices._links import UdpLink


def test_a_deadline_passes_on_its_own_clock() -> None:
    clock = VirtualClock()
    deadline = Deadline(clock, 0.5)
    clock.sleep(0.2)
    assert deadline.left_s == pytest.approx(0.3)
    clock.advance(-1)
    clock.advance(0.3)
    assert deadline.passed
    assert deadline.left_s == 0


def test_a_link_to_this_machine_receives_nothing_from_a_network() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.bind(("127.0.0.1", 0))
        with UdpLink("127.0.0.1", peer.getsockname()[1]) as link:
            assert link._socket.getsockname()[0] == "127.0.0.1"
            link.send(b"hello")
            _, sender = peer.recvfrom(100)
            peer.sendto(b"here", sender)
            assert link.receive(5) == b"here"


def test_a_link_listens_where_it_is_told() -> None:
    with UdpLink("127.0.0.1", 1, local_host="0.0.0.0") as link:
        assert link._socket.getsockname()[0] == "0.0.0.0"
