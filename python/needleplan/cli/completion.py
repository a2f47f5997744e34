"""`needleplan completion`: scripts that complete commands, options and files in a shell."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

from needleplan.errors import InputError, Mistake

__all__ = ["SHELLS", "add_to", "completion"]

SHELLS = ("bash", "zsh", "fish")

_FOLDERS = ("DIR", "STORE")
_FILES = ("DATA", "FILE", "PATH", "RUN", "SCENARIO")  # metavars without a suffix that stand for files


def add_to(commands: Any, make_parser: Callable[[], argparse.ArgumentParser]) -> None:
    """Add this command to the program's parser. `make_parser` returns the parser of the whole program."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "completion",
        help="print a script that completes commands, options and files in a shell",
        description='Print a completion script. bash: `eval "$(needleplan completion bash)"` in ~/.bashrc; '
        "zsh: write it to a file `_needleplan` in a folder of $fpath; "
        "fish: write it to ~/.config/fish/completions/needleplan.fish.",
    )
    parser.add_argument("shell", choices=SHELLS, metavar="SHELL", help="bash, zsh or fish")
    parser.set_defaults(run=lambda options: _run(options, make_parser()))


def completion(shell: str, parser: argparse.ArgumentParser) -> str:
    """Return the completion script of a shell. Raises InputError if the library shtab is missing."""
    try:
        import shtab
    except ModuleNotFoundError as error:
        raise InputError(Mistake("", "", "needs shtab: install it with `pip install shtab`")) from error
    _mark_files(parser, shtab.FILE, shtab.DIRECTORY)
    script: str = shtab.complete(parser, shell)
    return script


def _run(options: argparse.Namespace, parser: argparse.ArgumentParser) -> int:
    print(completion(options.shell, parser))
    return 0


def _mark_files(parser: argparse.ArgumentParser, file: object, folder: object) -> None:
    """Mark the arguments of `parser` and its commands whose metavar, such as FILE or DIR, means a file or folder.

    `file` and `folder` are the markers of shtab; shtab then completes files or folders for these arguments.
    """
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for each in action.choices.values():
                _mark_files(each, file, folder)
        elif isinstance(action.metavar, str):
            if action.metavar in _FOLDERS:
                action.complete = folder  # type: ignore[attr-defined]
            elif "." in action.metavar or action.metavar in _FILES:
                action.complete = file  # type: ignore[attr-defined]
