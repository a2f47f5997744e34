"""The conformance test: a good robot keeps all rules, and each planted fault is found by the case of its rule."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from needleplan.cli import main
from needleplan.devices.robot import Fault, RobotServer, SteadyDrive
from needleplan.devices.robot.conformance import CASES, ConformanceVerdict, RobotBench, try_cases
from needleplan.errors import AddressError, DeviceFault
from tests.devices.robot.bench import Bench
from tests.devices.robot.planted_faults import FAULTS, Faulty
from tests.devices.robot.robot_in_c import free_port, robot_in_c

HOLDS, BROKEN, OMITTED = ConformanceVerdict


def bench_of(robot: Bench, key: bytes | None = None) -> RobotBench:
    peers = count()
    return RobotBench(lambda: robot.network.link(f"peer {next(peers)}"), 2.0, key, robot.clock)


def broken(robot: Bench, *only: str, key: bytes | None = None) -> dict[str, str]:
    return {each.name: each.found for each in try_cases(bench_of(robot, key), only) if each.verdict is BROKEN}


KEY = b"a key of 16 bytes"


@pytest.mark.slow
@pytest.mark.parametrize("key", [None, KEY], ids=["without key", "with key"])
def test_a_good_robot_keeps_every_rule_and_stays_in_its_range(key: bytes | None) -> None:
    robot = Bench(key=key)
    seen: list[float] = []
    advance = robot.drive.advance

    def watched(time_s: float) -> Any:
        state = advance(time_s)
        seen.extend((state.depth_mm, 10 * abs(state.roll_rad)))
        return state

    robot.drive.advance = watched  # type: ignore[method-assign]
    bench = bench_of(robot, key)
    found = {each.name: each.verdict for each in try_cases(bench)}
    assert found == dict.fromkeys(CASES, HOLDS) | ({} if key else {"key": OMITTED})
    assert bench.rests
    assert robot.machine.homed
    assert robot.machine.controller is None
    assert robot.truth == (pytest.approx(0.0), False)
    assert -1e-9 <= min(seen) <= max(seen) <= 2.0 + 1e-9


@pytest.mark.parametrize("name", FAULTS)
def test_a_planted_fault_is_found_by_the_case_of_its_rule(name: str) -> None:
    case, plant = FAULTS[name]
    key = KEY if case == "key" else None
    robot = Bench(key=key)
    bench = bench_of(robot, key)
    plant(Faulty(robot))
    (found,) = try_cases(bench, (case,))
    assert (found.verdict, bool(found.found)) == (BROKEN, True)


def test_a_robot_that_leaves_the_stated_range_ends_the_test() -> None:
    robot = Bench()
    bench = bench_of(robot)
    robot.drive.faults.runaway = (400.0, 0.0)
    outcomes = list(try_cases(bench, ("redirect", "stop", "homed")))
    assert [each.verdict for each in outcomes] == [BROKEN, OMITTED, OMITTED]
    assert "outside the stated range" in outcomes[0].found
    assert not bench.rests


def test_a_robot_that_answers_no_more_ends_the_test() -> None:
    robot = Bench()
    bench = bench_of(robot)
    robot.machine.receive = lambda *_: b""  # type: ignore[method-assign]
    robot.machine.tick = lambda _: None  # type: ignore[method-assign]
    outcomes = list(try_cases(bench, ("hello", "stop", "homed")))
    assert [each.verdict for each in outcomes] == [BROKEN, OMITTED, OMITTED]
    assert "HELLO gets no answer" in outcomes[0].found
    assert "gave no control for 6 s" in outcomes[1].found
    assert not bench.rests


@pytest.mark.parametrize("distance", [0.5, 11.0, math.nan, 0.0])
def test_a_distance_out_of_range_is_refused_before_anything_is_sent(distance: float) -> None:
    with pytest.raises(AddressError, match="must be from 1 to 10 mm"):
        RobotBench(lambda: pytest.fail("opens a link"), distance)


def test_a_robot_with_a_controller_or_in_motion_is_left_alone() -> None:
    robot = Bench()
    with robot.stage() as stage, pytest.raises(DeviceFault, match="BUSY"):
        bench_of(robot)
    assert stage.counts.received >= 0
    robot = Bench()
    robot.drive.faults.runaway = (5.0, 0.0)
    robot.machine.faults = Fault(0)
    with pytest.raises(DeviceFault, match=r"rest|moves on"):
        bench_of(robot)


# In real time the cases take 20 s: the slow set has those of stops, the zero and the key.
FEW = ("hello", "stop", "goodbye", "homed", "key")
# Drives that miss five of six stops: the robot repeats a stop in each tick until the axes stand.
MISSING = ("{ own->speed = 0; }", "{ static int n; if (++n % 6 == 0) own->speed = 0; }")


@pytest.mark.slow
@pytest.mark.parametrize("only", [FEW, pytest.param((), marks=pytest.mark.study)], ids=["few", "all"])
def test_the_robot_in_c_keeps_every_rule(
    only: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if shutil.which("cc") is None:
        pytest.skip("no C compiler here")
    port = free_port()
    (tmp_path / "robot.key").write_text(KEY.hex())
    address = f"udp://127.0.0.1:{port}?key_file={tmp_path / 'robot.key'}"
    with subprocess.Popen([robot_in_c(tmp_path, change=MISSING), str(port), KEY.decode()]) as robot:
        try:
            code = main(
                ["check-robot", address, "--may-move", "2", *(word for name in only for word in ("--only", name))]
            )
        finally:
            robot.kill()
    printed = capsys.readouterr()
    tried = len(only or CASES)
    assert (code, printed.out.splitlines()[-1]) == (0, f"{tried} of {tried} rules hold"), printed.out
    assert "moves the needle from 0.00 mm to 2.00 mm, at most 5 mm/s" in printed.err


def test_the_command_says_which_rules_hold(capsys: pytest.CaptureFixture[str]) -> None:
    robot = Bench()
    with RobotServer(robot.machine) as server:
        words = ["check-robot", server.address, "--may-move", "-2", "--only", "hello", "--json"]
        assert main([*words, "--only", "key"]) == 0
        told = json.loads(capsys.readouterr().out)
        assert (told["rests"], told["tried"], told["broken"]) == (True, 1, 0)
        assert [each["verdict"] for each in told["cases"]] == ["holds", "omitted"]
        robot.machine._answer = lambda *_: b""  # type: ignore[method-assign]
        assert main(words) == 1
        assert "HELLO gets no answer instead of ACCEPTED: is a robot there, free" in capsys.readouterr().err
        assert main(["check-robot", server.address, "--may-move", "nan"]) == 2
        assert "--may-move = nan: must be from 1 to 10 mm" in capsys.readouterr().err
        assert main([*words, "--only", "stopp"]) == 2
        assert 'did you mean "stop"' in capsys.readouterr().err
    assert isinstance(robot.drive, SteadyDrive)
