"""`needleplan insert`: insert a needle by a policy table.

The registration of `needleplan insert`: its verdict, and its error at the target beside the target's radius.
"""

from __future__ import annotations

import argparse
import math
import time
from contextlib import ExitStack
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from needleplan.cli.answer import complain, note
from needleplan.cli.estop import MOVES, EmergencyStop, alarm, require_estop
from needleplan.cli.insert_answer import answer_insertion, exit_code
from needleplan.cli.insert_options import add_insert_options
from needleplan.cli.insert_plan import InsertPlan, read_insert_plan, read_insert_table_set
from needleplan.cli.interrupt import handled_signals, needle_moves
from needleplan.cli.needle_sensors import opened_sensors, read_addressed_sensors
from needleplan.cli.options import (
    add_table,
    numbers,
    options_named,
    require_inputs_kept,
    require_outputs,
    require_rules,
    safety_limits,
)
from needleplan.cli.parser import Parser
from needleplan.cli.push import read_push
from needleplan.cli.realtime import require_prompt
from needleplan.errors import AddressError, DeviceFault, InputError, Mistake, OutputError

if TYPE_CHECKING:
    from needleplan.cli.insert_plan import InsertPlan
    from needleplan.control import BreathGate, InsertionReport, Replanner, RunRecorder, RunSetup
    from needleplan.control.safety import SafetyLimits
    from needleplan.devices import Station
    from needleplan.devices.robot import MotionLimits
    from needleplan.estimation.registration import Registration
    from needleplan.planning import Table
    from needleplan.sweep import CurvatureLookup

__all__ = ["add_to", "read_judged", "run"]


# Share of the target's radius above which the expected error at the target is remarked on.
_LARGE_SHARE = 0.5


def read_judged(file: str, plan: InsertPlan) -> Registration:
    """Return the registration of a file after comparing its expected error (TRE) with the radius of the target.

    Remarks name what a person accepted, an unknown TRE, and a TRE above half the radius. Raises DataError if the
    file cannot be read, or the registration has no verdict or was refused; InputError for a TRE above the radius.
    """
    from needleplan.estimation.registration import Registration, require_verdict

    found = Registration.read(file)
    verdict = require_verdict(found, file).verdict
    if verdict.accepted:
        note(f"warning: the registration was accepted: {verdict.accepted}")
        for reason in verdict.reasons:
            note(f"warning: against the registration: {reason}")
    error, radius = found.tre_mm(plan.target_in_registration_mm), plan.target_radius_mm
    if math.isnan(error):
        note("warning: the registration has no points, so its error at the target (TRE) is unknown")
    elif error > radius:
        rule = f"must be at most the radius of the target, {radius:.3g} mm: measure more points around the target"
        raise InputError(Mistake("expected error at the target (TRE)", f"{error:.3g} mm", rule), file)
    elif error > _LARGE_SHARE * radius:
        note(
            f"warning: the error at the target (TRE), {error:.3g} mm expected, exceeds half its radius, {radius:.3g} mm"
        )
    return found


_SIM, _ROBOTS, _RECORDING = "sim://", ("udp://", "serial://"), ".mcap"
_REFUSED = 2  # exit code: refused before anything moved, or a device failed


def add_to(commands: Any) -> None:
    """Add this command and its options to the program's parser."""
    parser: Parser = commands.add_parser(
        "insert",
        help="insert a needle by a policy table: the intraoperative loop",
        description="Insert a needle by a policy table, in the simulated lab or with real devices. Ctrl-C stops the "
        "needle at its place. Exit code 1: the target was not reached; 2: refused before anything moved; 3: the needle "
        "moves, or its rest is unknown.",
    )
    add_table(parser)
    add_insert_options(parser)
    parser.refuse_address("--force", "--force-sensor")
    parser.rename("--overwrite", "--force")
    parser.rename("--atlas", "--table-set")
    parser.rename("--rotation-speed", "--rotation-speed-deg, in degrees/s")
    parser.rename("--roll-left", "--roll-left-deg, in degrees")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command and return the exit code.

    0: target reached; 1: not reached, or the recording is incomplete; 2: refused, or a device failed; 3: the needle
    moves, or its rest is unknown; 130: stopped. Raises InputError (OutputError, AddressError and others) for wrong
    options and files.
    """
    from needleplan.simulation import (
        SimulatedStation,
        are_simulated,
        open_insertion_station,
        simulated_coil_mm,
        tip_noise_remark,
    )

    read = (options.table, options.registration, options.scenario, options.needle, options.limits)
    require_outputs(options, read, options.output, options.vtp)
    if options.output and not options.output.lower().endswith(_RECORDING):
        rule = f"must end in {_RECORDING}; `needleplan recording export` writes other formats"
        raise OutputError(Mistake("--output", options.output, rule))
    plan = read_insert_plan(options)
    stored = read_insert_table_set(options, plan.table)
    addresses = [getattr(options, name) for name in ("robot", "force_sensor", "tracker")]
    given = {address for address in addresses if address and address.startswith(_SIM)} or {_SIM}
    # A simulated lab has all three devices, so the address of one device is also used for devices without an address.
    robot, force, tracker = (address or min(given) for address in addresses)
    setup, hook = _setup(options, plan), require_estop(options.estop)
    for line in plan.warnings(options, safety_limits(options).force_n):
        note(f"warning: {line}")
    simulated = are_simulated(robot, force, tracker)
    for line in plan.make_promise(options, simulated_coil_mm(robot) if simulated else None):
        note(line)
    require_inputs_kept(options)
    fibre, plane = read_addressed_sensors(options, simulated=simulated)
    if not simulated and not options.registration:
        rule = "is missing: real devices require a registration; see `needleplan register`"
        raise AddressError(Mistake("--registration", "", rule))
    if not simulated and robot.startswith(_ROBOTS):
        require_prompt(robot)
    if simulated and options.deadman:
        rule = "needs real time: the simulated lab of sim:// has its own time; see `needleplan lab`"
        raise InputError(Mistake("--deadman", options.deadman, rule))
    if options.gate is not None and simulated is (options.exhaled_at is not None):
        rule = "is for real devices" if simulated else "is required: real devices do not tell when the patient exhales"
        raise InputError(Mistake("--exhaled-at", "", rule))
    motion = _motion_limits(safety_limits(options))
    report: InsertionReport | None = None
    with ExitStack() as signals:
        try:
            with (
                opened_sensors(options, fibre) as more,
                open_insertion_station(robot, force, tracker, plan.table, plan.start, motion) as station,
            ):
                if more:
                    station.more, station.fibre, station.plane = more, fibre, plane
                lab = station if isinstance(station, SimulatedStation) else None
                if lab and (remark := tip_noise_remark(lab.lab.plant.setup)):
                    note(remark)
                report, recorder = _insert(plan.table, station, setup(station), options, stored, hook, signals)
                true = (lab.true_tip_mm, lab.true_target_mm(plan.target_mm)) if lab else None
        except DeviceFault as fault:
            complain(str(fault))
            return MOVES if hook.alarms else _REFUSED
        finally:
            if hook.alarms if report is None else exit_code(report) == MOVES:
                needle_moves()
            hook.finish()
        file = recorder.file if recorder else None
        code = answer_insertion(plan, report, true, options, file)
        if recorder and recorder.missing:
            complain(f"{file or options.output}: the recording is incomplete: {recorder.missing}")
            return code or 1
        return code


def _motion_limits(limits: SafetyLimits) -> MotionLimits:
    """Return the limits of the run in the form in which the robot takes them for its session."""
    from needleplan.devices.robot import MotionLimits

    fastest_mm_s = max(limits.insertion_velocity_mm_s, limits.retraction_velocity_mm_s)
    return MotionLimits(
        limits.shallowest_mm, limits.deepest_mm, fastest_mm_s, limits.roll_rad, limits.rotation_velocity_rad_s
    )  # fmt: skip


def _insert(
    table: Table,
    station: Station,
    setup: RunSetup,
    options: argparse.Namespace,
    stored: CurvatureLookup | None,
    hook: EmergencyStop,
    signals: ExitStack,
) -> tuple[InsertionReport, RunRecorder | None]:
    """Run the insertion; return its report and the closed recorder, or None if nothing is recorded.

    From the begin of the run until `signals` is closed, signals only stop the needle: while the needle moves, no signal
    may end the program with an exit code of its own.
    """
    from needleplan.cli.insert_view import view
    from needleplan.control import DeadmanThread, Insertion, Listener, OrderPort, RunRecorder, open_deadman
    from needleplan.control.safety import Watchdog
    from needleplan.control.slicer import SlicerView
    from needleplan.devices.igtl import SlicerServer
    from needleplan.simulation import SimulatedStation

    recorder: RunRecorder | None = None
    with ExitStack() as stack:
        listeners: list[Listener] = []
        deadman = open_deadman(options.deadman) if options.deadman else None
        if options.output:
            recorder = stack.enter_context(
                RunRecorder(options.output, table, setup, station.clock, overwrite=options.overwrite)
            )
            listeners.append(recorder)
        if options.slicer:
            listeners.append(SlicerView(stack.enter_context(SlicerServer.open(options.slicer)), table))
        listeners.append(stack.enter_context(view(table, setup.options, options)))
        insertion = stack.enter_context(
            Insertion(
                table, station, setup.options, registration=setup.registration,
                tip_settings=setup.tip_settings, limits=setup.limits, listeners=listeners,
                replanner=_replanner(stored, table, station), needs_deadman=deadman is not None,
                accepted_limits=setup.accepted, on_alarm=lambda rest: alarm(rest, hook),
            )
        )  # fmt: skip
        if deadman is not None:
            guard = insertion.guard
            stack.enter_context(DeadmanThread(deadman, lambda held: guard.observe_deadman(held=held)))
            note("hold the deadman switch: the needle moves only while a person holds it")
        if not isinstance(station, SimulatedStation):
            stack.enter_context(Watchdog(insertion.guard))
            orders = stack.enter_context(OrderPort(insertion.guard, options.robot))
            if orders.obstacle:
                note(f"warning: `needleplan pause` cannot reach this run: {orders.obstacle}")
        signals.enter_context(handled_signals(insertion.stop))
        report = insertion.run()
    return report, recorder


def _replanner(stored: CurvatureLookup | None, table: Table, station: Station) -> Replanner | None:
    """Return the replanner with a table set, or None without a table set: the default of `Insertion`."""
    from needleplan.control import TableSetReplanner, ThreadReplanner
    from needleplan.devices import VirtualClock

    if stored is None:
        return None
    wait = isinstance(station.clock, VirtualClock)
    return TableSetReplanner(stored, table, ThreadReplanner(wait=wait), wait=wait, tell=note)


def _setup(options: argparse.Namespace, plan: InsertPlan) -> Any:
    """Check the options, and return a function that takes the opened devices and returns the setup of the run.

    For a simulated lab, the function takes tip noise and missing torsion, needle length and registration from the lab.
    The needle is expected at the start of `plan`. Raises InputError.
    """
    from needleplan.control import Options, RunSetup
    from needleplan.estimation.registration import Registration
    from needleplan.models import Torsion
    from needleplan.simulation import SimulatedStation

    registration = read_judged(options.registration, plan) if options.registration else None
    limits = safety_limits(options)
    torsion = Torsion(*numbers("--torsion", options.torsion, 2)) if options.torsion else None
    x, y, z = numbers("--force-axis", options.force_axis, 3)
    length = math.hypot(x, y, z)
    if not length:
        raise InputError(Mistake("--force-axis", options.force_axis, "must be a direction other than 0,0,0"))
    _require_numbers(options, limits)
    gate = _gate(options, plan)
    push = read_push(options.push) if options.push else None
    if push:
        beyond = push.tissue.beyond_mm(push.tip_n, push.shaft_n, push.length_mm)
        note(f"target: pushed ahead; a tip that meets its centre goes on by {beyond:.2f} mm")
    how = Options(
        velocity_mm_s=options.speed, velocity_rad_s=math.radians(options.rotation_speed_deg),
        entry_depth_mm=options.entry_depth, homed_by=options.homed_by,
        roll_left_rad=math.radians(options.roll_left_deg),
        longest_mm=limits.deepest_mm - options.entry_depth, torsion=torsion,
        stops=options.stops, replan=not options.no_replan, force_axis=(x / length, y / length, z / length),
        expected_start=plan.expected_start, push=push,
    )  # fmt: skip

    def made(station: Station) -> RunSetup:
        _note_slice(plan, station)
        lab = station if isinstance(station, SimulatedStation) else None
        length = options.needle_length or (lab.needle_length_mm if lab else how.needle_length_mm)
        since = lab.exhaled_s if lab else _clock_time(options.exhaled_at, station) if options.exhaled_at else 0.0
        timed = replace(gate, exhaled_s=since) if gate else None
        complete = replace(how, gate=timed, torsion=torsion or (lab.torsion if lab else None), needle_length_mm=length)
        placed = plan.placed(registration) if registration else lab.registration if lab else Registration()
        noise = max(lab.lab.plant.setup.heading_noise_rad_sqrt_mm) if lab else None
        settings = plan.tip_settings(noise)
        if lab:
            settings = replace(settings, image_latency_s=lab.lab.plant.setup.effects.ultrasound_delay_s)
        elif options.image_delay:
            settings = replace(settings, image_latency_s=options.image_delay)
        accepted = options.accept_limits or ""
        return RunSetup(complete, limits, placed, settings, accepted, station.fibre, station.plane)

    return made


def _note_slice(plan: InsertPlan, station: Station) -> None:
    """Print a warning if the planned path does not come into the slice of the ultrasound probe of a station."""
    if station.plane is None:
        return
    import numpy as np

    points = plan.table.path(plan.start).points_mm
    apart = station.plane.apart_mm(np.pad(points, ((0, 0), (0, 3 - points.shape[1]))))
    if apart:
        note(f"warning: no image will show the tip: the planned path stays {apart:.3g} mm beside the slice")


def _gate(options: argparse.Namespace, plan: InsertPlan) -> BreathGate | None:
    """Return the gate of the run, without its time, or None. Raises InputError."""
    from needleplan.control import BreathGate

    if options.gate is None:
        if options.exhaled_at is not None:
            raise InputError(Mistake("--exhaled-at", f"{options.exhaled_at:g}", "is for --gate"))
        return None
    breathing = getattr(getattr(plan.table.scenario, "file", None), "breathing", None)
    if breathing is None:
        raise InputError(Mistake("--gate", f"{options.gate:g}", "needs a 3D table of an anatomy with [breathing]"))
    if not 0 < options.gate <= breathing.full_mm:
        raise InputError(Mistake("--gate", f"{options.gate:g}", f"must be mm above 0, at most {breathing.full_mm:g}"))
    with options_named({"gate": "--gate"}):
        return BreathGate(breathing, options.gate)


def _clock_time(unix_s: float, station: Station) -> float:
    """Return the time (s) of the clock of a station at a Unix time."""
    return station.clock.now_ns() * 1e-9 - time.time() + unix_s


def _require_numbers(options: argparse.Namespace, limits: SafetyLimits) -> None:
    """Raise InputError for options that are not finite, not positive or outside of the limits of the run.

    Without this check, the guard or the loop would refuse them only after the devices are opened.
    """
    from needleplan.config import Number

    fastest_deg_s = math.degrees(limits.rotation_velocity_rad_s)
    deepest_mm = math.nextafter(limits.deepest_mm, -math.inf)
    require_rules(options, {
        "--speed": Number("mm/s, within the limits of the run,", above=0, at_most=limits.insertion_velocity_mm_s),
        "--rotation-speed-deg": Number("degrees/s, within the limits of the run,", above=0, at_most=fastest_deg_s),
        "--entry-depth": Number("mm, within the limits of the run,", at_least=limits.shallowest_mm, at_most=deepest_mm),
        "--roll-left-deg": Number("degrees"),
        "--needle-length": Number("mm", above=0),
    })  # fmt: skip
