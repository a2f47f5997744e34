"""`needleplan stop`, on the sockets of a simulated robot; how little it imports."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from needleplan.cli.estop import EmergencyStop
from needleplan.cli.stop import plain_options, send_first_stop, stop_at_once
from needleplan.devices.robot import Fault, RobotMachine, RobotServer, SteadyDrive
from tests.cli.commands import Done, needleplan, program, refused
from tests.recording.samples import wait_for

# Modules that a stop may import besides those of a bare start of Python: 10 ms in all on a machine of 2026.
_ALLOWED = {
    "needleplan", "needleplan.bystander", "needleplan.cli", "needleplan.cli.estop", "needleplan.cli.stop",
    "needleplan.line_owner", "needleplan.stopping", "__future__", "fcntl", "_collections",
    "_collections_abc", "_functools", "_operator", "_socket", "_stat", "_struct", "array", "collections",
    "collections.abc", "enum", "errno", "functools", "genericpath", "itertools", "keyword", "math", "operator",
    "os", "os.path", "posixpath", "reprlib", "select", "selectors", "signal", "socket", "stat", "struct", "types",
    "zlib",
}  # fmt: skip


@pytest.fixture
def robot() -> Iterator[RobotServer]:
    with RobotServer(RobotMachine(SteadyDrive())) as server:
        yield server


@contextmanager
def silent_port() -> Iterator[int]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(("127.0.0.1", 0))
        yield silent.getsockname()[1]


def unknown(done: Done, *words: str) -> None:
    """See that the command says with its exit code that the needle moves, or that its rest is unknown."""
    assert done.returncode == 3, done.stderr
    assert done.stdout == ""
    for word in words:
        assert word in done.stderr


def test_it_imports_next_to_nothing(robot: RobotServer) -> None:
    code = (
        "import sys; before = set(sys.modules); sys.argv = ['needleplan', 'stop', '--robot', sys.argv[1]];"
        "from needleplan.cli import main; code = main(); print(code, *sorted(set(sys.modules) - before))"
    )
    done = subprocess.run(
        [sys.executable, "-S", "-c", code, robot.address], capture_output=True, text=True, check=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )  # fmt: skip
    code_of_stop, *imported = done.stdout.splitlines()[-1].split()
    assert code_of_stop == "0", done.stderr
    assert set(imported) <= _ALLOWED
    assert {"needleplan.cli.stop", "needleplan.bystander"} <= set(imported)
    assert robot.machine.counts.foreign_stops >= 1


def test_what_it_prints(robot: RobotServer) -> None:
    done = program("stop", "--robot", robot.address)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    first, second = done.stdout.splitlines()
    assert first == robot.address
    assert second.startswith("  stopped      the needle was measured at rest after ")
    assert robot.machine.counts.foreign_stops >= 1
    done = program("stop", "--json", f"--robot={robot.address}?watchdog_s=1", "--within=9", "-q", "-v")
    answer = json.loads(done.stdout)
    assert answer.keys() == {"stopped", "took_s", "moved_mm"}
    assert answer["stopped"] is True
    assert 0 < answer["took_s"] < 9


@pytest.mark.parametrize("words", [("--rob",), ("--within", "5", "--rob")])
def test_the_whole_program_does_the_same_for_unusual_words(robot: RobotServer, words: tuple[str, ...]) -> None:
    assert stop_at_once([*words, robot.address]) is None
    done = needleplan("stop", *words, robot.address)
    assert done.returncode == 0, done.stderr
    assert "the needle was measured at rest after" in done.stdout
    assert json.loads(needleplan("stop", "--json", *words, robot.address).stdout)["stopped"] is True


@pytest.mark.parametrize("option", ["--robot", "--rob"])
def test_one_clear_line_without_a_confirmation(option: str) -> None:
    with silent_port() as port:
        done = needleplan("stop", option, f"udp://127.0.0.1:{port}", "--within", "0.1")
        line = f"robot: udp://127.0.0.1:{port} has not confirmed the stop within"
        unknown(done, line, "use the emergency stop")
        assert len(done.stderr.splitlines()) == 1


def test_after_half_a_second_of_silence_it_says_so_and_goes_on() -> None:
    with silent_port() as port:
        done = needleplan("stop", "--robot", f"udp://127.0.0.1:{port}", "--within", "0.8")
        unknown(done, "no answer to the stop; the needle may still move: use the emergency stop")
        assert len(done.stderr.splitlines()) == 2


@pytest.mark.parametrize("option", ["--robot", "--rob"])
def test_ctrl_c_says_that_the_stop_is_not_confirmed(option: str) -> None:
    with silent_port() as port:
        command = [sys.executable, "-m", "needleplan", "stop", option, f"udp://127.0.0.1:{port}", "--within", "60"]
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        assert process.stderr is not None
        assert "use the emergency stop" in process.stderr.readline()
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
    assert process.returncode == 3
    assert said == "needleplan: interrupted: the needle was not measured at rest; use the emergency stop\n"


@pytest.mark.parametrize("option", ["--robot", "--rob"])
def test_a_robot_that_goes_on_is_told_of_and_the_emergency_stop_is_called_once(option: str, tmp_path: Path) -> None:
    """The robot answers ACCEPTED and claims that nothing moves; the emergency stop holds its drives."""
    drive = SteadyDrive()
    drive.faults.missed_stops, drive.faults.claims_rest = 10**9, True
    calls = tmp_path / "calls"
    estop = f"{sys.executable} -c \"open('{calls}', 'a').write('called ')\""
    with RobotServer(RobotMachine(drive)) as server:
        drive.insert(170.0, 5.0)
        done = needleplan("stop", option, server.address, "--within", "1.5", "--estop", estop)
        unknown(done, "the needle still moves", "the emergency stop is called")
        assert calls.read_text() == "called "
        moved_on = drive.advance(time.monotonic()).depth_mm
        drive.faults.reported = Fault.ESTOP
        drive.faults.missed_stops = 0
        assert needleplan("stop", option, server.address).returncode == 0
        assert moved_on > 1.0


@pytest.mark.parametrize(
    ("command", "message"), [("nowhere/estop", "name of a program"), ("'", "is not a command"), (" ", "name of a")]
)
def test_an_emergency_stop_that_cannot_be_run_is_refused_by_the_whole_program(command: str, message: str) -> None:
    refused(needleplan("stop", "--rob", "udp://127.0.0.1:9", "--estop", command), "--estop", message)


def test_an_emergency_stop_that_cannot_be_run_or_fails_is_told_of(capsys: pytest.CaptureFixture[str]) -> None:
    for command, message in (("nowhere/estop", "cannot be run"), ("false", "has failed with the exit code 1")):
        hook = EmergencyStop(command)
        hook.trip()
        hook.finish()
        assert message in capsys.readouterr().err


def test_the_exit_code_is_true_if_nobody_reads_the_answer(robot: RobotServer) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-m", "needleplan", "stop", "--robot", robot.address]
    done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True, timeout=60, check=False)
    os.close(writer)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--robot", "sim://"), "must begin with udp://, canopen://"),
        (("--robot", "robot"), "--robot"),
        (("--robot", "udp://nowhere.invalid"), "is not a host"),
        (("--robot", "udp://127.0.0.1:0"), "port from 1 to 65535"),
        (("--robot", "udp://127.0.0.1:99999"), "--robot"),
        (("--robot", "udp://127.0.0.1:9/path"), "path"),
        (("--robot", "udp://127.0.0.1:9", "--within", "0"), "--within = 0: must be a number of seconds above 0"),
        (("--robot", "udp://127.0.0.1:9", "--within", "nan"), "--within = nan"),
        (("--robot", "udp://127.0.0.1:9", "--within", "soon"), "--within"),
        (("--robot", "udp://127.0.0.1:9", "--now"), "unknown option --now"),
        (("--robot",), "--robot"),
        ((), "--robot"),
    ],
)
def test_what_is_refused(words: tuple[str, ...], message: str) -> None:
    refused(needleplan("stop", *words), message)


def test_a_retraction_begins_with_a_stop_before_the_program_is_imported(robot: RobotServer) -> None:
    for words in (["--robot", robot.address], ["--depth", "3", f"--robot={robot.address}?watchdog_s=1"]):
        before = robot.machine.counts.foreign_stops
        send_first_stop(words)
        wait_for(lambda before=before: robot.machine.counts.foreign_stops == before + 1)
    for words in (["--robot", "canopen://can0"], ["--robot"], []):
        send_first_stop(words)
    assert needleplan("retract", "--robot", robot.address, "--help").returncode == 0
    send_first_stop(["--robot", "udp://nowhere.invalid"])
    time.sleep(0.05)
    assert robot.machine.counts.foreign_stops == before + 1


@pytest.mark.parametrize(
    ("obeys", "signals", "code"), [(True, 1, 130), (False, 1, 3), (False, 2, 3)], ids=["obeys", "goes on", "twice"]
)
def test_ctrl_c_while_a_retraction_is_imported_ends_with_a_measured_stop(
    obeys: bool, signals: int, code: int, tmp_path: Path
) -> None:
    """The signal arrives right after the first STOP, long before the command itself can stop anything."""
    drive = SteadyDrive()
    if not obeys:
        drive.faults.missed_stops, drive.faults.claims_rest = 10**9, True
    with RobotServer(RobotMachine(drive)) as server:
        drive.insert(170.0, 5.0)
        words = ["retract", "--robot", f"{server.address}?watchdog_s=1", f"--estop=touch {tmp_path / 'called'}"]
        process = subprocess.Popen([sys.executable, "-m", "needleplan", *words], stderr=subprocess.PIPE, text=True)
        for number in range(signals):
            wait_for(lambda number=number: server.machine.counts.foreign_stops > 3 * number)
            process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
        depth_mm, ticks = drive.advance(time.monotonic()).depth_mm, server.ticks
        wait_for(lambda: server.ticks > ticks + 50)
        moved_mm = drive.advance(time.monotonic()).depth_mm - depth_mm
    assert process.returncode == code, said
    assert (moved_mm == 0.0) is obeys
    if obeys:
        assert said == "needleplan: interrupted\n"
    else:
        assert said.endswith("interrupted: the needle was not measured at rest; use the emergency stop\n")
        assert signals == 2 or (tmp_path / "called").exists()


@pytest.mark.parametrize("words", [["retract", "--robot", "canopen://can0"], ["pause", "--robot", "udp://[::1]:9"]])
def test_ctrl_c_before_anything_was_stopped_says_so(words: list[str]) -> None:
    code = (
        "import signal, sys, needleplan.cli as cli\n"
        "hold = cli._hold_signals\n"
        "cli._hold_signals = lambda is_held: (hold(is_held), is_held and signal.raise_signal(signal.SIGINT))\n"
        "sys.exit(cli.main())"
    )
    done = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, timeout=60, check=False)
    unknown(done, "interrupted: the needle was not measured at rest; use the emergency stop")
    assert len(done.stderr.splitlines()) == 1


def test_plain_words_and_all_others() -> None:
    names = ("--robot", "--within", "--estop")
    plain = plain_options(["--robot", "udp://robot-1.local", "--json", "--estop=relay off"], names, 5.0)
    assert plain is not None
    assert (plain.url, plain.host, plain.port) == ("udp://robot-1.local", "robot-1.local", 5005)
    assert (plain.within_s, plain.estop, plain.switches) == (5.0, "relay off", {"json"})
    for url in ("udp://[::1]:5005", "udp://a b:1", "udp://h:1\x1b[2J", "udp://user@h:1", "udp://:1", "canopen://can0"):
        assert plain_options(["--robot", url], names, 5.0) is None
    for words in (["--help"], ["--robot", "udp://h", "--by", "anna"]):
        assert plain_options(words, names, 5.0) is None


@pytest.mark.slow
def test_it_stops_on_a_busy_machine(robot: RobotServer) -> None:
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(8)]
    try:
        done = program("stop", "--robot", robot.address, "--within", "30")
    finally:
        for each in busy:
            each.kill()
            each.wait()
    assert done.returncode == 0, done.stderr
