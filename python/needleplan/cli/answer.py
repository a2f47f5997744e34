"""Output of the commands: the answer on standard output; progress, remarks and errors on standard error.

Standard output and standard error of the commands: foreign text is shown escaped, and faults are told apart.

Titles, names and messages come from files and devices of others. A terminal obeys escape sequences in them, which can
rewrite what stands on the screen. Every text that a command prints passes `printable` here, in one place.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import re
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TextIO, cast

from needleplan.cli.interrupt import end_if_interrupted

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

__all__ = [
    "SUMMARY_LINES",
    "AnswerStream",
    "OutputFault",
    "RemarkStream",
    "Working",
    "by_table",
    "complain",
    "note",
    "one_line",
    "percent",
    "print_first",
    "print_json",
    "print_summary",
    "printable",
    "set_quiet",
    "terminal",
    "working",
]


# Control characters except newline and tab, and characters that change the direction or the lines of a text.
_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069]")


def printable(text: str) -> str:
    r"""Return `text` with control characters escaped, such as `\x1b`; newlines and tabs are kept.

    Examples
    --------
    >>> print(printable("liver\x1b[31m"))
    liver\x1b[31m
    """
    return _CONTROL.sub(_escaped, text)


def one_line(text: str) -> str:
    r"""Return `text` with control characters escaped, newlines and tabs too, for text that stands in a line.

    Examples
    --------
    >>> print(one_line("liver\nsuccess 100 %"))
    liver\nsuccess 100 %
    """
    return printable(text.replace("\n", "\\n").replace("\t", "\\t"))


def _escaped(found: re.Match[str]) -> str:
    return found.group().encode("unicode_escape").decode()


class OutputFault(OSError):
    """Standard output cannot be written."""


class AnswerStream:
    """Passes text on to `stream`, escaped by `printable`, with characters that the encoding lacks escaped too.

    Raises OutputFault if the stream cannot be written, BrokenPipeError if nobody reads it.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write a text."""
        encoding = self._stream.encoding or "utf-8"
        with self._faults():
            self._stream.write(self._shown(text).encode(encoding, "backslashreplace").decode(encoding))
        return len(text)

    def flush(self) -> None:
        """Flush the stream."""
        with self._faults():
            self._stream.flush()

    def _shown(self, text: str) -> str:
        return printable(text)

    @contextlib.contextmanager
    def _faults(self) -> Iterator[None]:
        try:
            yield
        except BrokenPipeError:
            raise
        except OSError as error:
            raise OutputFault(error.errno, error.strerror) from error


class RemarkStream(AnswerStream):
    """As `AnswerStream`, but ignores faults: a run must not end because its terminal was closed.

    With `escape` false, escape sequences pass, as rich needs them; the caller escapes foreign text.
    """

    def __init__(self, stream: TextIO, *, escape: bool = True) -> None:
        super().__init__(stream)
        self._escape = escape

    def without_escaping(self) -> RemarkStream:
        """Return the same stream, through which escape sequences pass."""
        return RemarkStream(self._stream, escape=False)

    def _shown(self, text: str) -> str:
        return printable(text) if self._escape else text

    @contextlib.contextmanager
    def _faults(self) -> Iterator[None]:
        with contextlib.suppress(OSError):
            yield


def terminal() -> TextIO:
    """Return standard error for rich, which writes escape sequences; foreign text must pass `printable` before."""
    stream = sys.stderr
    return cast("TextIO", stream.without_escaping()) if isinstance(stream, RemarkStream) else stream


SUMMARY_LINES = 5
"""Largest number of lines, including the title, that `print_first` prints without `--verbose`."""

_DELAY_S = 1.0  # time after which a command begins to show its progress

_quiet = False
_shown: Working | None = None


def set_quiet(quiet: bool) -> None:
    """Switch the output of `note` and `working` off if `quiet`, else on."""
    global _quiet
    _quiet = quiet


def note(text: str) -> None:
    """Print a remark on standard error, unless `set_quiet` has switched remarks off."""
    if _quiet:
        return
    if _shown is None or not _shown.say(text):
        print(text, file=sys.stderr)


def complain(text: str) -> int:
    """Print `text`, the reason why the answer is no, on standard error, and return the exit code 1."""
    print(f"needleplan: {text}", file=sys.stderr)
    return 1


def print_json(record: Mapping[str, object] | Sequence[object]) -> None:
    """Print a record or a list as JSON, with one entry on each line. NaN and infinity become null."""
    plain = _plain(record)
    if isinstance(plain, dict):
        entries, brackets = [f"{json.dumps(key)}: {json.dumps(value)}" for key, value in plain.items()], "{}"
    else:
        entries, brackets = [json.dumps(entry) for entry in plain], "[]"
    print(brackets[0], ",\n".join(f"  {entry}" for entry in entries), brackets[1], sep="\n")


def print_summary(
    options: argparse.Namespace, title: str, lines: Mapping[str, str], more: Mapping[str, str] | None = None
) -> None:
    """Print a title and the lines of `lines`, each with its name; with `--verbose` also the lines of `more`."""
    print(one_line(title))
    for name, text in {**lines, **(more or {} if options.verbose else {})}.items():
        print(f"  {one_line(name):<12} {one_line(text)}")


def print_first(options: argparse.Namespace, lines: Sequence[str]) -> None:
    """Print all lines with `--verbose`, otherwise at most `SUMMARY_LINES` lines.

    If lines are omitted, the last printed line states their number.
    """
    if not options.verbose and len(lines) > SUMMARY_LINES:
        left = len(lines) - SUMMARY_LINES + 1
        lines = [*lines[: SUMMARY_LINES - 1], f"  ... {left} more lines with --verbose"]
    for line in lines:
        print(one_line(line))


def percent(probability: float) -> str:
    """Return the text of a probability as a percentage, such as `94.3 %`."""
    return f"{100 * probability:.1f} %"


def by_table(probability: float) -> str:
    """Return the text of a success probability that a policy table says, such as `94.3 % by the table`."""
    return f"{percent(probability)} by the table"


class Working:
    """Display of a command's progress on a terminal: it appears after one second, and `close` removes it."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._fraction: float | None = None
        self._lock = threading.Lock()
        self._closed = False
        self._display: Progress | None = None
        self._task: TaskID | None = None
        self._timer = threading.Timer(_DELAY_S, self._show)
        self._timer.daemon = True
        self._timer.start()

    def __call__(self, text: str, fraction: float | None = None) -> None:
        """Change the shown description of the present work and its finished fraction, 0 to 1 (None: unknown)."""
        end_if_interrupted()
        with self._lock:
            self._text, self._fraction = text, fraction
            self._update()

    def say(self, text: str) -> bool:
        """Print a line above the progress and return True. Without a shown progress, print nothing and return False."""
        with self._lock:
            if self._display is None:
                return False
            self._display.console.print(printable(text), markup=False, highlight=False, soft_wrap=True)
            return True

    def close(self) -> None:
        """Remove the progress from the terminal."""
        self._timer.cancel()
        with self._lock:
            self._closed = True
            if self._display:
                self._display.stop()
                self._display = None

    def _show(self) -> None:
        from rich.console import Console

        from needleplan.extras.progress_bar import terminal_display

        with self._lock:
            if self._closed:
                return
            self._display = terminal_display(Console(file=terminal()))
            self._task = self._display.add_task("", total=None)
            self._update()
            self._display.start()

    def _update(self) -> None:
        if self._display and self._task is not None:
            total = None if self._fraction is None else 1.0
            self._display.update(
                self._task, description=printable(self._text), total=total, completed=self._fraction or 0.0
            )


@contextmanager
def working(options: argparse.Namespace, text: str) -> Iterator[Callable[..., None]]:
    """Yield a function that shows progress: a `Working` that begins with `text`.

    With `--quiet` or `--json`, or if standard error is not a terminal, the function shows nothing.
    """
    global _shown
    if _quiet or getattr(options, "json", False) or not sys.stderr.isatty():
        yield end_if_interrupted
        return
    _shown = Working(text)
    try:
        yield _shown
    finally:
        _shown.close()
        _shown = None


def _plain(value: object) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    return value
