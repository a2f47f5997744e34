"""An option means the same in all commands: the same value, and the same kind of help."""

import argparse
import re
from collections import defaultdict

import pytest

from tests.cli.test_habits import COMMANDS

# `--output` names the form of its file, which differs by command: TABLE.h5, RUN.mcap, DIR.
FORMS = {"-o", "--output"}


def uses() -> dict[str, dict[str, argparse.Action]]:
    """Return the shown uses of each option, by option and command."""
    found: dict[str, dict[str, argparse.Action]] = defaultdict(dict)
    for command, parser in COMMANDS.items():
        for option, action in parser._option_string_actions.items():
            if action.help != argparse.SUPPRESS:
                found[option][command] = action
    return {option: by_command for option, by_command in found.items() if len(by_command) > 1}


USES = uses()


@pytest.mark.parametrize("option", USES)
def test_an_option_has_the_same_value_everywhere(option: str) -> None:
    actions = USES[option].values()
    assert len({type(each) for each in actions}) == 1
    assert len({each.type for each in actions}) == 1
    assert len({each.nargs for each in actions}) == 1
    assert len({each.choices and tuple(each.choices) for each in actions}) == 1
    assert option in FORMS or len({each.metavar for each in actions}) == 1


@pytest.mark.parametrize("option", USES)
def test_the_help_of_an_option_begins_with_the_same_word_everywhere(option: str) -> None:
    """The word is the noun that the value is, or the verb that the option does: `policy`, `write`, `draw`."""
    words = {command: re.split(r"\W", str(action.help))[0] for command, action in USES[option].items()}
    assert len(set(words.values())) == 1, words


def test_an_address_or_a_device_is_no_switch_elsewhere() -> None:
    for option in ("--force-sensor", "--robot", "--tracker"):
        for command, parser in COMMANDS.items():
            action = parser._option_string_actions.get(option)
            assert action is None or action.metavar == "URL", command
