"""Faults 32 and 33 with real processes: a control side that is suspended or killed while the robot moves."""

import contextlib
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from needleplan.devices.robot import Fault, RobotLimits, RobotMachine, RobotServer, RobotState, SteadyDrive
from needleplan.devices.robot._machine import Peer

SILENCE_S = 2.0
"""Of the watchdog: long, for a machine on which both processes may have to wait for a processor."""

CONTROLLER = Path(__file__).parent / "controller.py"


@pytest.fixture
def server() -> Iterator[RobotServer]:
    limits = RobotLimits(longest_silence_s=SILENCE_S, longest_valid_s=SILENCE_S)
    with RobotServer(RobotMachine(SteadyDrive(), limits)) as running:
        yield running


@pytest.fixture
def controller(server: RobotServer) -> Iterator[subprocess.Popen[str]]:
    address = f"{server.address}?watchdog_s={SILENCE_S}&valid_s={SILENCE_S}"
    with subprocess.Popen([sys.executable, CONTROLLER, address], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "moving\n"
        yield process
        process.kill()


def until(condition: Callable[[], bool], limit_s: float = 30.0) -> None:
    end_s = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.005)


def depth_mm(server: RobotServer) -> float:
    """Where the robot is, by its own encoder."""
    last = server.machine._last
    assert last is not None
    return last.depth_mm


@pytest.mark.slow
@pytest.mark.parametrize("by", [signal.SIGSTOP, signal.SIGKILL])
def test_a_control_side_that_is_gone_leaves_a_robot_that_stops(
    server: RobotServer, controller: subprocess.Popen[str], by: signal.Signals
) -> None:
    assert server.machine.state is RobotState.ENABLED
    began_s = time.monotonic()
    before_mm = depth_mm(server)
    controller.send_signal(by)
    until(lambda: server.machine.state is RobotState.FAULT)
    assert server.machine.faults is Fault.WATCHDOG
    # As far as it goes in the time of the watchdog, and in what this machine made it wait.
    waited_s = time.monotonic() - began_s
    assert depth_mm(server) - before_mm <= 5.0 * min(waited_s, SILENCE_S + 1.0) + 0.1
    stopped_mm = depth_mm(server)
    if by is signal.SIGSTOP:
        controller.send_signal(signal.SIGCONT)
        assert controller.stdout is not None
        assert "nothing was received from the controller while the robot moved" in controller.stdout.read()
    ticks = server.ticks
    until(lambda: server.ticks > ticks + 100)
    assert depth_mm(server) == stopped_mm


def test_who_sends_without_end_does_not_keep_the_watchdog_from_looking(
    server: RobotServer, controller: subprocess.Popen[str]
) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:

        def send() -> None:
            stranger.sendto(b"x" * 100, (server.host, server.port))

        def receive(datagram: bytes, sender: Peer, now_ns: int) -> bytes:
            with contextlib.suppress(OSError):  # the last one may be heard when the stranger is gone
                send()  # for each that it hears there is another one
            return hear(datagram, sender, now_ns)

        hear, server.machine.receive = server.machine.receive, receive  # type: ignore[method-assign]
        send()
        controller.kill()
        until(lambda: server.machine.state is RobotState.FAULT)
        server.machine.receive = hear  # type: ignore[method-assign]
    assert server.machine.faults is Fault.WATCHDOG
    assert server.machine.counts.malformed > 1000
