"""The text of a path that a caller gave, and of a path beside a folder."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from needleplan.errors import InputError, Mistake

__all__ = ["path_text", "relative_path"]

# Length of the text of a wrong value beyond which its class is named instead.
_LONGEST = 60


def path_text(path: Any, error: type[InputError], kind: str = "a file") -> str:
    """Return a path as text.

    Parameters
    ----------
    path : str or path
        The path, as a caller gave it.
    error : type
        Class of the error that is raised.
    kind : str, default "a file"
        What the path is of, in the message.

    Returns
    -------
    str

    Raises
    ------
    InputError
        `path` is empty, or neither a text nor a path. The class is `error`.

    Examples
    --------
    >>> from pathlib import Path
    >>> from needleplan.artifacts import path_text
    >>> from needleplan.errors import InputError
    >>> path_text(Path("table.h5"), InputError)
    'table.h5'
    """
    text = os.fspath(path) if isinstance(path, str | os.PathLike) else None
    if not isinstance(text, str) or not text:
        shown = repr(path)
        # The text of a table or an array has several lines.
        shown = f"<{type(path).__name__}>" if len(shown) > _LONGEST or "\n" in shown else shown
        raise error(Mistake("path", shown, f"must be the path of {kind}"))
    return text


def relative_path(file: str | os.PathLike[str], folder: str | os.PathLike[str]) -> str:
    """Return the path of a file relative to a folder, with slashes.

    Parameters
    ----------
    file : path
        The file.
    folder : path
        The folder.

    Returns
    -------
    str
        The relative path; the whole path if they are on different drives.
    """
    whole = Path(file).resolve()
    try:
        return Path(os.path.relpath(whole, Path(folder).resolve())).as_posix()
    except ValueError:
        return whole.as_posix()
