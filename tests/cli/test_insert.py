"""`needleplan insert` in the simulated lab, and what it refuses before anything moves."""

import json
import math
import os
import pty
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from needleplan.cli import main
from needleplan.control import require_fitting
from needleplan.errors import TableError
from needleplan.recording import Recording
from needleplan.scenario import Identified
from tests.cli.commands import needleplan
from tests.control.scenes import small_table
from tests.estimation.registrations import known


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("tables") / "table.h5"
    small_table().write(path)
    return path


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("simulations") / "quick.toml"
    path.write_text(
        'schema = "needleplan.simulation/1"\n[tissue]\ncurvature_per_mm = 0.025\n[robot]\nservo_hz = 400\n'
        "bandwidth_hz = 10\n[effects]\ncoil_offset_mm = 2.0\ntracker_noise_mm = 0.05\ntorsional_friction_n = 0.02\n"
        "[[move]]\ndwell_s = 1.0\n"
    )
    return path


@pytest.mark.slow
def test_it_reaches_the_target_and_the_recording_replays(file: Path, quick: Path, tmp_path: Path) -> None:
    run, figure = tmp_path / "run.mcap", tmp_path / "run.svg"
    arguments = (
        "--speed",
        10,
        "--rotation-speed-deg",
        573,
        "--roll-left-deg",
        1.5,
        "-o",
        run,
        "--figure",
        figure,
        "--json",
    )
    done = needleplan("insert", file, "--robot", f"sim://{quick}?seed=10", *map(str, arguments))
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert answer["ending"] == "target"
    assert answer["error_mm"] <= small_table().scenario.target.radius_mm
    assert answer["true_error_mm"] == pytest.approx(answer["error_mm"], abs=0.3)
    assert answer["table"] == small_table().digest
    assert "step " not in done.stderr
    assert "<svg" in figure.read_text()
    recording = Recording.read(run)
    session = recording.session
    assert session.force_axis == (0.0, 0.0, 1.0)
    used = json.loads(session.texts["options.json"])
    assert used["torsion"]["torque_per_length_n"] == 0.02
    assert used["roll_left_rad"] == pytest.approx(math.radians(1.5))
    assert used["velocity_rad_s"] == pytest.approx(math.radians(573))
    commands = [each.values for each in recording.messages(["/command"])]
    speeds = {each["speed"] for each in commands if each["kind"] == "rotate"}
    assert [*speeds] == [pytest.approx(math.radians(573))]
    again = needleplan("recording", "replay", run, "--table", file, "--json")
    assert again.returncode == 0, again.stderr
    assert json.loads(again.stdout) == {
        "same": True, "decisions": answer["steps"], "recorded": answer["steps"], "differences": [], "ending": "target",
    }  # fmt: skip


def test_without_a_way_to_the_target_it_does_not_begin(file: Path, quick: Path) -> None:
    done = needleplan("insert", file, "--robot", f"sim://{quick}", "--start=0,39,85", "--json")
    assert done.returncode == 1
    answer = json.loads(done.stdout)
    assert (answer["ending"], answer["steps"], answer["inserted_mm"]) == ("unreachable", 0, 0)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--robot", "udp:/wrong"], ["--robot", "udp"]),
        (["--robot", "tcp://127.0.0.1:1", "--force-sensor", "udp://x", "--tracker", "tcp://x", "--registration", "REG"],
         ["--robot", "must begin with udp://, canopen://"]),
        (["--robot", "sim://steering", "--force-sensor", "sim://insertion"], ["must be the same address"]),
        (["--robot", "sim://", "--force-sensor", "udp://127.0.0.1", "--registration", "REG"], ["cannot be simulated"]),
        (["--tracker", "serial:///dev/ttyNONE", "--robot", "udp://127.0.0.1", "--force-sensor", "udp://127.0.0.1"],
         ["--registration", "is missing"]),
        (["--robot", "sim://nowhere"], ["nowhere"]),
        (["--robot", "sim://?seed=-3"], ["seed = -3", "whole number"]),
        (["--robot", "sim://?sead=3"], ['did you mean "seed"']),
        (["--start=-5,20,0"], ["must lie in the workspace"]),
        (["--speed", "12"], ["--speed = 12", "within the limits of the run"]),
        (["--speed", "nan"], ["--speed = nan", "mm/s, within the limits of the run, above 0"]),
        (["--rotation-speed-deg", "1e4"], ["--rotation-speed-deg = 10000", "at most 687.549"]),
        (["--entry-depth", "1000"], ["--entry-depth = 1000", "at least -100 and at most 150"]),
        (["--roll-left-deg", "nan"], ["--roll-left-deg = nan", "number in degrees"]),
        (["--limits", "REG", "-o", "old.mcap"], ["old.mcap", "exists already", "--force overwrites it"]),
        (["--needle-length", "0"], ["--needle-length = 0", "above 0"]),
        (["--start", "0,20,0,2"], ["--start = 0,20,0,2", "X,Y,DEG"]),
        (["--figure", "run.bmp"], ["run.bmp", "must end in .png"]),
        (["-o", "run.csv"], ["--output = run.csv", "must end in .mcap"]),
        (["--limits", "run.mcap", "-o", "run.mcap"], ["would replace run.mcap"]),
        (["--torsion", "1e4"], ["--torsion", "2 numbers"]),
        (["--force-axis", "0,0,0"], ["--force-axis", "direction"]),
        (["--scenario", "four_obstacles"], ["workspace.width_mm = 60.0", "must be equal to that of the scenario, 120.0",
                                            "grid.spacing_mm"]),
        (["--limits", "none.toml"], ["none.toml", "cannot be read"]),
        (["--limits", "lax.toml"], ["lax.toml", "safety.force_n = 40: is laxer than the default, 5",
                                    "safety.stage_age_s = 10", "--accept-limits REASON"]),
        (["--limits", "lax.toml", "--accept-limits", ""], ["--accept-limits", "must be a reason"]),
        (["--deadman", "key"], ["--deadman = key", "needs real time"]),
        (["--registration", "none.toml"], ["none.toml", "cannot be read"]),
        (["-o", "/nowhere/run.mcap"], ["/nowhere"]),
    ],
    ids=lambda value: " ".join(value[:2]) if isinstance(value, list) else None,
)  # fmt: skip
def test_what_is_refused(
    arguments: list[str], words: list[str], file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    known().write("REG")
    Path("old.mcap").write_text("")
    Path("lax.toml").write_text("[safety]\nforce_n = 40.0\nstage_age_s = 10.0\n")
    assert main(["insert", str(file), *arguments]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert "step" not in said.err
    for word in words:
        assert word in said.err


def test_the_reason_for_lax_limits_is_recorded(file: Path, quick: Path, tmp_path: Path) -> None:
    (tmp_path / "lax.toml").write_text("[safety]\nout_of_plane_mm = 6.0\n")
    words = ("--robot", f"sim://{quick}", "--start=0,39,85", "--json", "-o", tmp_path / "run.mcap")
    done = needleplan("insert", file, *words, "--limits", tmp_path / "lax.toml", "--accept-limits", "a soft phantom")
    assert json.loads(done.stdout)["accepted_limits"] == "a soft phantom"
    assert Recording.read(tmp_path / "run.mcap").session.texts["accepted_limits.txt"] == "a soft phantom"


def test_a_table_for_another_needle_is_refused(file: Path) -> None:
    needle = Identified(1 / 55, 1 / 60, 1 / 50, "bicycle", 3, "sha256:0")
    with pytest.raises(TableError, match="must be from 50 to 60 mm: the identified needle has 55 mm"):
        require_fitting(small_table(), str(file), needle=needle)
    require_fitting(small_table(), str(file), needle=Identified(1 / 41, 1 / 45, 1 / 38, "bicycle", 3, "sha256:0"))
    without_interval = Identified(1 / 41, math.nan, math.nan, "bicycle", 3, "sha256:0")
    require_fitting(small_table(), str(file), needle=without_interval)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_who_stops_it_leaves_the_needle_and_a_whole_recording(
    number: signal.Signals, file: Path, quick: Path, tmp_path: Path
) -> None:
    command = [sys.executable, "-m", "needleplan", "insert", str(file), "--robot", f"sim://{quick}", "--speed", "1"]
    with subprocess.Popen(
        [*command, "-o", str(tmp_path / "run.mcap")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as running:
        assert running.stderr is not None
        assert any(line.startswith("step   1") for line in running.stderr)
        running.send_signal(number)
        said, _ = running.communicate()
    assert running.returncode == 130
    assert "stopped" in said
    recording = Recording.read(tmp_path / "run.mcap")
    events = [each.values["name"] for each in recording.messages(["/event"])]
    assert events[-2:] == ["stop", "end"]
    assert [each.values["kind"] for each in recording.messages(["/command"])][-1] == "stop"


@pytest.mark.slow
def test_a_terminal_that_is_closed_stops_the_needle_and_leaves_a_whole_recording(
    file: Path, quick: Path, tmp_path: Path
) -> None:
    """Everything that is printed afterwards fails, and must not end the program before the recording is finished."""
    command = [sys.executable, "-m", "needleplan", "insert", str(file), "--robot", f"sim://{quick}", "--speed", "1"]
    process, terminal = pty.fork()
    if not process:
        os.execv(sys.executable, [*command, "-o", str(tmp_path / "run.mcap")])
    shown = b""
    while b"action" not in shown:
        shown += os.read(terminal, 1000)
    os.close(terminal)
    os.waitpid(process, 0)
    recording = Recording.read(tmp_path / "run.mcap")
    events = [each.values for each in recording.messages(["/event"])]
    assert [each["name"] for each in events][-2:] == ["stop", "end"]
    assert "the terminal was closed" in json.dumps(events[-2:])
    assert [each.values["kind"] for each in recording.messages(["/command"])][-1] == "stop"
