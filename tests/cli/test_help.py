"""The help: groups of commands and options, examples, defaults, the version, and hints to the step before."""

from __future__ import annotations

import argparse
import re
import shlex
from pathlib import Path

import pytest

from needleplan.cli.help_texts import COMMAND_GROUPS, EXAMPLES
from needleplan.cli.program import make_parser
from tests.anatomy.volumes import box, write
from tests.cli.commands import needleplan, refused
from tests.cli.test_habits import COMMANDS
from tests.conftest import SMALL

pytestmark = pytest.mark.usefixtures("few_executions")


def test_every_command_stands_in_one_group() -> None:
    named = [name for names in COMMAND_GROUPS.values() for name in names]
    assert sorted(named) == sorted(make_parser().commands())
    shown = needleplan("--help").stdout
    for title, names in COMMAND_GROUPS.items():
        section = shown.partition(f"\n{title}:\n")[2].partition("\n\n")[0]
        assert re.findall(r"^  ([\w-]+)", section, re.MULTILINE) == list(names)


@pytest.mark.parametrize("command", EXAMPLES)
def test_every_help_ends_with_two_examples_that_can_be_given(command: str) -> None:
    lines = EXAMPLES[command]
    assert len(set(lines)) == 2
    shown = needleplan(*command.split(), "--help").stdout
    assert shown.endswith("\nexamples:\n" + "".join(f"  {line}\n" for line in lines))
    for line in lines:
        words = shlex.split(line.partition(" > ")[0])
        assert words[: 1 + len(command.split())] == ["needleplan", *command.split()]
        make_parser().parse_args(words[1:])


def test_every_command_has_examples() -> None:
    assert set(COMMANDS) <= set(EXAMPLES)


def test_the_help_names_every_default() -> None:
    for command, parser in COMMANDS.items():
        for action in parser._actions:
            unset = action.default in (None, False, "", argparse.SUPPRESS) or action.default == []
            if action.option_strings and not unset and action.help != argparse.SUPPRESS:
                assert "default: " in str(action.help), (command, action.option_strings)


def test_the_options_of_insert_stand_in_groups() -> None:
    shown = needleplan("insert", "--help").stdout
    titles = re.findall(r"^(\w[^\n]*):$", shown, re.MULTILINE)
    assert titles == [
        "positional arguments", "options", "devices", "sensors besides the tracker", "plan", "uncertainty", "safety",
        "motion", "mechanics of the shaft", "outputs", "examples",
    ]  # fmt: skip
    assert all(shown.partition(f"\n{title}:\n")[2].partition("\n\n")[0].count("\n  -") < 10 for title in titles)


@pytest.mark.parametrize("option", ["-V", "--version"])
def test_the_version_is_printed_without_a_command(option: str) -> None:
    done = needleplan(option)
    assert (done.returncode, done.stderr) == (0, "")
    assert re.fullmatch(r"needleplan \d+\.\d+\.\d+\S*\n", done.stdout)


@pytest.mark.parametrize("command", ["path", "evaluate", "entry", "info", "insert"])
def test_a_scenario_in_place_of_a_table_gets_the_command_to_run_first(command: str) -> None:
    first = "needleplan plan four_obstacles -o four_obstacles.h5"
    refused(
        needleplan(command, "four_obstacles"), f"four_obstacles: is a scenario, and a policy table is needed: `{first}`"
    )


def test_the_lab_gives_it_too() -> None:
    refused(
        needleplan("lab", "--table", "brain", "--duration", "1"), "brain: is a scenario", "needleplan plan brain -o"
    )


def test_files_in_place_of_a_table_get_it_too(tmp_path: Path) -> None:
    (tmp_path / "my scene.toml").write_text(SMALL)
    refused(needleplan("path", "my scene.toml", cwd=tmp_path), "needleplan plan 'my scene.toml' -o 'my scene.h5'")
    anatomy = write(tmp_path, box())
    refused(needleplan("evaluate", anatomy), "is an anatomy, and a policy table is needed", f"plan {anatomy}")
