"""The faults that `fault_proxy.py` provokes from outside: in the relays, by foreign clients, and at the processes."""

import contextlib
import math
import os
import resource
import shutil
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
import zlib
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

from fault_filters import (
    Inject,
    backwards_status,
    cut_short,
    damaged,
    delayed,
    doubled,
    drifting_frame,
    drifting_records,
    drifting_status,
    filtered,
    frames,
    fresh,
    frozen_counts,
    frozen_frames,
    frozen_status,
    interrupted,
    lossy,
    moved,
    records,
    relay_of,
    replayed,
    restarted_box,
    statuses,
    swapped,
    turning,
    with_counts,
    with_fields,
    with_more,
)
from fault_relays import Sent, as_it_is, nothing
from fault_run import STOPPED, Run

from needleplan.devices.ati.rdt import RdtCommand, encode_request
from needleplan.devices.ndi.frames import NdiVisibility
from needleplan.devices.robot import Fault
from needleplan.devices.robot.messages import Head, Hello, RobotCommand, RobotKind, RobotStatus, encode

ENABLED, PAUSED, FAULT, DISABLED, STANDS = "ENABLED", "PAUSED", "FAULT", "DISABLED", "the robot stands"


@dataclass(frozen=True)
class Case:
    """One fault. `causes` are the accepted causes, one of which must be shown; () if none or any."""

    name: str
    inject: Inject
    states: tuple[str, ...]
    causes: tuple[str, ...] = ()
    before: Inject = lambda _: None
    observed_s: float = 1.2
    """Time after the injection for which the run is observed, unless it ends before."""


def stranger(address: Callable[[Run], tuple[str, int]], *datagrams: bytes, every_s: float = 0.0) -> Inject:
    """Send datagrams from a socket of a foreign client; again every `every_s` for two seconds if that is positive."""

    def send(run: Run) -> None:
        where = address(run)

        def work() -> None:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
                until_s = time.monotonic() + (2.0 if every_s else 0.0)
                while True:
                    for each in datagrams:
                        end.sendto(each, where)
                    if time.monotonic() >= until_s:
                        time.sleep(0.2)
                        return
                    time.sleep(every_s)

        threading.Thread(target=work, daemon=True).start()

    return send


def _robot(run: Run) -> tuple[str, int]:
    return run.robot.device


def _box(run: Run) -> tuple[str, int]:
    return run.force.device


def _insert_force(run: Run) -> tuple[str, int]:
    assert run.force.client is not None
    return run.force.client


def _insert_robot(run: Run) -> tuple[str, int]:
    assert run.robot.client is not None
    return run.robot.client


def as_client(device: str, data: bytes) -> Inject:
    """Send data to a device from the address of the client, as a program that spoofs it does."""
    return lambda run: run.proxy.call(lambda: relay_of(device)(run).send(data, to_device=True))


def _own_session(kind: RobotKind) -> Inject:
    """Send a command of the session of `insert` from its address, with a sequence far ahead."""

    def send(run: Run) -> None:
        command = RobotCommand(Head(run.session, 1 << 20, 1, number=1 << 20), kind)
        run.proxy.call(lambda: run.robot.send(encode(command), to_device=True))

    return send


def _stop_and_late_insert(run: Run) -> None:
    """Hold back what `insert` sends for 20 ms, and let a stranger stop the robot meanwhile."""
    run.robot.to_device = lambda data: [(0.02, data)]
    _foreign_stop(run)


_STOP = encode(RobotCommand(Head(0, 1, 1, number=1), RobotKind.STOP))
_foreign_stop = stranger(_robot, _STOP)


def _other_version(data: bytes) -> Sent:
    raw = bytearray(data[:-4])
    raw[4] = 9
    return [(0.0, bytes(raw) + struct.pack("<I", zlib.crc32(bytes(raw))))]


def _old_commands(run: Run) -> None:
    """Replay the commands of the last second from the address of the client."""
    for data in list(run_history(run)):
        run.proxy.later(run.robot, 0.0, data, to_device=True)


def run_history(run: Run) -> deque[bytes]:
    """Return the last commands of the controller, which `remember` has kept."""
    return getattr(run, "history", deque())


def remember(run: Run) -> None:
    history: deque[bytes] = deque(maxlen=300)
    run.history = history  # type: ignore[attr-defined]

    def keep(data: bytes) -> Sent:
        history.append(data)
        return as_it_is(data)

    run.robot.to_device = keep


def signalled(process: str, *signals: tuple[signal.Signals, float]) -> Inject:
    """Send signals with delays (s) to `insert`, to a process of the lab by its name, or to `all`."""

    def send(run: Run) -> None:
        pids = {"insert": run.pid, **run.lab.pids}
        for number, delay_s in signals:
            time.sleep(delay_s)
            for name, pid in pids.items():
                if process in (name, "all"):
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(pid, number)

    return send


def commanded(command: str) -> Inject:
    """Run another command of needleplan at the robot itself, as a person does in another terminal."""

    def run_it(run: Run) -> None:
        host, port = run.robot.device
        where = [sys.executable, "-m", "needleplan", command, "--robot", f"udp://{host}:{port}"]
        process = subprocess.Popen(where, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        # A person starts a program without the priority of this bench, which would take the processor from `insert`.
        os.sched_setscheduler(process.pid, os.SCHED_OTHER, os.sched_param(0))

    return run_it


def _file_limit(run: Run) -> None:
    """Let every further write of the recording fail, as on a full disk."""
    size = (run.folder / "run.mcap.partial").stat().st_size if (run.folder / "run.mcap.partial").exists() else 1
    resource.prlimit(run.pid, resource.RLIMIT_FSIZE, (size, size))


def _file_appears(run: Run) -> None:
    (run.folder / "run.mcap").write_text("another program's file")


def _folder_vanishes(run: Run) -> None:
    for each in run.folder.glob("run.mcap*"):
        each.unlink()
    shutil.rmtree(run.folder / "nowhere", ignore_errors=True)


def _cable_out(run: Run) -> None:
    run.proxy.call(run.tracker.cut)


def _held_by_another(run: Run) -> None:
    hello = encode(Hello(Head(77, 1, 1, number=1)))
    stranger(_robot, hello, every_s=0.5)(run)
    time.sleep(0.1)


def _after(seconds: float, then: Inject) -> Inject:
    def later(run: Run) -> None:
        threading.Timer(seconds, then, (run,)).start()

    return later


_STALE_STAGE = ("stage_stale", "stage_fault", "stage_suspect")
_LOAD_N = 12_000_000  # counts of 12 N
_false = RobotStatus(Head(1, 9_999_999, 1, number=3), 99.0, 0, 0, 0, Fault(0), 1, False)  # type: ignore[arg-type]


CASES = [
    Case("force: silent", filtered("force", lambda _: nothing), (FAULT,), ("force_stale",)),
    Case("force: silent for 15 ms", filtered("force", interrupted(0.015)), (ENABLED,)),
    Case("force: silent for 200 ms", filtered("force", interrupted(0.2)), (FAULT,), ("force_stale",)),
    Case("force: half of the records lost", filtered("force", lossy(0.5)), (ENABLED, FAULT)),
    Case("force: 100 ms late", filtered("force", delayed(0.1)), (FAULT,), ("force_stale",)),
    Case("force: later by 50 ms each second", filtered("force", delayed(0, 0.05)), (FAULT,), ("force_stale",)),
    Case("force: clock slow by 2 %", fresh(lambda: drifting_records(0.98)), (FAULT,), ("force_stale",), observed_s=3.0),
    Case("force: reordered", filtered("force", swapped), (ENABLED,)),
    Case("force: duplicated", filtered("force", doubled), (ENABLED,)),
    Case("force: replayed after 0.5 s", filtered("force", replayed), (ENABLED,)),
    Case("force: every tenth record cut short", filtered("force", cut_short(0.1)), (ENABLED,)),
    Case("force: all records cut short", filtered("force", cut_short(1.0)), (FAULT,), ("force_stale", "force_fault")),
    Case("force: saturated", records(lambda each: replace(each, status=0x8002_0000)), (FAULT,), ("force_suspect",)),
    Case("force: broken gage", records(lambda each: replace(each, status=0x9000_0000)), (FAULT,), ("force_fault",)),
    Case("force: frozen counts", fresh(frozen_counts), (FAULT,), ("force_suspect",)),
    Case("force: a step of 12 N", records(with_counts(2, _LOAD_N)), (FAULT,),
         ("force_exceeded", "force_rate_exceeded")),
    Case("force: box restarts", fresh(restarted_box), (FAULT,), ("force_fault",)),
    Case("force: foreign START", stranger(_box, encode_request(RdtCommand.START)), (FAULT,),
         ("force_stale", "force_fault")),
    Case("force: START from our address", as_client("force", encode_request(RdtCommand.START)), (FAULT,),
         ("force_fault",)),
    Case("force: STOP from our address", as_client("force", encode_request(RdtCommand.STOP)), (FAULT,),
         ("force_stale", "force_fault")),
    Case("force: foreign STOP", stranger(_box, encode_request(RdtCommand.STOP)), (ENABLED,)),
    Case("force: foreign BIAS", stranger(_box, encode_request(RdtCommand.BIAS)), (FAULT,), ("force_fault",)),
    Case("force: foreign BIAS every 0.2 s", stranger(_box, encode_request(RdtCommand.BIAS), every_s=0.2), (FAULT,),
         ("force_fault",), observed_s=2.5),
    Case("force: records of a stranger", stranger(_insert_force, bytes(36), every_s=0.01), (ENABLED,)),
    Case("robot: not heard", filtered("robot", lambda _: nothing), (FAULT,), _STALE_STAGE),
    Case("robot: hears nothing", filtered("robot", lambda _: nothing, to_device=True), (FAULT,), _STALE_STAGE),
    Case("robot: both silent for 200 ms", lambda run: [
        filtered("robot", interrupted(0.2), to_device=side)(run) for side in (True, False)], (FAULT,), _STALE_STAGE),
    Case("robot: statuses 100 ms late", filtered("robot", delayed(0.1)), (FAULT,), _STALE_STAGE),
    Case("robot: statuses later by 50 ms each second", filtered("robot", delayed(0, 0.05)), (FAULT,), _STALE_STAGE),
    Case("robot: commands 60 ms late", filtered("robot", delayed(0.06), to_device=True), (FAULT,), _STALE_STAGE),
    Case("robot: clock slow by 2 %", statuses(drifting_status(0.98)), (FAULT,), _STALE_STAGE, observed_s=3.0),
    Case("robot: statuses reordered", filtered("robot", swapped), (ENABLED,)),
    Case("robot: commands reordered", filtered("robot", swapped, to_device=True), (ENABLED, FAULT)),
    Case("robot: duplicated both ways", lambda run: [
        filtered("robot", doubled, to_device=side)(run) for side in (True, False)], (ENABLED,)),
    Case("robot: a tenth of the datagrams damaged", lambda run: [
        filtered("robot", damaged(0.1), to_device=side)(run) for side in (True, False)], (ENABLED,)),
    Case("robot: all statuses damaged", filtered("robot", damaged(1.0)), (FAULT,), _STALE_STAGE),
    Case("robot: replay of our old commands", _old_commands, (ENABLED,), (), remember),
    Case("robot: foreign STOP", _foreign_stop, (FAULT,), ("stage_fault",)),
    Case("robot: foreign STOP, our commands 20 ms late", _stop_and_late_insert, (FAULT,), ("stage_fault",)),
    Case("robot: STOP in our session", _own_session(RobotKind.STOP), (FAULT,), ("stage_fault", "no_motion")),
    Case("robot: GOODBYE in our session", _own_session(RobotKind.GOODBYE), (FAULT,), ("stage_fault",)),
    Case("robot: a second controller", stranger(_robot, encode(Hello(Head(77, 1, 1, number=1)))), (ENABLED,)),
    Case("robot: statuses of a stranger", stranger(_insert_robot, encode(_false), every_s=0.01), (ENABLED,)),
    Case("robot: another version", filtered("robot", lambda _: _other_version), (FAULT,), _STALE_STAGE),
    Case("robot: emergency stop", statuses(with_fields(faults=Fault.ESTOP, state=3)), (FAULT,), ("stage_fault",)),
    Case("robot: depth is not a number", statuses(with_fields(depth_mm=math.nan)), (FAULT,), ("stage_suspect",)),
    Case("robot: depth jumps by 5 mm", statuses(with_more(depth_mm=5.0)), (FAULT,), ("stage_jumped",)),
    Case("robot: depth jumps to -50 mm (homed again)", statuses(with_more(depth_mm=-53.0)), (FAULT,),
         ("stage_jumped",)),
    Case("robot: depth counts backwards", statuses(backwards_status), (FAULT,), ("wrong_way",)),
    Case("robot: depth stands still", statuses(frozen_status), (FAULT, PAUSED),
         ("no_motion", "stage_fault", "tip_unknown")),
    Case("robot: speed of 40 mm/s", statuses(with_fields(velocity_mm_s=40.0)), (FAULT,), ("overspeed",)),
    Case("robot: roll of 1,000 rad", statuses(with_more(roll_rad=1000.0)), (FAULT,)),
    Case("robot: roll turns by itself", statuses(lambda: turning()), (FAULT,)),
    Case("tracker: silent", filtered("tracker", lambda _: nothing), (PAUSED,), ("pose_stale",)),
    Case("tracker: 100 ms late", filtered("tracker", delayed(0.1)), (PAUSED,), ("pose_stale",)),
    Case("tracker: later by 50 ms each second", filtered("tracker", delayed(0, 0.05)), (PAUSED,), ("pose_stale",)),
    Case("tracker: clock slow by 10 %", frames(drifting_frame(0.9)), (PAUSED,), ("pose_stale",), observed_s=2.0),
    Case("tracker: frozen frame", fresh(frozen_frames), (PAUSED, FAULT), ("pose_stale", "pose_fault")),
    Case("tracker: all replies damaged", filtered("tracker", damaged(1.0)), (PAUSED, FAULT),
         ("pose_stale", "pose_fault")),
    Case("tracker: every tenth reply damaged", filtered("tracker", damaged(0.1)), (ENABLED, PAUSED)),
    Case("tracker: cable out", _cable_out, (FAULT,), ("pose_fault",)),
    Case("tracker: coil not seen", frames(lambda: lambda tool: replace(tool, visibility=NdiVisibility.MISSING)),
         (PAUSED,), ("pose_unseen",)),
    Case("tracker: another coil, 20 mm away", frames(moved(20.0)), (PAUSED, FAULT), ("pose_suspect", "pose_jumped")),
    Case("tracker: out of the plane by 4.9 mm at once and 4.9 mm later", lambda run: [
        frames(moved(0, 4.9))(run), _after(0.5, frames(moved(0, 9.8)))(run)], (FAULT, PAUSED), ()),
    Case("tracker: frame number goes back", frames(lambda: lambda tool: replace(tool, frame=1)), (FAULT,),
         ("pose_fault",)),
    Case("tracker: RESET", lambda run: run.proxy.call(lambda: run.tracker.send(b"RESETBE6F\r", to_device=False)),
         (FAULT,), ("pose_fault",)),
    Case("process: insert killed", signalled("insert", (signal.SIGKILL, 0)), (STANDS,)),
    Case("process: insert suspended", signalled("insert", (signal.SIGSTOP, 0)), (FAULT,)),
    Case("process: insert suspended for 200 ms", signalled("insert", (signal.SIGSTOP, 0), (signal.SIGCONT, 0.2)),
         (FAULT,)),
    Case("process: insert asked to end (SIGTERM)", signalled("insert", (signal.SIGTERM, 0)), (DISABLED,)),
    Case("process: insert interrupted (Ctrl-C)", signalled("insert", (signal.SIGINT, 0)), (DISABLED,)),
    Case("process: terminal closed (SIGHUP)", signalled("insert", (signal.SIGHUP, 0)), (DISABLED, STANDS)),
    Case("process: robot killed", signalled("robot", (signal.SIGKILL, 0)), (FAULT,)),
    Case("process: robot suspended for 200 ms", signalled("robot", (signal.SIGSTOP, 0), (signal.SIGCONT, 0.2)),
         (FAULT,)),
    Case("process: force sensor killed", signalled("force sensor", (signal.SIGKILL, 0)), (FAULT,),
         ("force_stale", "force_fault")),
    Case("process: force sensor suspended", signalled("force sensor", (signal.SIGSTOP, 0)), (FAULT,),
         ("force_stale", "force_fault")),
    Case("process: tracker killed", signalled("tracker", (signal.SIGKILL, 0)), (FAULT,), ("pose_fault",)),
    Case("process: tracker suspended", signalled("tracker", (signal.SIGSTOP, 0)), (PAUSED,), ("pose_stale",)),
    Case("process: everything suspended for 0.5 s", signalled("all", (signal.SIGSTOP, 0), (signal.SIGCONT, 0.5)),
         (FAULT,)),
    Case("disk: full", _file_limit, (STOPPED,)),
    Case("disk: the recording is deleted", _folder_vanishes, (ENABLED,)),
    Case("disk: a file appears at the target", _file_appears, (ENABLED,)),
    Case("person: stops from another terminal (STOP without a session)", _foreign_stop, (FAULT,), ("stage_fault",)),
    Case("person: needleplan stop (from the start of the program)", commanded("stop"), (FAULT,), ("stage_fault",),
         observed_s=6.0),
    Case("person: needleplan retract during the run", commanded("retract"), (FAULT,), ("stage_fault",), observed_s=6.0),
    Case("person: Ctrl-C twice", signalled("insert", (signal.SIGINT, 0), (signal.SIGINT, 0.05)), (DISABLED,)),
    Case("person: Ctrl-C while the force sensor is silent", lambda run: [
        filtered("force", lambda _: nothing)(run), signalled("insert", (signal.SIGINT, 0.01))(run)],
        (DISABLED, FAULT), ("stop_ordered", "force_stale")),
    Case("person: Ctrl-C while the tracker is silent", lambda run: [
        filtered("tracker", lambda _: nothing)(run), signalled("insert", (signal.SIGINT, 0.1))(run)],
        (PAUSED, DISABLED), ("pose_stale", "stop_ordered")),
    Case("person: Ctrl-C while the robot hears nothing", lambda run: [
        filtered("robot", lambda _: nothing, to_device=True)(run), signalled("insert", (signal.SIGINT, 0.01))(run)],
        (FAULT, DISABLED), ("stage_fault", "stage_stale", "stop_ordered")),
    Case("start: another program holds the robot", lambda _: None, ("exit code 2", DISABLED), (), _held_by_another),
    Case("start: tracker silent", lambda _: None, ("exit code 2", DISABLED), (),
         filtered("tracker", lambda _: nothing)),
]  # fmt: skip
"""All faults, in the order of the report."""
