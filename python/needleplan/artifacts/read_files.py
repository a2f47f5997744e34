"""Files that a command has read. A command never overwrites them, also if only another file names them.

Python reports every file that it opens to audit hooks, so no reader can be forgotten. Files that a compiled library
opens itself are not reported; needleplan hands the bytes of files to such libraries.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from needleplan.errors import Mistake, OutputError

__all__ = ["may_replace", "recorded_reads", "require_unread", "was_read"]

# Paths that were opened for reading, as they were given; None while nothing is recorded.
_opened: set[str] | None = None
_is_hooked = False


@contextlib.contextmanager
def recorded_reads() -> Iterator[None]:
    """Record in the context which files this process opens for reading; earlier records are forgotten."""
    global _opened, _is_hooked
    if not _is_hooked:
        sys.addaudithook(_note)
        _is_hooked = True
    _opened = set()
    try:
        yield
    finally:
        _opened = None


def was_read(path: str | os.PathLike[str]) -> bool:
    """Return whether `path` is an existing regular file that was opened for reading in `recorded_reads`."""
    return Path(path).is_file() and bool(_names_of(path))


def require_unread(paths: Iterable[str | os.PathLike[str] | None]) -> None:
    """Raise OutputError if one of the paths is a file that was read; None is ignored.

    Call this when all inputs are read and before a long computation. `move_into_place` is the last guard.
    """
    for path in paths:
        if path and was_read(path):
            raise OutputError(
                Mistake("", "", "cannot be written: it would replace a file that this command has read"),
                os.fspath(path),
            )


def may_replace(path: str | os.PathLike[str]) -> None:
    """Permit that `path` is replaced, although it was read.

    For a file that the command is to change, or whose kind it has looked at before it overwrites the file.
    """
    if _opened:
        _opened.difference_update(_names_of(path))


def _names_of(path: str | os.PathLike[str]) -> list[str]:
    """Return the recorded paths of a file. Most records are modules: names are compared before paths are resolved."""
    place = os.path.realpath(path)
    name = os.path.basename(place)  # noqa: PTH119  thousands of records
    return [
        each for each in list(_opened or ())
        if (os.path.basename(each) == name or os.path.islink(each)) and os.path.realpath(each) == place  # noqa: PTH114, PTH119
    ]  # fmt: skip


def _note(event: str, arguments: tuple[Any, ...]) -> None:
    if _opened is None or event != "open":
        return
    path, _, flags = arguments
    if isinstance(path, str | bytes | os.PathLike) and isinstance(flags, int) and not flags & (os.O_WRONLY | os.O_RDWR):
        _opened.add(os.fsdecode(path))
