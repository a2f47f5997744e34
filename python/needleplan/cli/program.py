"""Parse the command line, run the command and return the exit code.

Exit codes: 0 done; 1 the job ran and the answer is no; 2 the input is wrong; 3 a needle moves, or its rest is unknown,
after every other ending of a command that moves or stops one. As in shells, the exit code is 130 after
Ctrl-C, 143 after SIGTERM, 129 after SIGHUP, and 141 if the program that reads the output has ended.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from itertools import chain
from typing import TextIO, cast

from needleplan.artifacts.read_files import recorded_reads
from needleplan.cli.answer import AnswerStream, OutputFault, RemarkStream, set_quiet
from needleplan.cli.help_texts import COMMAND_GROUPS, EXAMPLES
from needleplan.cli.parser import Parser
from needleplan.errors import InputError
from needleplan.extras import explained

__all__ = ["make_parser", "run_command"]

# Exit codes: an input is wrong or the output cannot be written; the program that reads the output has ended.
_WRONG_INPUT, _NOBODY_READS = 2, 141

# Modules that declare commands of other names.
_MODULES = {
    "path": "table", "evaluate": "table", "entry": "table", "info": "table", "new": "scenarios", "resume": "pause",
    "check-realtime": "realtime",
}  # fmt: skip


def run_command(arguments: Sequence[str] | None = None) -> int:
    """Parse `arguments` (None: `sys.argv[1:]`), run the command, and return the exit code.

    If the command raises InputError or OSError, an optional library is not installed, or standard output cannot be
    written, prints the error and returns 2.
    Returns 141 if the program that reads standard output has ended. Raises SystemExit for `--help`, `--version` and
    wrong usage, and KeyboardInterrupt after Ctrl-C.
    """
    with contextlib.redirect_stderr(cast("TextIO", RemarkStream(sys.stderr))):
        options = _parser(sys.argv[1:2] if arguments is None else arguments[:1]).parse_args(arguments)
        set_quiet(getattr(options, "quiet", False))
        try:
            with recorded_reads(), contextlib.redirect_stdout(cast("TextIO", AnswerStream(sys.stdout))):
                code: int = options.run(options)
                sys.stdout.flush()
        except InputError as error:
            why = str(error)
        except ImportError as error:
            missing = explained(error)
            if missing is None:
                raise
            why = str(missing)
        except BrokenPipeError:
            _drop_output()
            return _NOBODY_READS
        except OutputFault as fault:
            _drop_output()
            why = f"standard output: cannot be written: {fault.strerror}"
        except OSError as error:
            why = f"{error.filename}: {error.strerror}" if error.filename else error.strerror or str(error)
        else:
            return code
        print(f"needleplan: {why}", file=sys.stderr)
        return _WRONG_INPUT


def make_parser() -> Parser:
    """Return the parser of the whole program, with all commands and all their arguments."""
    parser = _parser()
    parser.complete()
    return parser


def _parser(words: Sequence[str] = ()) -> Parser:
    """Return the parser of the program, whose commands declare some arguments when they parse.

    If the first word is a command, the parser has only the commands of its module, so that no other module is imported.
    """
    parser = Parser(
        prog="needleplan",
        description="Plan, execute and diagnose the steering of flexible bevel-tip needles. Not a medical device.",
        epilog="Exit codes: 0 done, 1 the job ran and the answer is no, 2 the input is wrong, 3 the needle moves, or "
        "its rest is unknown.",
    )
    parser.add_argument("-V", "--version", action=_Version, nargs=0, help="print the version and exit")
    parser.rename("atlas", "sweep")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    known = list(chain.from_iterable(COMMAND_GROUPS.values()))
    asked = [word for word in words[:1] if word in known] or known
    for module in dict.fromkeys(_MODULES.get(command, command.replace("-", "_")) for command in asked):
        import_module(f"needleplan.cli.{module}").add_to(commands)
    parser.command_groups = COMMAND_GROUPS
    _add_examples(parser, "")
    return parser


def _add_examples(parser: Parser, name: str) -> None:
    """Give the parser of the command `name`, and those of its commands, their examples."""
    parser.examples = EXAMPLES[name]
    for word, command in parser.commands().items():
        _add_examples(command, f"{name} {word}".strip())


class _Version(argparse.Action):
    """Action of `--version`: looks up the version, which takes time, prints it, and exits."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from needleplan.artifacts import version

        print(f"needleplan {version()}")
        parser.exit()


def _drop_output() -> None:
    """Redirect standard output to the null device, so that flushing it at the end of the process does not fail."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
