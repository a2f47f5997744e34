"""`needleplan stop`, on the sockets of a simulated robot; how little it imports."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from needleplan.cli.stop import _plain_options, stop_at_once
from needleplan.devices.robot import RobotMachine, RobotServer, SteadyDrive
from tests.cli.commands import needleplan, program, refused

# Modules that a stop may import besides those of a bare start of Python: 10 ms in all on a machine of 2026.
_ALLOWED = {
    "needleplan", "needleplan.bystander", "needleplan.cli", "needleplan.cli.stop", "__future__", "_collections",
    "_collections_abc", "_functools", "_operator", "_socket", "_stat", "_struct", "array", "collections",
    "collections.abc", "enum", "errno", "functools", "genericpath", "itertools", "keyword", "math", "operator",
    "os", "os.path", "posixpath", "reprlib", "select", "selectors", "socket", "stat", "struct", "types", "zlib",
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
    assert second.startswith("  stopped      the robot confirmed it after ")
    assert robot.machine.counts.foreign_stops >= 1
    done = program("stop", "--json", f"--robot={robot.address}?watchdog_s=1", "--within=9", "-q", "-v")
    answer = json.loads(done.stdout)
    assert answer.keys() == {"stopped", "took_s"}
    assert answer["stopped"] is True
    assert 0 < answer["took_s"] < 9


@pytest.mark.parametrize("words", [("--rob",), ("--within", "5", "--rob")])
def test_the_whole_program_does_the_same_for_unusual_words(robot: RobotServer, words: tuple[str, ...]) -> None:
    assert stop_at_once([*words, robot.address]) is None
    done = needleplan("stop", *words, robot.address)
    assert done.returncode == 0, done.stderr
    assert "the robot confirmed it after" in done.stdout
    assert json.loads(needleplan("stop", "--json", *words, robot.address).stdout)["stopped"] is True


@pytest.mark.parametrize("option", ["--robot", "--rob"])
def test_one_clear_line_without_a_confirmation(option: str) -> None:
    with silent_port() as port:
        done = needleplan("stop", option, f"udp://127.0.0.1:{port}", "--within", "0.1")
        line = f"robot: udp://127.0.0.1:{port} has not confirmed the stop within"
        refused(done, line, "use the emergency stop")
        assert len(done.stderr.splitlines()) == 1


def test_after_a_second_of_silence_it_says_so_and_goes_on() -> None:
    with silent_port() as port:
        done = needleplan("stop", "--robot", f"udp://127.0.0.1:{port}", "--within", "1.2")
        refused(done, "no answer to the stop for 1 s; use the emergency stop")
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
    assert process.returncode == 130
    assert said == "needleplan: interrupted: the stop is not confirmed; use the emergency stop\n"


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


def test_plain_words_and_all_others() -> None:
    plain = _plain_options(["--robot", "udp://robot-1.local", "--json"])
    assert plain == ("udp://robot-1.local", "robot-1.local", 5005, 5.0, {"json"})
    for url in ("udp://[::1]:5005", "udp://a b:1", "udp://h:1\x1b[2J", "udp://user@h:1", "udp://:1", "canopen://can0"):
        assert _plain_options(["--robot", url]) is None
    assert _plain_options(["--help"]) is None


@pytest.mark.slow
def test_on_a_busy_machine_it_is_sent_within_a_second(robot: RobotServer) -> None:
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(8)]
    try:
        began_s = time.monotonic()
        done = program("stop", "--robot", robot.address, "--within", "30")
        took_s = time.monotonic() - began_s
    finally:
        for each in busy:
            each.kill()
            each.wait()
    assert done.returncode == 0, done.stderr
    assert took_s < 10.0  # a fraction of a second on a machine that is not also busy with other tests
