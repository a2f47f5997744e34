import os
import socket
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from needleplan.devices import Address, Link, SerialLink, TcpLink, UdpLink, open_link
from needleplan.errors import AddressError, DeviceFault, LinkClosed, NeedleplanError

WRONG = {
    "192.168.1.1:49152": "must begin with the kind of link",
    "": "must begin with the kind of link",
    "upd://host:1": 'did you mean "udp"',
    "udp://:5000": "must name a host",
    "udp://127.0.0.1": "must name a port",
    "udp://127.0.0.1:0": "from 1 to 65535",
    "udp://127.0.0.1:70000": "is not an address",
    "udp://127.0.0.1:x": "is not an address",
    "tcp://127.0.0.1:1/path": "must not have a path after the port",
    "udp://127.0.0.1:1?locl_port=3": 'did you mean "local_port"',
    "udp://127.0.0.1:1?local_port=3&local_port=4": "twice",
    "udp://127.0.0.1:1?local_port=many": "local_port = many",
    "udp://127.0.0.1:1?local_port=99999": "from 0 to 65535",
    "tcp://127.0.0.1:1?timeout_s=nan": "above 0 and at most 3,600",
    "tcp://me@127.0.0.1:1": "neither a user",
    "serial://dev/ttyUSB0": "three slashes",
    "serial:///": "three slashes",
    "serial:///dev/null?baud=0": "baud = 0",
    "serial:///dev/null?parity=even": "option = parity",
    "tcp://name.invalid:1": "host = name.invalid",
}


@pytest.mark.parametrize(("address", "message"), WRONG.items())
def test_a_wrong_address_is_refused_with_the_rule(address: str, message: str) -> None:
    with pytest.raises(AddressError, match=message.replace("?", r"\?")):
        open_link(address)


@given(st.text())
def test_any_text_is_an_address_or_an_address_error(text: str) -> None:
    try:
        address = Address.parse(text)
    except AddressError:
        return
    assert address.scheme


@pytest.mark.parametrize("text", ["udp://h:1", "tcp://[::1]:8765", "serial:///dev/ttyUSB0?baud=9600"])
def test_an_address_is_written_as_it_was_read(text: str) -> None:
    assert str(Address.parse(text)) == text


def test_datagrams_of_strangers_are_counted_and_dropped() -> None:
    peer = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    with peer, stranger:
        peer.bind(("127.0.0.1", 0))
        with open_link(f"udp://127.0.0.1:{peer.getsockname()[1]}") as link:
            assert isinstance(link, UdpLink)
            link.send(b"hello")
            assert peer.recvfrom(10)[0] == b"hello"
            stranger.sendto(b"false", ("127.0.0.1", link.local_port))
            peer.sendto(b"true", ("127.0.0.1", link.local_port))
            assert link.receive(1) == b"true"
            assert link.unknown_senders == 1
            assert link.receive(0) == b""


def test_a_port_that_is_taken_is_a_fault_that_names_it() -> None:
    with UdpLink("127.0.0.1", 9) as first, pytest.raises(DeviceFault, match=str(first.local_port)):
        open_link(f"udp://127.0.0.1:9?local_port={first.local_port}")


def test_tcp_carries_bytes_and_says_when_the_other_end_is_gone() -> None:
    server = socket.create_server(("127.0.0.1", 0))
    with server, open_link(f"tcp://127.0.0.1:{server.getsockname()[1]}") as link:
        assert isinstance(link, TcpLink)
        other, _ = server.accept()
        link.send(b"question")
        assert other.recv(20) == b"question"
        other.sendall(b"answer")
        assert link.receive(1) == b"answer"
        assert link.receive(0) == b""
        other.close()
        with pytest.raises(LinkClosed, match="closed by the other end"):
            link.receive(1)


def test_nobody_at_a_tcp_address_is_a_fault() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(DeviceFault, match="cannot be reached"):
        open_link(f"tcp://127.0.0.1:{port}")


def test_a_pseudo_terminal_is_a_serial_port() -> None:
    master, slave = os.openpty()
    path = os.ttyname(slave)
    try:
        with open_link(f"serial://{path}?baud=115200") as link:
            assert isinstance(link, SerialLink)
            assert link.baud == 115_200
            link.baud = 9600
            link.send_break(0)
            link.send(b"VER:0\r")
            assert os.read(master, 20) == b"VER:0\r"
            os.write(master, b"\x00\n\r\x11\xff")
            received = b""
            while len(received) < 5:
                received += link.receive(1)
            assert received == b"\x00\n\r\x11\xff"
            assert link.receive(0) == b""
            with pytest.raises(DeviceFault, match="cannot be opened"):
                open_link(f"serial://{path}")
    finally:
        os.close(slave)
        os.close(master)


def test_an_unplugged_cable_closes_the_link() -> None:
    master, slave = os.openpty()
    with open_link(f"serial://{os.ttyname(slave)}") as link:
        os.close(slave)
        os.close(master)
        with pytest.raises(LinkClosed):
            link.receive(1)
        with pytest.raises(LinkClosed):
            link.send(b"x")


def test_a_port_that_is_not_there_is_a_fault() -> None:
    with pytest.raises(DeviceFault, match="no such port"):
        open_link("serial:///dev/no-such-port")
    with pytest.raises(DeviceFault, match="cannot be opened"):
        open_link("serial:///dev/null")


@pytest.mark.parametrize("kind", ["udp", "tcp", "serial"])
def test_a_closed_link_says_so_and_closing_twice_is_harmless(kind: str) -> None:
    master, slave = os.openpty()
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        addresses = {
            "udp": "udp://127.0.0.1:9",
            "tcp": f"tcp://127.0.0.1:{port}",
            "serial": f"serial://{os.ttyname(slave)}",
        }
        link: Link = open_link(addresses[kind])
        link.close()
        link.close()
        with pytest.raises(NeedleplanError):
            link.receive(0)
    os.close(master)
    os.close(slave)


def test_waiting_ends_at_the_deadline() -> None:
    with UdpLink("127.0.0.1", 9) as link:
        began = time.monotonic()
        assert link.receive(0.05) == b""
        assert 0.04 < time.monotonic() - began < 5
