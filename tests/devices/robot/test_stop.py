"""The robot's own stop: the drives are stopped again until they stand."""

import pytest

from needleplan.devices.robot import Fault, RobotState
from needleplan.devices.robot.messages import Head, RobotCommand, RobotKind, RobotStatus, decode, encode
from tests.devices.robot.test_machine import ENABLED, PEER, Told, in_state


def inserting() -> Told:
    told = in_state(ENABLED)
    told.tell(RobotKind.INSERT)
    for _ in range(20):
        told.tick()
        told.tell(RobotKind.ALIVE)
    return told


def depth_mm(told: Told) -> float:
    return told.drive.advance(told.now_ns / 1e9).depth_mm


@pytest.mark.parametrize("claims_rest", [False, True])
@pytest.mark.parametrize("how", [RobotKind.STOP, RobotKind.GOODBYE, "any", "fault"])
def test_a_drive_that_misses_a_stop_is_stopped_again(how: RobotKind | str, claims_rest: bool) -> None:
    told = inserting()
    told.drive.faults.missed_stops = 3
    told.drive.faults.claims_rest = claims_rest
    begin_mm = depth_mm(told)
    if how == "fault":
        told.drive.faults.reported = Fault.DRIVE
    else:
        told.tell(RobotKind.STOP if how == "any" else how, session=0 if how == "any" else 1)
    for _ in range(1000):
        told.tick()
    assert told.drive.faults.missed_stops == 0
    assert depth_mm(told) - begin_mm < 0.1


def test_a_stop_in_vain_does_not_feed_the_watchdog() -> None:
    told = inserting()
    told.drive.faults.missed_stops = 10**6
    for _ in range(60):
        told.tell(RobotKind.STOP)
        told.tick()
    assert told.machine.faults & Fault.WATCHDOG
    assert told.machine.state is RobotState.FAULT


def test_the_next_motion_is_not_stopped() -> None:
    told = inserting()
    told.tell(RobotKind.STOP)
    told.tick()
    told.tell(RobotKind.INSERT)
    begin_mm = depth_mm(told)
    for _ in range(100):
        told.tick()
        told.tell(RobotKind.ALIVE)
    assert depth_mm(told) - begin_mm == pytest.approx(0.5, abs=0.01)


def statuses(told: Told, peer: tuple[str, int], ticks: int) -> list[RobotStatus]:
    """Let time pass, and return the statuses to one peer; every status is undamaged."""
    found = []
    for _ in range(ticks):
        told.now_ns += 1_000_000
        sent = told.machine.tick(told.now_ns)
        if sent is not None and sent[1] == peer:
            message = decode(sent[0])
            assert isinstance(message, RobotStatus)
            found.append(message)
    return found


def stop_by(told: Told, peer: tuple[str, int], number: int) -> None:
    told.machine.receive(
        encode(RobotCommand(Head(0, 1, 70 + number, number=number), RobotKind.STOP)), peer, told.now_ns
    )


def test_who_stops_it_without_a_session_sees_for_half_a_second_where_the_needle_is() -> None:
    told, stranger = inserting(), ("stranger", 9)
    began_ns = told.now_ns
    stop_by(told, stranger, 3)
    seen = statuses(told, stranger, 1000)
    assert len(seen) == pytest.approx(100, abs=2)
    assert [each.head.sequence for each in seen] == list(range(1, len(seen) + 1))
    assert {(each.head.session, each.head.echo_ns, each.head.number) for each in seen} == {(0, 73, 3)}
    assert {each.head.sent_ns - each.head.held_us * 1000 for each in seen} == {began_ns}
    assert seen[-1].depth_mm == depth_mm(told)
    assert {each.state for each in seen} == {RobotState.FAULT}
    assert seen[-1].faults == Fault.FOREIGN_STOP


def test_the_controller_and_three_others_see_it_too() -> None:
    told, others = inserting(), [("stranger", number) for number in range(6)]
    for number, peer in enumerate(others):
        stop_by(told, peer, number + 1)
    counts = dict.fromkeys([PEER, *others], 0)
    for _ in range(400):
        told.now_ns += 1_000_000
        sent = told.machine.tick(told.now_ns)
        assert sent is not None
        counts[sent[1]] += 1
    assert counts[PEER] >= 200
    assert [counts[peer] for peer in others[:2]] == [0, 0]  # the last four
    assert min(counts[peer] for peer in others[2:]) >= 45


def test_an_axis_brakes_with_its_deceleration() -> None:
    told = inserting()
    told.drive.faults.braking_mm_s2 = 50.0
    begin_mm = depth_mm(told)
    told.tell(RobotKind.STOP)
    for _ in range(200):
        told.tick()
        told.tell(RobotKind.ALIVE)
    assert depth_mm(told) - begin_mm == pytest.approx(0.25, abs=0.02)
    assert told.machine.state is RobotState.ENABLED
