"""Options of `needleplan insert`, in the groups of its help."""

from __future__ import annotations

import argparse
import math

from needleplan.cli.estop import add_estop
from needleplan.cli.needle_sensors import add_needle_sensors
from needleplan.cli.options import add_answer, add_figure, add_limits, add_output, add_start
from needleplan.cli.parser import Parser
from needleplan.cli.push import PUSH_FORM, PUSH_HELP
from needleplan.cli.uncertainty import add_uncertainty

__all__ = ["add_insert_options"]

_ROTATION_DEG_S = math.degrees(3.0)  # default speed of the needle's rotation


def add_insert_options(parser: Parser) -> None:
    """Declare the options, apart from those that all commands with a policy table have."""
    _add_devices(parser.add_argument_group("devices"))
    _add_sensors(parser.add_argument_group("sensors besides the tracker"))
    _add_plan(parser.add_argument_group("plan"))
    add_uncertainty(parser, registration=False)
    _add_safety(parser.add_argument_group("safety"))
    _add_motion(parser.add_argument_group("motion"))
    _add_mechanics(parser.add_argument_group("mechanics of the shaft"))
    outputs = parser.add_argument_group("outputs")
    add_output(outputs, "RUN.mcap", "write a recording of the run")
    outputs.add_argument(
        "--vtp", metavar="FILE.vtp", help="write both paths of an insertion by a 3D table for VTK, in RAS"
    )
    add_figure(outputs, "the planned and the executed path, deviations and force")
    outputs.add_argument(
        "--slicer", metavar="URL", help="show the run to 3D Slicer, which connects to igtl://host[:18944]"
    )
    add_answer(outputs)


def _add_devices(group: argparse._ArgumentGroup) -> None:
    for name, noun, schemes in (
        ("robot", "robot", "udp://, serial:// or canopen://"),
        ("force-sensor", "force sensor", "udp://"),
        ("tracker", "tracker", "serial://, tcp:// or igtl://"),
    ):
        group.add_argument(
            f"--{name}", metavar="URL",
            help=f"address of the {noun}: {schemes}, or sim://[SIMULATION][?seed=N] for all three (default: sim://)",
        )  # fmt: skip
    group.add_argument(
        "--registration", metavar="FILE", help="registration of coil and tracker; required except for sim://"
    )
    group.add_argument(
        "--force-axis", metavar="X,Y,Z", default="0,0,1",
        help="direction of the axial force in the sensor's frame (default: 0,0,1)",
    )  # fmt: skip
    group.add_argument(
        "--homed-by", metavar="NAME", default="",
        help="person who has homed the robot for this run; needed after the robot has lost its zero",
    )  # fmt: skip
    group.add_argument(
        "--entry-depth", type=float, metavar="MM", default=0.0, help="depth of the stage at the entry (default: 0)"
    )
    group.add_argument(
        "--roll-left-deg", type=float, metavar="DEG", default=0.0,
        help="roll of the stage, in degrees, at which the needle bends left (default: 0)",
    )  # fmt: skip


def _add_sensors(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--fibre", metavar="URL", help="curvatures along the needle as NDARRAY: igtl://host/NAME, with --sensors"
    )
    group.add_argument("--images", metavar="URL", help="tip in images as POINT: igtl://host/NAME, with --image-plane")
    add_needle_sensors(group, "plan")


def _add_plan(group: argparse._ArgumentGroup) -> None:
    add_start(group, in_space=True)
    group.add_argument(
        "--scenario", metavar="SCENARIO.toml", help="scenario of the plan: refuse a table of another one"
    )
    group.add_argument(
        "--needle", metavar="MODEL.toml",
        help="model of the needle: refuse a table for another radius; its entry scatter widens the start of the tip "
        "filter",
    )  # fmt: skip
    group.add_argument(
        "--no-replan", action="store_true", help="keep the table even if the curvature differs from the plan"
    )
    group.add_argument(
        "--table-set", metavar="STORE",
        help="table set to follow when planning again: its nearest table, until the new one is computed",
    )  # fmt: skip


def _add_safety(group: argparse._ArgumentGroup) -> None:
    add_limits(group)
    group.add_argument(
        "--deadman", metavar="SWITCH",
        help="move only while a person holds a switch: key, udp://HOST:PORT?key_file=FILE or evdev:///dev/input/eventN",
    )  # fmt: skip
    add_estop(group)


def _add_motion(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--speed", type=float, metavar="MM_S", default=5.0, help="speed of insertion, mm/s (default: 5)")
    group.add_argument(
        "--rotation-speed-deg", type=float, metavar="DEG_S", default=_ROTATION_DEG_S,
        help="speed of rotation, degrees/s (default: 172)",
    )  # fmt: skip
    group.add_argument(
        "--gate", type=float, metavar="MM",
        help="advance only while breathing leaves the tissue within MM of its place in the plan, in 3D",
    )  # fmt: skip
    group.add_argument(
        "--exhaled-at", type=float, metavar="UNIX_S",
        help="Unix time at the end of an exhalation, for --gate with real devices, as of a ventilator",
    )  # fmt: skip
    group.add_argument("--stops", action="store_true", help="stop after every step, not only before a rotation")


def _add_mechanics(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--torsion", metavar="GJ,TAU",
        help="compensate the torsional lag of the tip: rigidity in N mm^2 and friction in N mm/mm",
    )  # fmt: skip
    group.add_argument(
        "--push",
        metavar=PUSH_FORM,
        help=f"push of the needle, by which the tip goes on behind the target: {PUSH_HELP}",
    )
    group.add_argument(
        "--needle-length", type=float, metavar="MM", help="length of the shaft, mm, for the torsion (default: 200)"
    )
    group.add_argument(
        "--buckling", metavar="EI,FREE",
        help="warn if the shaft can buckle: bending stiffness in N mm^2 and unsupported length at the entry in mm",
    )  # fmt: skip
    group.add_argument(
        "--force-model", metavar="MODEL.toml", help="compare the force of this model with the buckling load"
    )
