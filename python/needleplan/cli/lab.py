"""`needleplan lab`: run simulated devices in real time, which other programs open by their addresses."""

from __future__ import annotations

import argparse
import contextlib
import signal
import sys
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from needleplan.cli.answer import complain, note, print_json, print_summary
from needleplan.cli.interrupt import handled_signals
from needleplan.cli.options import add_answer, add_output, add_start, require_outputs, require_rules, require_table
from needleplan.cli.parser import Parser, whole
from needleplan.errors import DeviceFault, InputError, Mistake

if TYPE_CHECKING:
    from needleplan.estimation.registration import Registration
    from needleplan.simulation import Setup, Simulation
    from needleplan.simulation.lab_processes import RealTimeLab

__all__ = ["add_to", "run"]

_PORTS = ("--robot-port", "--force-port", "--http-port", "--tracker-port")
# Time (s) between two checks whether processes of the lab have ended.
_LOOK_S = 0.1


def add_to(commands: Any) -> None:
    """Add this command and its options to the program's parser."""
    parser: Parser = commands.add_parser(
        "lab",
        help="run the lab twin in real time, behind UDP ports and a serial line",
        description="Run a simulated robot, force sensor and tracker in real time, each in its own process and with "
        "the protocol of a real device. Print their addresses and serve them until Ctrl-C.",
    )
    parser.add_argument(
        "simulation", metavar="SIMULATION.toml", nargs="?", default="steering",
        help="a simulation file (.toml), or the name of a shipped simulation, whose moves are not "
        "executed (default: steering)",
    )  # fmt: skip
    parser.add_argument(
        "--table", metavar="TABLE.h5",
        help="policy table of an insertion: place the needle at its start, and give it the planned curvature",
    )  # fmt: skip
    add_start(parser, in_space=True)
    add_output(parser, "REGISTRATION.toml", "write the registration that `insert` needs")
    parser.add_argument("--seed", type=whole, metavar="N", help="seed that replaces the seed of the simulation")
    parser.add_argument("--host", default="127.0.0.1", metavar="HOST", help="address to listen on (default: 127.0.0.1)")
    parser.add_argument(
        "--robot-port", type=whole, default=0, metavar="N", help="UDP port of the robot (default: a free one)"
    )
    parser.add_argument(
        "--robot-line", choices=("udp", "pty"), default="udp",
        help="connection of the robot: UDP, or the pseudo-terminal of a serial line (default: udp)",
    )  # fmt: skip
    parser.add_argument(
        "--force-port", type=whole, default=0, metavar="N", help="UDP port of the force sensor (default: a free one)"
    )
    parser.add_argument(
        "--http-port", type=whole, default=0, metavar="N", help="HTTP port of the force sensor (default: a free one)"
    )
    parser.add_argument(
        "--tracker-line",
        choices=("pty", "tcp"),
        default="pty",
        help="connection of the tracker: pseudo-terminal or TCP (default: pty)",
    )
    parser.add_argument(
        "--tracker-port", type=whole, default=0, metavar="N", help="TCP port of the tracker (default: a free one)"
    )
    parser.add_argument(
        "--longest-silence", type=float, default=0.34, metavar="S",
        help="longest time without a heartbeat that a controller may ask the robot to accept, s (default: 0.34)",
    )  # fmt: skip
    parser.add_argument(
        "--follow", metavar="ADDRESS",
        help="move the needle with the robot at this address (udp://, serial://); the printed address of the robot "
        "is a relay to it, which its controller must use",
    )  # fmt: skip
    parser.add_argument("--key-file", metavar="FILE", help="shared key that the robot requires, in hexadecimal digits")
    parser.add_argument("--duration", type=float, metavar="S", help="end after this time, s")
    add_answer(parser)
    parser.rename("--for", "--duration")
    parser.rename("--tracker", "--tracker-line")
    parser.rename("--registration", "--output")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command and return the exit code: 1 if all processes of the lab have ended by themselves, else 0."""
    from needleplan.devices.robot import RobotLimits, read_key
    from needleplan.devices.sensor_processes import LabPlaces, TrackerLine
    from needleplan.simulation import Simulation, tip_noise_remark
    from needleplan.simulation.lab_processes import RealTimeLab

    _require(options)
    require_outputs(options, [options.simulation, options.table], options.output)
    simulation = Simulation.read(options.simulation)
    seed = simulation.seed if options.seed is None else options.seed
    setup = _planned(simulation, options) if options.table else simulation.setup
    if options.table and (remark := tip_noise_remark(setup)):
        note(remark)
    if options.output:
        _registration(setup).write(options.output)
    places = LabPlaces(
        options.host, options.robot_port, options.force_port, options.http_port, TrackerLine(options.tracker_line),
        options.tracker_port, options.robot_line == "pty",
    )  # fmt: skip
    # A controller on a busy machine needs long deadlines as well as a long silence.
    longest_valid_s = max(RobotLimits.longest_valid_s, options.longest_silence)
    limits = RobotLimits(longest_silence_s=options.longest_silence, longest_valid_s=longest_valid_s)
    key = read_key(options.key_file) if options.key_file else None
    # The signals are caught before the first process starts, so no process is left behind.
    ending = threading.Event()
    with (
        contextlib.ExitStack() as stack,
        handled_signals(lambda _: ending.set()),
        _started(lambda: RealTimeLab(setup, seed, places, limits, key, _followed(options, stack))) as lab,
    ):
        _print(options, simulation, seed, lab)
        all_died = _serve(lab, ending, options.duration)
    robot = lab.served.get("robot")
    if robot is not None:
        note(
            f"served {robot.ticks:,} ticks, {robot.overruns:,} of them late, the worst by "
            f"{1e3 * robot.worst_overrun_s:.3g} ms"
        )
        if options.follow is not None and not robot.statuses:
            note(f"warning: {options.follow} has sent no status: the needle has followed no robot")
    return complain("all processes of the lab have ended") if all_died else 0


def _followed(options: argparse.Namespace, stack: contextlib.ExitStack) -> tuple[str, int] | None:
    """Return host and port of the robot at `--follow`, whose way `stack` closes; None without the option."""
    from needleplan.devices import Address, open_link
    from needleplan.devices.robot import open_way

    if options.follow is None:
        return None
    try:
        way = stack.enter_context(open_way(options.follow, ()))
    except DeviceFault as fault:
        raise InputError(Mistake("--follow", options.follow, str(fault))) from fault
    open_link(Address("udp", way.host, way.port)).close()  # raises AddressError for an unknown host
    return way.host, way.port


def _planned(simulation: Simulation, options: argparse.Namespace) -> Setup:
    """Return the setup of the simulation with the needle at the start of an insertion by the table of `--table`.

    The needle gets the curvature that the table was planned with. The start is the pose of `--start`, or the best
    entry.
    """
    from needleplan.cli.table_poses import poses_of
    from needleplan.planning import Table
    from needleplan.simulation import simulated_station

    require_table(options.table)
    table = Table.read(options.table)
    start = poses_of(table).start(options.start)
    with simulated_station(simulation, table, start) as station:
        return station.lab.plant.setup


def _registration(setup: Setup) -> Registration:
    """Return the registration of the lab: its tracker is in the frame of the plan, and 3D plans are in RAS."""
    from needleplan.anatomy import SpaceScenario
    from needleplan.estimation.registration import Registration, RegistrationVerdict, VerdictStatus

    known = RegistrationVerdict(VerdictStatus.ACCEPTED, accepted="lab twin: coil and frame are those of the simulation")
    found = Registration(coil_offset_mm=setup.effects.coil_offset_mm, title="lab twin", verdict=known)
    if not isinstance(setup.scenario, SpaceScenario):
        return found
    frame = setup.scenario.grid.frame
    return found.followed_by(frame.axes.T, frame.origin_mm)


def _started(start: Callable[[], RealTimeLab]) -> RealTimeLab:
    """Call `start` while SIGINT is blocked, and return the lab: its processes inherit the block and ignore Ctrl-C."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        return start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(lab: RealTimeLab, ending: threading.Event, duration_s: float | None) -> bool:
    """Wait until `ending` is set, the duration is over, or all processes have ended; report each ended process.

    Returns whether all processes have ended by themselves. `duration_s` None means no limit.
    """
    end_s = float("inf") if duration_s is None else time.monotonic() + duration_s
    while not ending.wait(_LOOK_S) and time.monotonic() < end_s:
        for name, how in lab.newly_ended().items():
            note(f"the process of the {name} has ended: {how}")
        if not lab.alive:
            return True
    return False


def _print(options: argparse.Namespace, simulation: Simulation, seed: int, lab: RealTimeLab) -> None:
    addresses = lab.addresses
    if options.json:
        print_json(
            {"robot": addresses.robot, "force": addresses.force, "tracker": addresses.tracker,
             "title": simulation.title, "digest": simulation.digest, "seed": seed, "processes": lab.pids}
        )  # fmt: skip
    else:
        lines = {"--robot": addresses.robot, "--force-sensor": addresses.force, "--tracker": addresses.tracker}
        print_summary(options, f"{simulation.title or options.simulation}, seed {seed}; Ctrl-C ends it", lines)
    sys.stdout.flush()


def _require(options: argparse.Namespace) -> None:
    from needleplan.config import SEED, Integer, Number, Rule
    from needleplan.devices.robot import RobotLimits

    mistakes = []
    if options.follow is not None and options.key_file:
        mistakes.append(
            Mistake("--key-file", options.key_file, "is that of the robot at --follow, and of its controller")
        )
    if options.follow is not None and options.longest_silence != RobotLimits.longest_silence_s:
        mistakes.append(
            Mistake("--longest-silence", f"{options.longest_silence:g}", "is that of the robot at --follow")
        )
    for option, value in (("--follow", options.follow), ("--robot-port", options.robot_port or None)):
        if value is not None and options.robot_line == "pty":
            mistakes.append(Mistake(option, f"{value}", "needs --robot-line udp"))
    if options.start is not None and not options.table:
        mistakes.append(Mistake("--start", options.start, "needs --table"))
    if options.tracker_port and options.tracker_line == "pty":
        mistakes.append(Mistake("--tracker-port", f"{options.tracker_port}", "needs --tracker-line tcp"))
    rules: dict[str, Rule] = {
        "--seed": SEED,
        **dict.fromkeys(_PORTS, Integer(0, 65_535)),
        "--longest-silence": Number("s", at_least=0.005, at_most=60),
        "--duration": Number("s", above=0, at_most=1e7),
    }
    require_rules(options, rules, *mistakes)
