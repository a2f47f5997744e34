"""Argument parser: help with examples, suggestions for misspelt words, refusal of old ones; whole numbers."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from decimal import Decimal, InvalidOperation
from itertools import zip_longest
from typing import Any, Never

__all__ = ["Parser", "whole"]

# A value that begins with a negative number, such as -10,20,-5, and is no option.
_NEGATIVE = re.compile(r"-(\d|\.\d)")
_MOST_DIGITS = 18  # largest number of digits of a whole number; such numbers fit into 64-bit integers


class Parser(argparse.ArgumentParser):
    """An argument parser that suggests the intended word for a misspelt command, option or choice.

    Without any argument, a parser that has commands prints its help on standard output and exits with code 2.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        """Make a parser as argparse does, without renamed words."""
        super().__init__(*args, **kwargs)
        self._negative_number_matcher = _NEGATIVE
        self._renamed: dict[str, str] = {}
        self._switches: dict[str, str] = {}
        self._deferred: list[Callable[[], None]] = []
        self.command_groups: Mapping[str, Sequence[str]] = {}
        """Names of the commands by title of their group in the help; empty: all in one group."""
        self.examples: Sequence[str] = ()
        """Command lines that the help shows at its end."""

    def rename(self, old: str, new: str) -> None:
        """Refuse an option or command named `old` with an error that names `new`. Help and suggestions omit `old`."""
        self._renamed[old] = new

    def refuse_address(self, switch: str, instead: str) -> None:
        """Refuse an address (`SCHEME://...`) after an option without a value; the error names the option `instead`."""
        self._switches[switch] = instead

    def defer(self, declare: Callable[[], None]) -> None:
        """Call `declare` when the parser parses: it declares arguments and imports what other commands do without."""
        self._deferred.append(declare)

    def complete(self) -> None:
        """Declare the deferred options of this parser and of all commands."""
        self._declare()
        for command in self.commands().values():
            command.complete()

    def _declare(self) -> None:
        while self._deferred:
            self._deferred.pop(0)()

    def commands(self) -> dict[str, Parser]:
        """Return the parsers of the commands by name; empty if there are none."""
        found = (action.choices for action in self._actions if isinstance(action, argparse._SubParsersAction))
        return dict(next(found, {}))

    def format_help(self) -> str:
        """Return the help: usage, description, arguments in groups, exit codes, examples."""
        formatter = self._get_formatter()
        formatter.add_usage(self.usage, self._actions, self._mutually_exclusive_groups)
        formatter.add_text(self.description)
        for group in self._action_groups:
            for title, actions in self._sections(group):
                formatter.start_section(title)
                formatter.add_text(group.description)
                formatter.add_arguments(actions)
                formatter.end_section()
        formatter.add_text(self.epilog)
        shown = "".join(f"  {line}\n" for line in self.examples)
        return formatter.format_help() + (f"\nexamples:\n{shown}" if shown else "")

    def _sections(self, group: Any) -> Iterator[tuple[str | None, list[argparse.Action]]]:
        """Yield title and arguments of a section of the help; the commands have a section for each of their groups."""
        subparsers = [
            group_action
            for group_action in group._group_actions
            if isinstance(group_action, argparse._SubParsersAction)
        ]
        if not (subparsers and self.command_groups):
            yield group.title, group._group_actions
            return
        lines = {line.dest: line for line in subparsers[0]._choices_actions}
        for title, names in self.command_groups.items():
            yield title, [lines[name] for name in names]

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse arguments. Exit with code 2 if an option is unknown, or if commands exist and no argument is given."""
        self._declare()
        given = sys.argv[1:] if args is None else list(args)
        if self.commands() and not given:
            self.print_help()
            self.exit(2)
        self._require_known(given)
        return super().parse_known_args(given, namespace)

    def error(self, message: str) -> Never:
        """Print the usage and the message, and exit with code 2."""
        self.print_usage(sys.stderr)
        self.exit(2, f"{self.prog}: {message}\n")

    def _require_known(self, given: Sequence[str]) -> None:
        """Exit with an error if an option is unknown or renamed, or an address follows an option without a value.

        Called before argparse parses, because argparse would report missing arguments first.
        """
        for word, after in zip_longest(given, given[1:], fillvalue=""):
            if word == "--" or (not word.startswith("-") and self.commands()):
                return
            name, _, value = word.partition("=")
            if not word.startswith("--") or " " in name:
                continue
            if name in self._renamed:
                self.error(f"{name} is now {self._renamed[name]}")
            if name in self._switches and "://" in (address := value or after):
                self.error(f"{name} takes no address: write {self._switches[name]} {address}")
            if not any(known.startswith(name) for known in self._option_string_actions):
                from needleplan.config import suggestion

                self.error(f"unknown option {name}{suggestion(name, self._shown_options())}")

    def _shown_options(self) -> Iterable[str]:
        for name, action in self._option_string_actions.items():
            if name.startswith("--") and action.help != argparse.SUPPRESS:
                yield name

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is None or value in action.choices:
            return
        from needleplan.config import suggestion

        words = [str(choice) for choice in action.choices]
        if isinstance(action, argparse._SubParsersAction):
            if value in self._renamed:
                self.error(f"{value} is now {self._renamed[value]}: `{self.prog} {self._renamed[value]} --help`")
            rule = f'there is no command "{value}"{suggestion(str(value), words)}'
            self.error(f"{rule} (`{self.prog} --help` lists the commands, `{self.prog} COMMAND --help` explains one)")
        rule = f'must be one of {", ".join(words)}, not "{value}"{suggestion(str(value), words)}'
        raise argparse.ArgumentError(action, rule)


def whole(text: str) -> int:
    """Return the whole number that a text such as `500` or `1e4` represents.

    Raises ArgumentTypeError if the text is not a whole number of at most 18 digits.
    """
    try:
        number = Decimal(text)
    except InvalidOperation:
        number = Decimal("nan")
    if not number.is_finite() or number.adjusted() >= _MOST_DIGITS or number != int(number):
        rule = f"must be a whole number such as 500 or 1e4, of at most {_MOST_DIGITS} digits"
        raise argparse.ArgumentTypeError(f'{rule}, not "{text}"')
    return int(number)
