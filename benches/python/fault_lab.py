"""The simulated devices of `fault_to_stop.py`, in a process of their own on real sockets, and their faults."""

import contextlib
import math
import os
import random
import signal
import socket
import threading
import time
from collections.abc import Callable
from multiprocessing.connection import Connection

from needleplan.devices.ati import NetFtBox, NetFtServer
from needleplan.devices.ati.rdt import RdtCommand, encode_request
from needleplan.devices.endpoint import TcpEndpoint
from needleplan.devices.ndi import AuroraDevice, SimulatedTool
from needleplan.devices.ndi.frames import NdiVisibility
from needleplan.devices.robot import Fault, RobotDriveFaults, RobotMachine, RobotServer, RobotState, SteadyDrive
from needleplan.devices.robot.messages import RobotKind, decode
from needleplan.errors import ProtocolError

TOOL = "34801403"
# Time for which the process of the loop is suspended (s).
PAUSE_S = 0.2


class FaultLab:
    """Servers of the three devices. Records the times of the first stop after a fault and of the robot's rest."""

    def __init__(self) -> None:
        noise = random.Random(1)
        self.extra_n = 0.0
        self.box = NetFtBox(lambda _: (noise.gauss(0, 0.01), noise.gauss(0, 0.01), 1 + self.extra_n, 0, 0, 0))
        self.box.ft_sequence = 3_000_000_000
        self.tool = SimulatedTool(TOOL, lambda time_s: ((1, 0, 0, 0), (10 + time_s, -20, -150)))
        self.aurora = AuroraDevice([self.tool])
        self.machine = RobotMachine(SteadyDrive())
        self.stop_ns = self.stood_ns = 0
        self._receive, self._tick = self.machine.receive, self.machine.tick
        self.machine.receive = self.received  # type: ignore[method-assign]
        self.machine.tick = self.ticked  # type: ignore[method-assign]
        self.fault_ns = 0
        self.force, self.coils = NetFtServer(self.box), TcpEndpoint(self.aurora)
        self.robot = RobotServer(self.machine)
        self.robot.__enter__()

    @property
    def addresses(self) -> tuple[str, str, str]:
        """Addresses of force sensor, tracker and robot."""
        return self.force.address, f"{self.coils.address}?tool={TOOL}", self.robot.address

    def received(self, datagram: bytes, sender: tuple[str, int], now_ns: int) -> bytes:
        """Answer a datagram; record the time of the first stop after the fault."""
        answer = self._receive(datagram, sender, now_ns)
        if self.fault_ns and not self.stop_ns:
            with contextlib.suppress(ProtocolError):
                if getattr(decode(datagram), "kind", None) is RobotKind.STOP:
                    self.stop_ns = time.monotonic_ns()
        return answer

    def ticked(self, now_ns: int) -> object:
        """Run the tick of the robot; record the first time after the fault at which it does not move."""
        sent = self._tick(now_ns)
        if self.fault_ns and not self.stood_ns and not self.moving:
            self.stood_ns = time.monotonic_ns()
        return sent

    @property
    def moving(self) -> bool:
        """Whether the robot is enabled and moves."""
        return self.machine.state is RobotState.ENABLED and self.machine.drive.advance(time.monotonic()).moving

    def inject(self, name: str) -> None:
        """Inject the fault and record its time."""
        # The time is taken before the fault, so that the duration of the injection counts.
        self.fault_ns = time.monotonic_ns()
        self.robot.worst_overrun_s = 0.0
        FAULTS[name](self)

    def close(self) -> None:
        """Close all servers."""
        for each in (self.force, self.coils):
            with contextlib.suppress(OSError):
                each.close()
        self.robot.__exit__(None, None, None)


def silent(lab: FaultLab) -> None:
    lab.box.faults.silent = True


def garbage(lab: FaultLab) -> None:
    step = lab.box.step
    lab.box.step = lambda time_s: [b"\xff" * len(each) for each in step(time_s)]  # type: ignore[method-assign]


def stolen(lab: FaultLab) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as thief:
        thief.sendto(encode_request(RdtCommand.START), (lab.force.host, lab.force.port))


def reboot(lab: FaultLab) -> None:
    client = lab.box.client
    lab.box.reboot()
    lab.box.client = client


def strong(lab: FaultLab) -> None:
    lab.extra_n = 12.0


def elsewhere(lab: FaultLab) -> None:
    lab.tool.pose = lambda time_s: ((1, 0, 0, 0), (10 + time_s, 40, -150))


def stopped(_: FaultLab) -> None:
    """Suspend the process of the loop for a short time, as a debugger or a swapping machine does."""
    os.kill(os.getppid(), signal.SIGSTOP)
    threading.Timer(PAUSE_S, os.kill, (os.getppid(), signal.SIGCONT)).start()


def status(value: int) -> Callable[[FaultLab], None]:
    return lambda lab: setattr(lab.box.faults, "status", value)


def seen(value: NdiVisibility) -> Callable[[FaultLab], None]:
    return lambda lab: setattr(lab.tool, "visibility", value)


def aurora(name: str, value: object) -> Callable[[FaultLab], None]:
    return lambda lab: setattr(lab.aurora.faults, name, value)


def drive(**faults: object) -> Callable[[FaultLab], None]:
    return lambda lab: setattr(lab.machine.drive, "faults", RobotDriveFaults(**faults))  # type: ignore[arg-type]


FAULTS: dict[str, Callable[[FaultLab], None]] = {
    "2 force: stream stops": silent,
    "7 force: frozen measurement": lambda lab: setattr(lab.box.faults, "freeze", True),
    "8 force: box restarts": reboot,
    "9 force: nothing but garbage": garbage,
    "11 force: saturation": status(0x8002_0000),
    "12 force: threshold latched": lambda lab: lab.box.exceed_threshold(),
    "13 force: other status": status(0x8800_0000),
    "15 force: stream stolen": stolen,
    "16 force: beyond its limit": strong,
    "18 tracker: damage without end": aurora("damage", 10**9),
    "20 tracker: an error": aurora("error", 0x0C),
    "21 tracker: coil not seen": seen(NdiVisibility.MISSING),
    "21 tracker: tool disabled": seen(NdiVisibility.DISABLED),
    "22 tracker: out of the volume": lambda lab: setattr(lab.tool, "port_bits", 0x40),
    "23 tracker: frozen frame": aurora("freeze", True),
    "24 tracker: another tool": elsewhere,
    "25 tracker: RESET": lambda lab: lab.coils.say(lab.aurora.reset()),
    "26 tracker: no reply": aurora("mute", True),
    "27 tracker: cable out": lambda lab: lab.coils.close(),
    "28 robot: drive fault": drive(reported=Fault.DRIVE),
    "30 robot: axis stuck": drive(stuck=True),
    "31 robot: emergency stop": drive(reported=Fault.ESTOP),
    "33 loop: hangs": lambda _: None,
    "33 loop: process stopped for 200 ms": stopped,
    "34 clock: a sample from the future": lambda _: None,
    "35 recorder: its thread dies": lambda _: None,
    "36 operator: a person's stop": lambda _: None,
}
OF_THE_LOOP = ("33 loop: hangs", "34 clock: a sample from the future", "35 recorder: its thread dies",
               "36 operator: a person's stop")  # fmt: skip
"""Faults that are injected in the process of the loop."""


def serve(pipe: Connection) -> None:
    """Execute the commands (open, inject, moving, close) from the pipe until it is closed."""
    lab: FaultLab | None = None
    while True:
        try:
            what, name = pipe.recv()
        except EOFError:
            return
        if what == "open":
            lab = FaultLab()
            pipe.send(lab.addresses)
        elif lab is None:
            pipe.send(None)
        elif what == "inject":
            lab.inject(name)
            pipe.send(lab.fault_ns)
        elif what == "moving":
            pipe.send(lab.moving)
        elif what == "close":
            pipe.send((lab.stop_ns or math.nan, lab.stood_ns or math.nan, lab.robot.worst_overrun_s * 1e3))
            lab.close()
            lab = None
