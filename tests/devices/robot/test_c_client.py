"""The control side in C of the examples drives a robot over a real socket."""

import shutil
import subprocess
from pathlib import Path

import pytest

from needleplan.devices.robot import RobotLimits, RobotMachine, RobotServer, SteadyDrive
from tests.devices.robot.robot_in_c import robot_in_c

KEY = "a shared key of 27 letters!"
PATIENT = RobotLimits(longest_silence_s=10.0, longest_valid_s=10.0)  # for a busy machine


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if shutil.which("cc") is None:
        pytest.skip("no C compiler here")
    patience = ("-DVALID_NS=5000000000u", "-DSILENCE_US=5000000u")
    return robot_in_c(tmp_path_factory.mktemp("c"), *patience, source="control")


def said(client: Path, port: int, *key: str) -> tuple[list[str], int]:
    """Return what the client prints, and how often it has sent GOODBYE."""
    done = subprocess.run([client, str(port), *key], capture_output=True, text=True, timeout=120, check=True)
    return done.stdout.splitlines(), int(done.stderr)


@pytest.mark.parametrize("key", [(), (KEY,)], ids=["without key", "with key"])
def test_it_inserts_within_its_limits(client: Path, key: tuple[str, ...]) -> None:
    machine = RobotMachine(SteadyDrive(), PATIENT, key=key[0].encode() if key else None)
    with RobotServer(machine) as server:
        lines, goodbyes = said(client, server.port, *key)
    assert lines == [
        "hello 0", "reset 0", "enable 0", "insert 9 mm 9", "insert 2 mm 0", "depth 2.00 faults 0", "goodbye 0",
    ]  # fmt: skip
    assert machine.counts.malformed == 0
    # A GOODBYE that is repeated before its answer arrives reaches a session that has ended, with its nonce.
    assert machine.counts.not_authentic < goodbyes
    assert machine.controller is None


def test_a_wrong_key_is_refused(client: Path) -> None:
    with RobotServer(RobotMachine(SteadyDrive(), key=KEY.encode())) as server:
        lines, _ = said(client, server.port, KEY.replace("a", "b"))
    assert lines[:3] == ["hello 14", "reset 14", "enable 14"]
    assert "depth 0.00 faults 0" in lines
