"""The default of an option is that of the class that it configures, and its help says this number."""

import inspect
import math
import re
from collections.abc import Callable
from typing import Any

import pytest

from needleplan.anatomy import CaseChoices
from needleplan.control import Options
from needleplan.devices.robot import RobotLimits
from needleplan.planning import PolicyTable
from needleplan.sweep import Engine
from tests.cli.test_habits import COMMANDS


def parameter(function: Callable[..., Any], name: str) -> Any:
    """Return the default of a parameter."""
    return inspect.signature(function).parameters[name].default


# By command and option: the default of the class or function, in the unit of the option.
DEFAULTS = {
    ("insert", "--speed"): Options.velocity_mm_s,
    ("insert", "--rotation-speed-deg"): math.degrees(Options.velocity_rad_s),
    ("insert", "--entry-depth"): Options.entry_depth_mm,
    ("insert", "--roll-left-deg"): math.degrees(Options.roll_left_rad),
    ("insert", "--needle-length"): Options.needle_length_mm,
    ("insert", "--stops"): Options.stops,
    ("insert", "--no-replan"): not Options.replan,
    ("diagnose", "--speed"): Options.velocity_mm_s,
    ("lab", "--longest-silence"): RobotLimits.longest_silence_s,
    ("case", "--entry-radius"): CaseChoices.entry_radius_mm,
    ("sweep", "--wait"): Engine.wait_s,
    ("evaluate", "--runs"): parameter(PolicyTable.rollout, "runs"),
    ("evaluate", "--seed"): parameter(PolicyTable.rollout, "seed"),
}


@pytest.mark.parametrize(("command", "option"), DEFAULTS)
def test_it_is_that_of_the_class(command: str, option: str) -> None:
    action, wanted = COMMANDS[command]._option_string_actions[option], DEFAULTS[command, option]
    shown = re.search(r"\(default: ([\d.]+)\)", str(action.help))
    if action.default is not None:  # None: the class decides
        assert action.default == pytest.approx(wanted)
    assert isinstance(wanted, bool) or (shown is not None and float(shown[1]) == pytest.approx(wanted, rel=0.01))
