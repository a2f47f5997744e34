"""Fault 33 with real processes: a loop that is stopped, killed, or collects garbage; the robot stands by itself."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from needleplan.devices.robot import RobotMachine, RobotServer, RobotState, SteadyDrive
from tests.recording.samples import wait_for

LOOP = Path(__file__).with_name("looping.py")


class Ended(AssertionError):
    """The process ended before it said what was expected."""


class Loop:
    """The process, and what it has said."""

    def __init__(self, address: str, how: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, str(LOOP), address, how], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        self.said: list[dict[str, Any]] = []

    def until(self, name: str, **values: str) -> dict[str, Any]:
        """Read until an event of a name is said."""
        assert self.process.stdout is not None
        while line := self.process.stdout.readline():
            event: dict[str, Any] = json.loads(line)
            self.said.append(event)
            if event["name"] == name and values.items() <= event.items():
                return event
        raise Ended(f"without {name}: {self.said}")

    def end(self) -> None:
        self.process.kill()
        self.process.communicate()


@pytest.fixture
def robot() -> Iterator[RobotServer]:
    with RobotServer(RobotMachine(SteadyDrive())) as server:
        yield server


def begun(robot: RobotServer, how: str) -> Loop:
    """Return a loop that moves the robot; a busy machine may be too slow for it at first."""
    for _ in range(5):
        loop = Loop(robot.address, how)
        with contextlib.suppress(Ended):
            loop.until("command")
            end_s = time.monotonic() + 1.0
            while time.monotonic() < end_s:
                if moving(robot):
                    return loop
                time.sleep(0.002)
        loop.end()
        wait_for(lambda: robot.machine.state is not RobotState.ENABLED)
    raise AssertionError("it never moved")


def moving(robot: RobotServer) -> bool:
    return robot.machine.state is RobotState.ENABLED and robot.machine.drive.advance(time.monotonic()).moving


def stays(robot: RobotServer) -> None:
    depth_mm = robot.machine.drive.advance(time.monotonic()).depth_mm
    time.sleep(0.1)
    assert robot.machine.drive.advance(time.monotonic()).depth_mm == depth_mm


@pytest.mark.realtime
def test_33_a_loop_that_is_stopped_for_200_ms(robot: RobotServer) -> None:
    loop = begun(robot, "plain")
    try:
        os.kill(loop.process.pid, signal.SIGSTOP)
        wait_for(lambda: not moving(robot))
        stays(robot)
        time.sleep(0.1)
        os.kill(loop.process.pid, signal.SIGCONT)
        fault = loop.until("transition", state="FAULT")
        assert {"loop_late", "stage_fault", "stage_stale"} & set(fault["cause"].split(", "))
        refusal = loop.until("refusal")
        assert "not_enabled" in refusal["cause"]
        stays(robot)
        assert not moving(robot)
    finally:
        loop.end()


@pytest.mark.realtime
def test_33_a_collection_of_garbage(robot: RobotServer) -> None:
    loop = begun(robot, "collect")
    try:
        assert loop.process.stdin is not None
        loop.process.stdin.write(b"now\n")
        loop.process.stdin.flush()
        took_s = loop.until("collected")["took_s"]
        assert took_s > 0.15, "it was no pause at all"
        if not any(each["name"] == "transition" and each["state"] == "FAULT" for each in loop.said):
            loop.until("transition", state="FAULT")
        loop.until("refusal")
        wait_for(lambda: not moving(robot))
        stays(robot)
    finally:
        loop.end()


@pytest.mark.realtime
def test_33_a_loop_that_is_killed(robot: RobotServer) -> None:
    loop = begun(robot, "plain")
    loop.end()
    wait_for(lambda: not moving(robot))
    stays(robot)
