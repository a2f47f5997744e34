"""Kind and format of a file, told by its first bytes: the one place that knows the formats of all files.

A format is written `needleplan.NAME/VERSION`. TOML and JSON files hold it in their key `schema`, a policy table begins
with it, and the first line of the list of a table set holds it. Recordings and data files have formats of other
programs.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from needleplan.errors import InputError, Mistake

__all__ = [
    "FORMATS",
    "FileFormat",
    "FileKind",
    "file_format",
    "other_kind",
    "path_text",
    "present_format",
    "relative_path",
    "version_advice",
]


class FileKind(StrEnum):
    """Kind of a file or folder that needleplan writes or reads."""

    SCENARIO = "scenario"
    ANATOMY = "anatomy"
    TABLE = "policy table"
    TABLE_SET = "table set"
    SWEEP = "sweep"
    RECORDING = "recording"
    DATA = "data file"
    MODEL = "model"
    FORCE_LIBRARY = "force library"
    DIAGNOSIS = "diagnosis"
    REGISTRATION = "registration"
    SIMULATION = "simulation"
    DRIVES = "setup of drives"


FORMATS = {
    FileKind.SCENARIO: "needleplan.scenario/1",
    FileKind.ANATOMY: "needleplan.anatomy/1",
    FileKind.TABLE: "needleplan.table/1",
    FileKind.TABLE_SET: "needleplan.tables/1",
    FileKind.SWEEP: "needleplan.sweep/1",
    FileKind.MODEL: "needleplan.model/1",
    FileKind.FORCE_LIBRARY: "needleplan.force-library/1",
    FileKind.DIAGNOSIS: "needleplan.diagnosis/2",
    FileKind.REGISTRATION: "needleplan.registration/1",
    FileKind.SIMULATION: "needleplan.simulation/1",
    FileKind.DRIVES: "needleplan.drives/1",
}
"""Format of each kind that this version of needleplan writes and reads; the other kinds have none of needleplan."""

# What makes a file of an earlier version anew, for formats that have or had one.
_RENEWALS = {
    FileKind.TABLE: "plan its scenario or anatomy again with `needleplan plan`",
    FileKind.TABLE_SET: "make the sweep again with `needleplan sweep`",
    FileKind.DIAGNOSIS: "diagnose the recordings again with `needleplan diagnose`",
}
_NAMES = {text.partition("/")[0]: kind for kind, text in FORMATS.items()}

# Former formats that are not read any more, by kind.
_ENDED = {"needleplan.space-table/1": FileKind.TABLE}

# Former formats that are still read, with the present name of the same format.
_FORMER = {
    "needleplan.atlas/1": FORMATS[FileKind.FORCE_LIBRARY],
    "needleplan.experiment/1": FORMATS[FileKind.SIMULATION],
    "needleplan.space-table/2": FORMATS[FileKind.TABLE],
}

# Files that stand for the folder that holds them; `atlas.jsonl` is the former name of the list of a table set.
_FOLDERS = {
    "tables.jsonl": FileKind.TABLE_SET, "atlas.jsonl": FileKind.TABLE_SET, "diagnosis.json": FileKind.DIAGNOSIS
}  # fmt: skip

# First bytes of files whose formats are not of needleplan: MCAP, HDF5 without a seal, MATLAB.
_BEGINNINGS = {
    b"\x89MCAP0\r\n": FileKind.RECORDING,
    b"\x89HDF\r\n\x1a\n": FileKind.DATA,
    b"MATLAB ": FileKind.DATA,
}

# Length of the text of a wrong path beyond which its class is named instead.
_LONGEST = 60

# Number of bytes within which a file names its schema, or has the first tables of a TOML file.
_HEAD_BYTES = 65536
_SEAL = re.compile(rb"(needleplan\.[a-z-]+/[0-9]+) ")
_JSON = re.compile(r'"schema"\s*:\s*"(needleplan\.[^"]*)"')
_TOML = re.compile(r"""^\s*["']?schema["']?\s*=\s*["'](needleplan\.[^"'\n]*)["']""", re.MULTILINE)
_HEADER = re.compile(r"^\s*\[+\s*([\w-]+)", re.MULTILINE)
# Tables of TOML files that tell the kind of a file that names no schema.
_TOML_TABLES = {"anatomy": FileKind.ANATOMY, "workspace": FileKind.SCENARIO}


@dataclass(frozen=True)
class FileFormat:
    """Kind of a file, None if it is not known; and the format that the file names, empty if it names none."""

    kind: FileKind | None = None
    schema: str = ""


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


def file_format(path: str | os.PathLike[str]) -> FileFormat:
    """Return kind and format of a file or a folder. The kind is None if it is missing, unreadable or of another kind.

    The version of the format is not compared: the reader of the kind does this.
    """
    place = Path(path)
    try:
        if place.is_dir():
            return next((file_format(place / name) for name in _FOLDERS if (place / name).is_file()), FileFormat())
        with place.open("rb") as stream:
            head = stream.read(_HEAD_BYTES)
    except (OSError, ValueError):
        return FileFormat()
    for beginning, kind in _BEGINNINGS.items():
        if head.startswith(beginning):
            return FileFormat(kind)
    sealed = _SEAL.match(head)
    if sealed:
        return _named(sealed[1].decode())
    return _format_of_text(head.decode(errors="replace"), place.name)


def present_format(found: str) -> str:
    """Return the present name of the format `found`: another one if `found` is a former name, else `found` itself."""
    return _FORMER.get(found, found)


def other_kind(found: str, wanted: str) -> str:
    """Return the kind of a file, in words, if it is another kind than the wanted one, else an empty text.

    Parameters
    ----------
    found : str
        Format of the file, such as `needleplan.table/1`.
    wanted : str
        Format of the wanted kind.

    Returns
    -------
    str
    """
    kind = _named(found).kind
    return "" if kind is None or kind is _named(wanted).kind else str(kind)


def version_advice(found: str, wanted: str) -> str:
    """Return advice for a file with the right format but the wrong version, else an empty text.

    Parameters
    ----------
    found : str
        Format of the file.
    wanted : str
        Format that can be read.

    Returns
    -------
    str
    """
    if found in _ENDED:
        return _RENEWALS[_ENDED[found]]
    (name, _, version), (wanted_name, _, wanted_version) = found.partition("/"), wanted.partition("/")
    if name != wanted_name or not version.isdecimal() or version == wanted_version:
        return ""
    if int(version) > int(wanted_version):
        return "it was written by a newer needleplan: install that version"
    return _RENEWALS.get(_NAMES[name], "write it anew, as the reference describes it") if name in _NAMES else ""


def _named(schema: str) -> FileFormat:
    return FileFormat(_ENDED.get(schema, _NAMES.get(present_format(schema).partition("/")[0])), schema)


def _format_of_text(text: str, name: str) -> FileFormat:
    """Return the format of a text file by its beginning; `name` tells a folder's list and a CSV file."""
    if text.lstrip().startswith("{"):
        schema = _JSON.search(text)
        return _named(schema[1]) if schema else FileFormat(_FOLDERS.get(name))
    header = _HEADER.search(text)
    schema = _TOML.search(text, 0, header.start() if header else len(text))
    if schema:
        return _named(schema[1])
    tables = [found[1] for found in _HEADER.finditer(text)]
    kind = next((kind for table, kind in _TOML_TABLES.items() if table in tables), None)
    is_data = "time_s" in text.partition("\n")[0] or name.lower().endswith(".csv")
    return FileFormat(FileKind.DATA if kind is None and is_data else kind)
