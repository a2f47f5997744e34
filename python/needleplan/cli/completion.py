"""`needleplan completion`: scripts that complete commands, options, files, and names of shipped files in a shell."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from needleplan.errors import InputError, Mistake

__all__ = ["SHELLS", "add_to", "completion"]

SHELLS = ("bash", "zsh", "fish")

_FOLDERS = ("DIR", "STORE")
_FILES = ("DATA", "FILE", "PATH", "RUN")  # metavars without a suffix that stand for files
# Kinds of arguments that take the name of a shipped file, too: command, argument, and the folder of the shipped files
_SHIPPED = {
    ("plan", "scenario"): "scenarios",
    ("view", "file"): "scenarios",
    ("new", "source"): "scenarios",
    ("simulate", "simulation"): "simulations",
    ("lab", "simulation"): "simulations",
    ("sweep", "sweep"): "sweeps",
}


def add_to(commands: Any) -> None:
    """Add this command and its options to the program's parser."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "completion",
        help="print a script that completes commands, options, files and names in a shell",
        description='Print a completion script. bash: `eval "$(needleplan completion bash)"` in ~/.bashrc; '
        "zsh: write it to a file `_needleplan` in a folder of $fpath; "
        "fish: write it to ~/.config/fish/completions/needleplan.fish.",
    )
    parser.add_argument("shell", choices=SHELLS, metavar="SHELL", help="bash, zsh or fish")
    parser.set_defaults(run=_run)


def completion(shell: str, parser: argparse.ArgumentParser) -> str:
    """Return the completion script of a shell. Raises InputError if the library shtab is missing."""
    try:
        import shtab
    except ModuleNotFoundError as error:
        raise InputError(Mistake("", "", "needs shtab: install it with `pip install shtab`")) from error
    _mark(parser, "", shtab.FILE, shtab.DIRECTORY)
    script: str = shtab.complete(parser, shell)
    return script


def _run(options: argparse.Namespace) -> int:
    from needleplan.cli.program import make_parser

    print(completion(options.shell, make_parser()))
    return 0


def _mark(parser: argparse.ArgumentParser, command: str, file: object, folder: object) -> None:
    """Mark the arguments of `parser` and its commands that are files, folders, or names of shipped files or chapters.

    A metavar such as FILE or DIR means a file or folder. `file` and `folder` are the markers of shtab; shtab then
    completes files or folders for these arguments.
    """
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, each in action.choices.items():
                _mark(each, name, file, folder)
        elif (command, action.dest) in _SHIPPED:
            action.complete = _shipped(_SHIPPED[command, action.dest])  # type: ignore[attr-defined]
        elif (command, action.dest) == ("reproduce", "chapters"):
            from needleplan.reports.chapters import chapters

            action.choices = list(chapters())
        elif isinstance(action.metavar, str):
            if action.metavar in _FOLDERS:
                action.complete = folder  # type: ignore[attr-defined]
            elif "." in action.metavar or action.metavar in _FILES:
                action.complete = file  # type: ignore[attr-defined]


def _shipped(kind: str) -> dict[str, object]:
    """Return the marker of shtab for files and for the names of the shipped files in a folder of the package."""
    import needleplan
    from needleplan.config import shipped_names

    function, names = f"_needleplan_{kind}", shipped_names(Path(needleplan.__file__).with_name(kind))
    words = " ".join(names)
    return {
        "bash": function,
        "zsh": function,
        "fish": f"({function})",
        "preamble": {
            "bash": f'{function}() {{\n  compgen -W "{words}" -- $1\n  compgen -f -- $1\n}}',
            "zsh": f"{function}() {{\n  _alternative '{kind}:{kind}:({words})' 'files:file:_files'\n}}",
            "fish": f"function {function}\n  printf '%s\\n' {words}\n  __fish_complete_path (commandline -ct)\nend",
        },
    }
