"""The ROS 2 node of a CRTK robot, with stand-ins for rclpy and the messages: it keeps the rules of the protocol."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from itertools import count
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

import needleplan
from needleplan.devices import VirtualClock
from needleplan.devices.robot import Fault, RobotMachine
from needleplan.devices.robot.conformance import ConformanceVerdict, RobotBench, try_cases
from tests.devices.robot.network import RobotNetwork

CASES = ("insert", "rotate", "redirect", "stop", "stop-in-rotation", "goodbye", "watchdog", "limits")


class JointState:
    """Stand-in for sensor_msgs.msg.JointState."""

    def __init__(self, position: list[float] | None = None) -> None:
        self.position = position or []


class CrtkRobot:
    """A node, and a robot that is measured where `servo_jp` wants it; `is_silent` ends `measured_js`."""

    def __init__(self) -> None:
        self.is_silent = False

    def create_subscription(self, kind: type, topic: str, take: Callable[[JointState], None], _: int) -> None:
        assert (kind, topic) == (JointState, "measured_js")
        self.take = take

    def create_publisher(self, kind: type, topic: str, _: int) -> SimpleNamespace:
        assert (kind, topic) == (JointState, "servo_jp")
        return SimpleNamespace(publish=lambda message: None if self.is_silent else self.take(message))


@pytest.fixture
def drive(monkeypatch: pytest.MonkeyPatch) -> tuple[Any, CrtkRobot]:
    """The drive at 1 mm and 0.1 rad, and its robot."""
    contents: dict[str, dict[str, Any]] = {
        "rclpy": {}, "rclpy.node": {"Node": object}, "sensor_msgs": {}, "sensor_msgs.msg": {"JointState": JointState},
    }  # fmt: skip
    for name, names in contents.items():
        module = ModuleType(name)
        vars(module).update(names)
        monkeypatch.setitem(sys.modules, name, module)
    file = Path(needleplan.__path__[0]) / "ros2/robot_node.py"
    spec = importlib.util.spec_from_file_location("robot_node", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    robot = CrtkRobot()
    made = module.CrtkDrive(robot)
    robot.take(JointState([0.001, 0.1]))
    return made, robot


def test_a_crtk_robot_keeps_the_rules_of_the_protocol(drive: tuple[Any, CrtkRobot]) -> None:
    network, peers = RobotNetwork(RobotMachine(drive[0]), VirtualClock(5_000_000_000)), count()
    bench = RobotBench(lambda: network.link(f"peer {next(peers)}"), 2.0, None, network.clock)
    assert bench.motion.start_mm == pytest.approx(1.0)
    outcomes = list(try_cases(bench, CASES))
    assert [(each.name, each.found) for each in outcomes if each.verdict is not ConformanceVerdict.HOLDS] == []
    assert len(outcomes) == len(CASES)
    assert bench.rests


def test_a_robot_that_sends_no_measured_positions_is_a_fault(drive: tuple[Any, CrtkRobot]) -> None:
    made, robot = drive
    times = [0.001 * number for number in range(200)]
    assert not any(made.advance(time_s).faults for time_s in times[:100])
    robot.is_silent = True
    assert [made.advance(time_s).faults for time_s in times[100:]][-1] == Fault.DRIVE
