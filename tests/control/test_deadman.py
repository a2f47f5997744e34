"""Deadman switches over UDP: whose heartbeats hold the needle in motion, and for how long."""

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from needleplan.control import DeadmanSender, UdpDeadman, open_deadman
from needleplan.control import _deadman_link as link
from needleplan.errors import AddressError, DeviceFault

KEY = b"k" * 32


class Clock:
    now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(link, "time", clock)
    return clock


@pytest.fixture
def switch(clock: Clock) -> Iterator[UdpDeadman]:
    assert clock.now_s
    with UdpDeadman("127.0.0.1", 0, KEY) as switch:
        yield switch


@pytest.fixture
def key_file(tmp_path: Path) -> Path:
    file = tmp_path / "deadman.key"
    file.write_text(KEY.hex())
    return file


@pytest.fixture
def sender(switch: UdpDeadman, key_file: Path) -> Iterator[DeadmanSender]:
    with DeadmanSender(f"udp://127.0.0.1:{switch.port}?key_file={key_file}") as sender:
        greet(sender, switch)
        yield sender


def greet(sender: DeadmanSender, switch: UdpDeadman) -> None:
    """Let the sender get the nonce, and say that its switch is released."""
    sender.send(held=False)
    assert not switch.is_held(1.0)
    sender.send(held=False)
    assert not switch.is_held(1.0)


def says(sender: DeadmanSender, switch: UdpDeadman, *, held: bool) -> bool:
    sender.send(held=held)
    return switch.is_held(1.0)


def test_it_is_held_from_press_to_release(sender: DeadmanSender, switch: UdpDeadman) -> None:
    assert says(sender, switch, held=True)
    assert says(sender, switch, held=True)
    assert not says(sender, switch, held=False)
    assert says(sender, switch, held=True)  # the release has armed it again


def test_a_tap_holds_at_most_200_ms_and_silence_must_be_armed_again(
    sender: DeadmanSender, switch: UdpDeadman, clock: Clock
) -> None:
    assert says(sender, switch, held=True)
    clock.now_s += 0.199
    assert switch.is_held(0.0)
    clock.now_s += 0.001
    assert not switch.is_held(0.0)
    assert not says(sender, switch, held=True)
    assert not says(sender, switch, held=False)
    assert says(sender, switch, held=True)


def test_a_switch_that_is_stuck_from_the_begin_holds_nothing(switch: UdpDeadman, key_file: Path) -> None:
    with DeadmanSender(f"udp://127.0.0.1:{switch.port}?key_file={key_file}") as stuck:
        for _ in range(5):
            assert not says(stuck, switch, held=True)


@pytest.mark.parametrize("count", [100, 400])  # a receive buffer holds about 250: the newest of 400 is lost
def test_the_newest_of_many_that_wait_decides(sender: DeadmanSender, switch: UdpDeadman, count: int) -> None:
    for _ in range(count):
        sender.send(held=True)
    assert not says(sender, switch, held=False)
    assert not switch.is_held(0.0)


def test_nobody_else_holds_it(sender: DeadmanSender, switch: UdpDeadman, key_file: Path) -> None:
    at = ("127.0.0.1", switch.port)
    assert says(sender, switch, held=True)
    with DeadmanSender(f"udp://127.0.0.1:{switch.port}?key_file={key_file}") as other:
        other.send(held=False)
        assert switch.is_held(1.0)
        assert says(other, switch, held=False)  # the first one still holds it
        assert not says(sender, switch, held=False)
        assert not says(other, switch, held=True)  # a session must arm the switch itself
        assert not says(other, switch, held=False)
        assert says(other, switch, held=True)
        assert not says(other, switch, held=False)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        for data in (b"1", b"", b"NPLD" + bytes(36), b"1" * 64):
            stranger.sendto(data, at)
            assert not switch.is_held(0.05)


def test_a_recorded_heartbeat_is_worth_nothing(sender: DeadmanSender, switch: UdpDeadman) -> None:
    begins = [link._BEGIN.pack(b"NPLD", 1, held, 0, 5, number, 0) for number, held in enumerate([0, 1, 0])]
    recorded = [link._tagged(begin, KEY, switch._nonce) for begin in begins]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as thief:
        held = []
        for data in (*recorded, recorded[1]):
            thief.sendto(data, ("127.0.0.1", switch.port))
            held.append(switch.is_held(1.0))
        assert held == [False, True, False, False]
        assert not says(sender, switch, held=False)  # another session
        for data in recorded:
            thief.sendto(data, ("127.0.0.1", switch.port))
            assert not switch.is_held(1.0)
        with UdpDeadman("127.0.0.1", 0, KEY) as later:  # another run has another nonce
            for data in recorded:
                thief.sendto(data, ("127.0.0.1", later.port))
                assert not later.is_held(1.0)


@pytest.mark.parametrize(("version", "held"), [(2, 1), (1, 2)])
def test_what_means_nothing_counts_for_nothing(switch: UdpDeadman, version: int, held: int) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as odd:
        for number, (its_version, value) in enumerate([(1, 0), (version, held)]):
            begin = link._BEGIN.pack(b"NPLD", its_version, value, 0, 5, number, 0)
            odd.sendto(link._tagged(begin, KEY, switch._nonce), ("127.0.0.1", switch.port))
            assert not switch.is_held(1.0)


def test_a_run_that_is_not_there_is_no_error_of_the_sender(key_file: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as found:
        found.bind(("127.0.0.1", 0))
        port = found.getsockname()[1]
    with DeadmanSender(f"udp://127.0.0.1:{port}?key_file={key_file}") as sender:
        for _ in range(3):
            sender.send(held=True)


def test_addresses(switch: UdpDeadman, key_file: Path, tmp_path: Path) -> None:
    with pytest.raises(DeviceFault, match="cannot be used"):
        UdpDeadman("127.0.0.1", switch.port, KEY)
    for text in ("udp://127.0.0.1:5010", "udp://127.0.0.1", "pedal", f"udp://127.0.0.1?key_file={key_file}"):
        with pytest.raises(AddressError, match="udp://HOST:PORT"):
            open_deadman(text)
    for text in ("udp://127.0.0.1:5010", f"tcp://127.0.0.1:5010?key_file={key_file}"):
        with pytest.raises(AddressError, match="udp://HOST:PORT"):
            DeadmanSender(text)
    with pytest.raises(AddressError, match="No such file"):
        open_deadman(f"udp://127.0.0.1:5010?key_file={tmp_path / 'nowhere'}")
    with open_deadman(f"udp://127.0.0.1:0?key_file={key_file}") as opened:
        assert isinstance(opened, UdpDeadman)
