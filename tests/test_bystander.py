"""The stop by a bystander, on real sockets."""

from __future__ import annotations

import socket
import threading
import time
import zlib
from collections.abc import Callable, Iterator

import pytest

from needleplan import bystander
from needleplan.bystander import StopOutcome, stop, stop_datagram
from needleplan.devices.robot import Fault, RobotMachine, RobotServer, RobotStage, SteadyDrive, stop_robot
from needleplan.devices.robot.messages import (
    MAGIC,
    OLDEST_VERSION,
    ROBOT_PORT,
    Answer,
    Head,
    Result,
    RobotCommand,
    RobotKind,
    RobotState,
    RobotStatus,
    Seal,
    decode,
    encode,
)
from needleplan.errors import AddressError, DeviceFault
from needleplan.stopping import Rest
from tests.recording.samples import wait_for

Reply = Callable[[int, Head], bytes | None]


class Peer:
    """A port that answers the n-th stop as a function says."""

    def __init__(self, reply: Reply) -> None:
        self.heads: list[Head] = []
        self._reply = reply
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.02)
        self.port: int = self._socket.getsockname()[1]
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._serve)

    def _serve(self) -> None:
        while not self._ending.is_set():
            try:
                data, sender = self._socket.recvfrom(2048)
            except TimeoutError:
                continue
            command = decode(data)
            assert isinstance(command, RobotCommand)
            self.heads.append(command.head)
            answer = self._reply(len(self.heads), command.head)
            if answer:
                self._socket.sendto(answer, sender)

    def __enter__(self) -> Peer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join()
        self._socket.close()


def answer(head: Head, result: Result = Result.ACCEPTED, **changes: int) -> bytes:
    """Return the answer to a stop, with other values for some fields of its head, or for `asked`."""
    asked = changes.pop("asked", RobotKind.STOP)
    fields = {"session": 0, "sequence": 7, "sent_ns": 99, "echo_ns": head.sent_ns, "held_us": 0, "number": head.number}
    return encode(Answer(Head(**fields | changes, version=OLDEST_VERSION), asked, result, RobotState.DISABLED))


@pytest.fixture
def moving() -> Iterator[tuple[RobotServer, SteadyDrive]]:
    drive = SteadyDrive()
    with RobotServer(RobotMachine(drive, key=b"k" * 16)) as server:
        drive.insert(100.0, 5.0)
        yield server, drive


def test_its_bytes_are_those_of_the_protocol() -> None:
    expected = RobotCommand(Head(0, 3, 12345, number=3, version=OLDEST_VERSION), RobotKind.STOP)
    assert decode(stop_datagram(3, 12345)) == expected
    assert stop_datagram(3, 12345) == encode(expected)
    assert (bystander._MAGIC, bystander._VERSION) == (MAGIC, OLDEST_VERSION)
    assert (bystander._STOP, bystander._ANSWER) == (RobotKind.STOP, RobotKind.ANSWER)
    assert bystander._ACCEPTED == Result.ACCEPTED
    told = Answer(Head(0, 1, 1, 1, 0, 1), RobotKind.STOP, Result.ACCEPTED, RobotState.DISABLED)
    assert (len(encode(told)), len(encode(told, Seal(b"k" * 16)))) == bystander._ANSWER_SIZES
    for kind in (RobotKind.STATUS, RobotKind.COMPACT):
        seen = status(Head(0, 1, 1, number=1), 1.5, velocity_mm_s=2.5, roll_rad=3.5, compact=kind is RobotKind.COMPACT)
        measured, sizes = bystander._STATUSES[kind]
        assert (len(seen), len(encode(decode(seen), Seal(b"k" * 16)))) == sizes
        assert measured.unpack_from(seen, bystander._HEAD.size) == (1.5, 2.5, 3.5)
    assert ROBOT_PORT == 5005


def test_it_stops_a_robot_that_moves_and_has_a_key(moving: tuple[RobotServer, SteadyDrive]) -> None:
    server, drive = moving
    outcome = stop(server.host, server.port, 10.0)
    assert outcome.is_confirmed
    assert outcome.result == 0
    assert outcome.sent >= 1
    depth_mm = drive.advance(time.monotonic()).depth_mm
    time.sleep(0.05)
    assert drive.advance(time.monotonic()).depth_mm == depth_mm


def status(head: Head, depth_mm: float, **changes: float) -> bytes:
    """Return a status that a robot sends after a stop, with other values for some fields."""
    measured = {"velocity_mm_s": 0.0, "roll_rad": 0.0, "moving": False} | changes
    sent_ns = int(measured.pop("sent_ns", time.monotonic_ns()))
    about = Head(0, 1, sent_ns, int(measured.pop("echo_ns", head.sent_ns)), 0, head.number, OLDEST_VERSION)
    fields = {name: measured[name] for name in ("velocity_mm_s", "roll_rad")}
    state = RobotStatus(about, depth_mm, **fields, velocity_rad_s=0.0, faults=Fault(0), state=RobotState.DISABLED,
                        moving=bool(measured["moving"]), compact=bool(measured.get("compact")))  # fmt: skip
    return encode(state)


def test_an_answer_alone_confirms_nothing() -> None:
    alarms: list[StopOutcome] = []
    with Peer(lambda _, head: answer(head)) as peer:
        outcome = stop("127.0.0.1", peer.port, 0.8, alarms.append)
    assert (outcome.result, outcome.rest, outcome.is_confirmed) == (0, Rest.UNKNOWN, False)
    assert "reports no position, or too rarely; the needle may still move" in outcome.why_not("here")
    assert [each.rest for each in alarms] == [Rest.UNKNOWN]


def test_it_is_sent_again_until_the_needle_rests() -> None:
    """The fifth stop is answered; the needle, which claims to stand, does so from the tenth on."""

    def reply(count: int, head: Head) -> bytes | None:
        return answer(head) if count == 5 else status(head, 0.01 * min(count, 10))

    with Peer(reply) as peer:
        outcome = stop("127.0.0.1", peer.port, 10.0)
    assert outcome.is_confirmed
    numbers = [head.number for head in peer.heads]
    assert numbers == list(range(1, len(numbers) + 1))
    assert outcome.sent >= 12


@pytest.mark.parametrize("changes", [
    {"echo_ns": 1}, {"sent_ns": 5}, {"velocity_mm_s": 3.0}, {"velocity_mm_s": float("nan")}, {"roll_rad": float("nan")},
])  # fmt: skip
def test_what_shows_no_standstill_confirms_nothing(changes: dict[str, float]) -> None:
    """Statuses of before the stop, statuses that repeat, a speed, and no numbers."""
    with Peer(lambda count, head: answer(head) if count == 1 else status(head, 7.0, **changes)) as peer:
        outcome = stop("127.0.0.1", peer.port, 0.3)
    assert outcome.result == 0
    assert not outcome.is_confirmed


@pytest.mark.parametrize("claims_rest", [False, True])
def test_a_robot_that_accepts_the_stop_and_goes_on_is_told_of(claims_rest: bool) -> None:
    drive = SteadyDrive()
    alarms: list[StopOutcome] = []
    drive.faults.missed_stops, drive.faults.claims_rest = 10**9, claims_rest
    with RobotServer(RobotMachine(drive)) as server:
        drive.insert(100.0, 5.0)
        outcome = stop(server.host, server.port, 1.0, alarms.append)
    assert (outcome.result, outcome.is_confirmed) == (0, False)
    assert Rest.MOVES in [each.rest for each in alarms]
    assert "the needle still moves" in outcome.why_not("here")
    assert outcome.moved_mm > 0.5


def test_a_late_answer_to_an_earlier_stop_counts() -> None:
    seen: list[Head] = []

    def reply(count: int, head: Head) -> bytes | None:
        seen.append(head)
        return answer(seen[0]) if count == 3 else status(head, 1.0)

    with Peer(reply) as peer:
        assert stop("127.0.0.1", peer.port, 10.0).is_confirmed


@pytest.mark.parametrize(
    "forge",
    [
        lambda head: _bit_flipped(answer(head)),
        lambda head: answer(head) + b"\x00",
        lambda head: answer(head, session=1),
        lambda head: answer(head, echo_ns=1),
        lambda head: answer(head, number=0),
        lambda head: answer(head, number=head.number + 1000),
        lambda head: answer(head, asked=RobotKind.ALIVE),
        lambda head: _changed(answer(head), 4, 3),
        lambda head: _changed(answer(head), 0, 1),
        lambda head: _changed(answer(head), 5, RobotKind.STATUS),
        lambda head: _changed(answer(head), 6, 72),
    ],
    ids=[
        "checksum",
        "longer",
        "session",
        "older",
        "no number",
        "not sent",
        "asked",
        "version",
        "magic",
        "kind",
        "size",
    ],
)
def test_what_is_no_answer_to_a_stop_confirms_nothing(forge: Callable[[Head], bytes]) -> None:
    with Peer(lambda _, head: forge(head)) as peer:
        outcome = stop("127.0.0.1", peer.port, 0.1)
    assert outcome.result is None
    assert not outcome.is_confirmed
    assert peer.heads
    assert "use the emergency stop" in outcome.why_not("here")


def _changed(datagram: bytes, at: int, value: int) -> bytes:
    begin = datagram[:at] + bytes([value]) + datagram[at + 1 : -4]
    return begin + zlib.crc32(begin).to_bytes(4, "little")


def _bit_flipped(datagram: bytes) -> bytes:
    """Return the datagram with another last byte. A fixed byte would equal the true one in 1 of 256 datagrams."""
    return datagram[:-1] + bytes([datagram[-1] ^ 1])


def test_a_refusal_ends_it() -> None:
    with Peer(lambda _, head: answer(head, Result.NOT_AUTHENTIC)) as peer:
        outcome = stop("127.0.0.1", peer.port, 10.0)
        assert (outcome.result, outcome.is_confirmed) == (14, False)
        with pytest.raises(DeviceFault, match=r"refused \(result 14\); use the emergency stop"):
            stop_robot(f"udp://127.0.0.1:{peer.port}")


def test_silence_is_told_once_and_ends_after_the_limit() -> None:
    told: list[StopOutcome] = []
    with Peer(lambda *_: None) as peer:
        outcome = stop("127.0.0.1", peer.port, 0.8, told.append)
        assert [each.rest for each in told] == [Rest.UNKNOWN]
        assert outcome.result is None
        assert outcome.took_s >= 0.8
        assert outcome.sent > 5
        with pytest.raises(DeviceFault, match="has not confirmed the stop within"):
            stop_robot(f"udp://127.0.0.1:{peer.port}", 0.05)


def test_a_closed_port_does_not_end_it() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    outcome = stop("127.0.0.1", port, 0.1)
    assert (outcome.result, outcome.obstacle) == (None, "Connection refused")
    with RobotServer(RobotMachine(SteadyDrive())) as server:
        port = server.port

    def begin_late() -> None:
        time.sleep(0.3)
        late.append(RobotServer(RobotMachine(SteadyDrive()), port=port))
        late[0].__enter__()

    late: list[RobotServer] = []
    thread = threading.Thread(target=begin_late)
    thread.start()
    outcome = stop("127.0.0.1", port, 10.0)
    thread.join()
    late[0].close()
    assert outcome.is_confirmed
    assert outcome.took_s > 0.1


def test_one_stop_without_waiting() -> None:
    with Peer(lambda *_: None) as peer:
        bystander.send_stop("127.0.0.1", peer.port)
        wait_for(lambda: len(peer.heads) == 1)
    assert (peer.heads[0].session, peer.heads[0].number) == (0, 1)


def test_addresses_that_name_no_robot() -> None:
    with pytest.raises(AddressError, match="is not a host"):
        stop_robot("udp://nowhere.invalid")
    with pytest.raises(AddressError, match="is not a host"):
        stop_robot("udp://xn--\udc80.invalid")
    with pytest.raises(AddressError, match="udp://host"):
        stop_robot("tcp://127.0.0.1:9")


def test_the_controller_of_the_robot_learns_of_it() -> None:
    with RobotServer(RobotMachine(SteadyDrive())) as server, RobotStage.open(f"{server.address}?valid_s=1"):
        assert stop_robot(server.address).is_confirmed
        assert server.machine.state is RobotState.FAULT
