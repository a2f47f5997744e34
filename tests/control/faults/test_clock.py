"""Fault 34: somebody sets the time of day; nothing that decides about motion asks for it."""

import ast
import time
from pathlib import Path

import pytest

import needleplan
from needleplan.control.safety import GuardedStage, OperatingState, Order, SafetyLimits
from needleplan.devices import ForceSample, PoseSample, Stamp
from needleplan.devices.robot import RobotMachine, RobotServer, RobotStage, SteadyDrive

PACKAGE = Path(needleplan.__file__).parent
WALL = {"time", "time_ns", "localtime", "gmtime", "ctime", "now", "utcnow", "today", "CLOCK_REALTIME"}
SOURCES = [
    file for folder in ("control", "devices", "simulation", "estimation", "signals")
    for file in sorted((PACKAGE / folder).rglob("*.py"))
]  # fmt: skip


def wall_clock(tree: ast.AST) -> set[str]:
    """Return how a module asks for the time of day."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and node.attr in WALL:
            owner = node.value.id if isinstance(node.value, ast.Name) else ""
            found |= {f"{owner}.{node.attr}"} if owner in ("time", "datetime", "date") else set()
        if isinstance(node, ast.ImportFrom) and node.module in ("time", "datetime"):
            found |= {each.name for each in node.names if each.name in WALL | {"datetime", "date"}}
    return found


def test_the_search_finds_what_it_looks_for() -> None:
    assert wall_clock(ast.parse("import time\nage = time.time() - stamp")) == {"time.time"}
    assert wall_clock(ast.parse("from datetime import datetime")) == {"datetime"}
    assert wall_clock(ast.parse("import time\nnow = time.monotonic_ns()")) == set()


def test_34_no_module_of_the_loop_asks_for_the_time_of_day() -> None:
    assert len(SOURCES) > 50
    asking = {str(file.relative_to(PACKAGE)): wall_clock(ast.parse(file.read_text())) for file in SOURCES}
    # Messages of OpenIGTLink carry the time of day, for others to look at.
    assert {name for name, how in asking.items() if how} <= {"devices/igtl/_server.py"}


def test_34_a_run_does_not_notice_that_the_time_is_set(monkeypatch: pytest.MonkeyPatch) -> None:
    with RobotServer(RobotMachine(SteadyDrive())) as server, RobotStage.open(server.address) as stage:
        limits = SafetyLimits(force_age_s=5, pose_age_s=5, stage_age_s=5, loop_age_s=5)
        guard = GuardedStage(stage, limits, accepted_limits="a busy machine")
        hours = iter(range(0, 10**6, 7))
        monkeypatch.setattr(time, "time", lambda: 3600.0 * (-1) ** (hour := next(hours)) * hour)
        monkeypatch.setattr(time, "time_ns", lambda: round(time.time() * 1e9))
        for number in range(50):
            guard.read(1.0)
            stamp = Stamp(time.monotonic_ns(), number)
            guard.observe(ForceSample(stamp, (0, 0, 1), (0, 0, 0)))
            guard.observe(
                PoseSample(stamp, (0, 0, 0.01 * (number % 2)), (1, 0, 0, 0), 0.1), tip_mm=(0, 0), out_of_plane_mm=0
            )
            guard.tick()
            if number == 1:
                guard.order(Order.HOME)
                guard.order(Order.ENABLE)
                guard.insert(1.0, 1.0)
        assert guard.state.operating is OperatingState.ENABLED
        assert not guard.state.present
