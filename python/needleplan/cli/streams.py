"""Standard output and standard error of the commands: foreign text is shown escaped, and faults are told apart.

Titles, names and messages come from files and devices of others. A terminal obeys escape sequences in them, which can
rewrite what stands on the screen. Every text that a command prints passes `printable` here, in one place.
"""

from __future__ import annotations

import contextlib
import re
import sys
from collections.abc import Iterator
from typing import Any, TextIO, cast

__all__ = ["AnswerStream", "OutputFault", "RemarkStream", "one_line", "printable", "terminal"]

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
