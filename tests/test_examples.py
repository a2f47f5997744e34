"""The folders that a lab copies: the commands of each README run, and the robot in C passes the tests of our own."""

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from needleplan.devices import Stage
from needleplan.devices.robot import RobotStage, RobotTiming
from tests import pages
from tests.devices.contract import StageContract
from tests.devices.robot.robot_in_c import free_port, robot_in_c

EXAMPLES = pages.ROOT / "examples"
FOLDERS = sorted(file.parent for file in EXAMPLES.glob("*/README.md"))
PATIENT = RobotTiming(silence_s=20.0, valid_s=20.0, answer_s=20.0, lost_s=20.0)


def test_all_folders_are_listed_and_their_links_lead_somewhere() -> None:
    listed = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    assert [folder.name for folder in FOLDERS if f"]({folder.name})" not in listed] == []
    for folder in FOLDERS:
        assert not pages.broken_links(folder / "README.md")
        assert len((folder / "README.md").read_text(encoding="utf-8").splitlines()) <= 40


@pytest.mark.slow
@pytest.mark.parametrize("name", [folder.name for folder in FOLDERS if folder.name != "robot-in-c"])
def test_the_commands_run(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = shutil.copytree(EXAMPLES / name, tmp_path / name)
    monkeypatch.chdir(folder)
    pages.run(folder / "README.md", folder)


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if shutil.which("cc") is None:
        pytest.skip("no C compiler here")
    patience = ("-DLONGEST_US=30000000u", "-DVALID_US=30000000u", "-DRELEASE_MS=60000u")
    return robot_in_c(tmp_path_factory.mktemp("robot"), *patience)


class TestTheRobotInC(StageContract):
    @pytest.fixture
    def sensor(self, program: Path) -> Iterator[Stage]:
        port = free_port()
        with subprocess.Popen([program, str(port)]) as robot:
            try:
                with RobotStage.open(f"udp://127.0.0.1:{port}", timing=PATIENT) as opened:
                    yield opened
            finally:
                robot.kill()
