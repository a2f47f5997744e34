"""One insertion through the proxy: the lab, the relays, the process of `needleplan insert`, and what becomes of it."""

import contextlib
import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

from fault_relays import Proxy, TcpRelay, UdpRelay

from needleplan.devices.robot.messages import RobotCommand, RobotKind, RobotState, RobotStatus, decode
from needleplan.devices.sensor_processes import LabPlaces, TrackerLine
from needleplan.errors import NeedleplanError, ProtocolError
from needleplan.estimation.registration import Registration, RegistrationVerdict, VerdictStatus
from needleplan.planning import PolicyTable, plan
from needleplan.recording import Recording, recover
from needleplan.scenario import Grid, Needle, Scenario, Target, TipMotion, Workspace
from needleplan.simulation import Effects, Setup, SimulatedEntry
from needleplan.simulation.lab_processes import RealTimeLab

COIL_MM = 2.0
KNOWN = RegistrationVerdict(VerdictStatus.ACCEPTED, accepted="lab twin: coil and frame are those of the simulation")
SPEED_MM_S = 5.0
DEPTH_MM = 3.0  # depth at which a fault is injected
BEGIN_S = 30.0  # longest time from the start of `insert` to this depth
SETTLED_S = 0.3  # time after the early end of `insert` for which the robot is observed
STOPPED = "stopped, not recorded"  # state of a run whose stop the recording does not contain
END_S = 15.0  # longest time from the request to end to the end of `insert`


@cache
def table() -> PolicyTable:
    """Return the table of all runs: 55 mm of free tissue."""
    return plan(
        Scenario(
            Workspace(70.0, 40.0), Target((60.0, 22.0), 1.5), Needle(40.0), motion=TipMotion(headings=72),
            grid=Grid((0.5, 0.5)),
        )
    )  # fmt: skip


@dataclass
class Outcome:
    """What became of one run. Times are in ms from the fault; NaN if the event did not happen."""

    name: str
    state: str = ""
    """First state of the guard after ENABLED in the recording, or ENABLED if the run continued until it was observed.

    `STOPPED` if the guard stopped the run but the recording does not contain it, else the exit code of `insert`.
    """

    cause: str = ""
    message: str = ""
    """Last line that `insert` has printed to its standard error."""

    stop_ms: float = math.nan
    """Time until a STOP passed the proxy, or until the robot had stopped by itself if that is earlier."""

    by: str = ""
    """Who stopped the needle: guard or robot."""

    inward_mm: float = math.nan
    """Motion of the needle after the fault."""

    recording: str = ""
    code: int | None = None
    disturbed: bool = False
    """Whether the run had ended before the fault, because the machine paused."""

    runs: int = 1
    """Number of runs, of which this is the last; the others ended otherwise than expected, or were disturbed."""

    pause_ms: float = math.nan
    """Longest pause of the thread of the proxy after the fault."""


@dataclass
class Run:
    """A lab, its relays, and the process of `insert`; faults are injected through these attributes."""

    lab: RealTimeLab
    folder: Path
    robot: UdpRelay
    force: UdpRelay
    tracker: TcpRelay
    proxy: Proxy
    process: subprocess.Popen[str] | None = None
    last: RobotStatus | None = None
    statuses: list[tuple[float, RobotStatus]] = field(default_factory=list)
    stops: list[float] = field(default_factory=list)
    session: int = 0
    fault_s: float = math.inf

    @property
    def pid(self) -> int:
        """Process id of `insert`."""
        assert self.process is not None
        return self.process.pid

    def see_status(self, data: bytes, now_s: float) -> None:
        """Note a status of the robot, as the robot sent it."""
        with contextlib.suppress(ProtocolError):
            message = decode(data)
            if isinstance(message, RobotStatus):
                self.last = message
                self.statuses.append((now_s, message))

    def see_command(self, data: bytes, now_s: float) -> None:
        """Note the STOP commands of the controller."""
        with contextlib.suppress(ProtocolError):
            message = decode(data)
            if isinstance(message, RobotCommand):
                self.session = message.head.session
                if message.kind is RobotKind.STOP:
                    self.stops.append(now_s)

    def wait(self, condition: Callable[[], bool], limit_s: float) -> bool:
        """Wait for a condition or the end of `insert`; return whether the condition became true."""
        end_s = time.monotonic() + limit_s
        while time.monotonic() < end_s:
            if condition():
                return True
            if self.process is not None and self.process.poll() is not None:
                return condition()
            time.sleep(0.002)
        return False


@contextlib.contextmanager
def opened(folder: Path):  # type: ignore[no-untyped-def]
    """Yield a Run with a fresh lab and proxy."""
    x, y, heading, _ = table().best_entry().pose
    effects = Effects(coil_offset_mm=COIL_MM, tracker_noise_mm=0.05, force_noise_n=0.02)
    setup = Setup(1 / 40, entry=SimulatedEntry(x, y, heading), effects=effects)
    with RealTimeLab(setup, 1, LabPlaces(tracker_line=TrackerLine.TCP)) as lab:
        robot, force, tracker = (urlsplit(each) for each in vars(lab.addresses).values())
        relays = (UdpRelay("127.0.0.1", robot.port or 0), UdpRelay("127.0.0.1", force.port or 0),
                  TcpRelay("127.0.0.1", tracker.port or 0))  # fmt: skip
        with Proxy(relays) as proxy:
            run = Run(lab, folder, *relays, proxy)
            run.robot.tap_to_client, run.robot.tap_to_device = run.see_status, run.see_command
            try:
                yield run
            finally:
                if run.process is not None and run.process.poll() is None:
                    run.process.kill()
                    run.process.wait()
                for pid in lab.pids.values():
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(pid, signal.SIGCONT)


def start(run: Run) -> None:
    """Start `needleplan insert` on the ports of the proxy."""
    at = run.lab.addresses
    http = parse_qs(urlsplit(at.force).query)["http_port"][0]
    table().write(run.folder / "table.h5")
    Registration(coil_offset_mm=COIL_MM, verdict=KNOWN).write(run.folder / "registration.toml")
    command = [
        sys.executable, "-B", "-m", "needleplan", "insert", "table.h5", "--robot", f"udp://127.0.0.1:{run.robot.port}",
        "--force-sensor", f"udp://127.0.0.1:{run.force.port}?http_port={http}",
        "--tracker", f"tcp://127.0.0.1:{run.tracker.port}", "--registration", "registration.toml",
        "--speed", f"{SPEED_MM_S:g}", "-o", "run.mcap", "--json",
    ]  # fmt: skip
    answer, errors = ((run.folder / name).open("w") for name in ("answer.json", "stderr"))
    run.process = subprocess.Popen(
        command, cwd=run.folder, stdout=answer, stderr=errors, text=True, start_new_session=True
    )  # fmt: skip


def observed(
    name: str, inject: Callable[[Run], object], folder: Path, before: Callable[[Run], object], observed_s: float
) -> Outcome:
    """Start an insertion, inject the fault at 3 mm of depth, and return what became of it within `observed_s`.

    `before` is called before `insert` is started.
    """
    found = Outcome(name)
    with opened(folder) as run:
        before(run)
        start(run)
        deep = run.wait(lambda: run.last is not None and run.last.depth_mm >= DEPTH_MM and not run.stops, BEGIN_S)
        found.disturbed = not deep
        run.stops.clear()
        begin_mm = run.last.depth_mm if run.last is not None else math.nan
        run.fault_s = time.monotonic()
        run.proxy.worst_pause_s = 0.0
        if deep:
            inject(run)
        run.wait(lambda: False, observed_s)
        if run.process is not None and run.process.poll() is not None:
            time.sleep(SETTLED_S)
        found.pause_ms = 1e3 * run.proxy.worst_pause_s
        _end(run, found, run.fault_s + observed_s)
        stopped_s = _rest(run)
        sent_s = min(run.stops, default=math.inf)
        found.by = "" if not deep or math.isinf(min(stopped_s, sent_s)) else "guard" if sent_s <= stopped_s else "robot"
        if found.by:
            found.stop_ms = 1e3 * (min(stopped_s, sent_s) - run.fault_s)
        depths = [status.depth_mm for at_s, status in run.statuses if at_s >= run.fault_s]
        found.inward_mm = max(depths, default=begin_mm) - begin_mm
    _read(folder, found)
    return found


def _rest(run: Run) -> float:
    """Return the time (s) of the first status after the fault in which the robot is in FAULT or disabled."""
    halted = (RobotState.FAULT, RobotState.DISABLED)
    return next((at_s for at_s, each in run.statuses if at_s >= run.fault_s and each.state in halted), math.inf)


def _end(run: Run, found: Outcome, end_s: float) -> None:
    """Wait for the end of `insert`; if it still runs, note the stops so far and interrupt it."""
    assert run.process is not None
    if run.process.poll() is None:
        stops = list(run.stops)
        run.process.send_signal(signal.SIGCONT)
        run.process.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            run.process.wait(END_S)
        if run.process.poll() is None:
            run.process.kill()
            run.process.wait()
        run.stops[:] = stops
        # What the robot did after the interruption is not the reaction to the fault.
        run.statuses[:] = [each for each in run.statuses if each[0] <= end_s]
        found.code = None
    else:
        found.code = run.process.returncode


def _read(folder: Path, found: Outcome) -> None:
    """Read the messages and the recording of a run."""
    lines = (folder / "stderr").read_text(errors="replace").strip().splitlines()
    found.message = lines[-1] if lines else ""
    with contextlib.suppress(ValueError):
        found.cause = json.loads((folder / "answer.json").read_text())["cause"]
    # Without a readable recording, the state follows from what was seen outside.
    interrupted = found.code is None and not found.by
    if interrupted:
        found.cause = ""
    found.state = "ENABLED" if interrupted else STOPPED if found.by == "guard" else f"exit code {found.code}"
    file = next((each for each in (folder / "run.mcap.partial", folder / "run.mcap") if each.exists()), None)
    if file is None:
        found.recording = "none"
        return
    try:
        if file.suffix == ".partial":
            recover(file, folder / "recovered.mcap")
            recording = Recording.read(folder / "recovered.mcap")
        else:
            recording = Recording.read(file)
    except NeedleplanError as error:
        found.recording = f"{file.name}: {str(error).splitlines()[0]}"
        return
    safety = [each.values for each in recording.messages(["/safety"])]
    events = [each.values for each in recording.messages(["/event"])]
    samples = sum(1 for _ in recording.messages(["/stage", "/force", "/pose"]))
    left = next((each for each in safety if each["name"] == "transition" and each.get("before") == "ENABLED"), None)
    if interrupted and left is not None and left["cause"] == "stop_ordered":
        left = None  # the interruption at the end of the observation
    if left is not None:
        found.state, found.cause = left["state"], left["cause"]
    last = events[-1]["name"] if events else "no event"
    found.recording = f"{file.name}: {samples} samples, {len(safety)} events of the guard, last {last}"


def from_json(text: str) -> dict[str, Outcome]:
    """Return the outcomes in a text of `as_json`, by the names of the faults."""
    rows = [{key: math.nan if each is None and key != "code" else each for key, each in row.items()}
            for row in json.loads(text)]  # fmt: skip
    return {row["name"]: Outcome(**row) for row in rows}


def as_json(outcomes: list[Outcome]) -> str:
    """Return the outcomes as JSON, with null for NaN."""
    rows = [{key: None if isinstance(each, float) and math.isnan(each) else each for key, each in vars(one).items()}
            for one in outcomes]  # fmt: skip
    return json.dumps(rows, indent=1)
