"""The folder of a table set: its list of points, the tables, and the records of the tables.

::

    STORE/
        tables.jsonl            first line: schema, identity, sweep, digest of the file; then one line per point:
                                values, address of its table
        tables/ab/abcdef….h5    a compressed table file, named by its address
        records/*.jsonl         one line per finished table; each writer appends to a file of its own

The address of a table is the SHA-256 of its scenario and of the version of needleplan. All files but the records are
written to a temporary name and renamed, so a reader, or a second writer, sees complete files only. A record ends with
its own digest: a damaged line, or a last one without its end, is ignored. A table without a record is one whose writer
was stopped, or whose record was damaged: it is read, not solved.
"""

from __future__ import annotations

import json
import os
import secrets
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from needleplan.artifacts import (
    FORMATS,
    FileKind,
    digest,
    json_values,
    move_into_place,
    version,
    version_advice,
    write_whole,
)
from needleplan.config import parse_toml, suggestion
from needleplan.errors import Mistake, OutputError, SweepError
from needleplan.sweep._points import SweepPoint
from needleplan.sweep._sweep import Sweep

__all__ = ["SCHEMA", "RecordWriter", "StoredPoint", "TableSetStore", "address_of"]

SCHEMA = FORMATS[FileKind.TABLE_SET]
"""Schema of the file `tables.jsonl`."""

# Name of the list of points, and its former name, which is kept in folders that have it.
_LIST, _FORMER_LIST = "tables.jsonl", "atlas.jsonl"
# Former names of numbers in a record.
_FORMER_NUMBERS: dict[str, str] = {"rotations": "turns"}
_FOLDERS = ("tables", "records")

# Age (s) at which an unfinished file counts as abandoned. Writing a table takes seconds, on a slow network minutes.
_ABANDONED_S = 3600.0


@dataclass(frozen=True)
class StoredPoint:
    """A point of the sweep of a store: values, address of its table (empty: no scenario), and why it has none."""

    values: dict[str, Any]
    address: str
    why: str = ""


@dataclass(frozen=True)
class TableSetStore:
    """The folder of a table set.

    `identity` is a random text that workers compare, to find out whether they see the same folder.
    """

    folder: Path
    identity: str
    sweep: Sweep
    points: tuple[StoredPoint, ...]

    @classmethod
    def open(cls, folder: str | os.PathLike[str]) -> TableSetStore:
        """Read the list of points of a store. Raises SweepError if the folder is no store."""
        path = Path(folder)
        try:
            lines = _list_of(path).read_text(encoding="utf-8").splitlines()
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise SweepError(f"is no table set: {_LIST} cannot be read: {reason}", os.fspath(folder)) from None
        try:
            head, *points = map(json.loads, lines)
            if head["schema"] != SCHEMA:
                advice = version_advice(str(head["schema"]), SCHEMA)
                rule = f"must be {SCHEMA}" + (f": {advice}" if advice else suggestion(head["schema"], [SCHEMA]))
                raise SweepError(Mistake("schema", str(head["schema"]), rule), os.fspath(folder))
            if head.pop("digest", None) != digest("\n".join([_line(head), *lines[1:]])):
                raise ValueError("its digest differs")
            sweep = parse_toml(head["sweep"], Sweep)
            stored = tuple(StoredPoint(dict(point["values"]), point["table"], point.get("why", "")) for point in points)
            return cls(path, str(head["identity"]), sweep, stored)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            hint = "remove this file and make the sweep again; all tables stay"
            raise SweepError(f"{_list_of(path).name} is damaged ({error}): {hint}", os.fspath(folder)) from None

    @classmethod
    def make(cls, folder: str | os.PathLike[str], sweep: Sweep, points: Sequence[SweepPoint]) -> TableSetStore:
        """Make a store, or give an existing one the points of a changed sweep; finished tables stay.

        Raises SweepError if the folder holds other files or the table set of a sweep over other parameters, and
        OutputError if it cannot be written.
        """
        path = Path(folder)
        identity = secrets.token_hex(16)
        new = not _list_of(path).exists()
        if not new or _has_other_files(path):
            before = cls.open(path)
            _require_same_parameters(before.sweep, sweep, os.fspath(folder))
            identity = before.identity
        stored = tuple(
            StoredPoint(point.values, address_of(point.identity) if point.identity else "", point.why)
            for point in points
        )
        head = {"schema": SCHEMA, "identity": identity, "made_by": f"needleplan {version()}", "sweep": sweep.to_toml()}
        lines = [_line({"values": point.values, "table": point.address} | _why(point)) for point in stored]
        head["digest"] = digest("\n".join([_line(head), *lines]))
        text = "".join(line + "\n" for line in [_line(head), *lines])
        try:
            for name in _FOLDERS:
                (path / name).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(Mistake("", "", f"cannot be made: {error.strerror}"), os.fspath(folder)) from None
        _remove_partial_files(path / "tables")
        if new and not _claimed(path, text.encode()):
            return cls.make(folder, sweep, points)  # another run has made the store meanwhile; its identity holds
        if not new and _list_of(path).read_text(encoding="utf-8") != text:
            write_whole(_list_of(path), text.encode())
        return cls(path, identity, sweep, stored)

    def table_path(self, address: str) -> Path:
        """Return the path of the table file with an address."""
        return self.folder / "tables" / address[:2] / f"{address}.h5"

    def records(self) -> dict[str, dict[str, Any]]:
        """Return the newest record of each address. Lines that are incomplete or damaged are left out."""
        records: dict[str, dict[str, Any]] = {}
        for file in sorted((self.folder / "records").glob("*.jsonl")):
            for record in _complete_lines(file):
                address = record.get("table")
                if isinstance(address, str) and record.get("at", 0) >= records.get(address, {}).get("at", 0):
                    records[address] = record
        return records

    def there(self) -> dict[str, int]:
        """Return the sizes (bytes) of all table files by address."""
        files = (self.folder / "tables").glob("??/*.h5")
        return {file.stem: file.stat().st_size for file in files if not file.name.startswith(".")}


class RecordWriter:
    """Appends records to a file of its own in a store; the file is made with the first record.

    Raises OutputError if a record cannot be written.
    """

    def __init__(self, store: TableSetStore) -> None:
        self._path = store.folder / "records" / f"{secrets.token_hex(8)}.jsonl"

    def append(self, record: dict[str, Any]) -> None:
        """Append a record as one line with one write: a reader sees the whole line or an incomplete last one."""
        line = _line(record | {"sum": digest(_line(record))}) + "\n"
        try:
            descriptor = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
            try:
                data = line.encode()
                if os.write(descriptor, data) != len(data):
                    raise OSError(28, "no space left on the device")
            finally:
                os.close(descriptor)
        except OSError as error:
            rule = f"cannot be written: {error.strerror}"
            raise OutputError(Mistake("", "", rule), os.fspath(self._path)) from error


def _list_of(folder: Path) -> Path:
    """Return the path of the list of points of a store, which has its former name if only that file exists."""
    former = folder / _FORMER_LIST
    return former if former.exists() and not (folder / _LIST).exists() else folder / _LIST


def _has_other_files(path: Path) -> bool:
    """Return whether a folder holds what a run that was stopped, or has just begun, cannot have left."""
    return path.is_dir() and any(
        child.name not in _FOLDERS and not child.name.startswith(".") for child in path.iterdir()
    )


def _claimed(path: Path, text: bytes) -> bool:
    """Write the list of a new store; return False if another run was faster, as in a job array."""
    partial = path / f".{secrets.token_hex(8)}.partial"
    write_whole(partial, text)
    try:
        move_into_place(partial, path / _LIST, replace=False)
    except FileExistsError:
        partial.unlink()
        return False
    return True


def _remove_partial_files(folder: Path) -> None:
    """Remove what writers left that were killed while they wrote."""
    for file in folder.glob("??/.*.partial"):
        with suppress(OSError):
            if time.time() - file.stat().st_mtime > _ABANDONED_S:
                file.unlink()


def address_of(identity: str) -> str:
    """Return the address of the table of a scenario with this identity: 64 hexadecimal digits."""
    return digest(f"{SCHEMA}\n{version()}\n{identity}").removeprefix("sha256:")


def _complete_lines(file: Path) -> Iterator[dict[str, Any]]:
    try:
        data = file.read_bytes()
    except OSError:
        return
    for line in data.split(b"\n")[:-1]:
        try:
            record = json.loads(line)
        except ValueError:
            continue
        if isinstance(record, dict) and record.pop("sum", None) == digest(_line(record)):
            yield {_FORMER_NUMBERS.get(str(name), str(name)): value for name, value in record.items()}


def _line(content: dict[str, Any]) -> str:
    return json.dumps(json_values(content), separators=(",", ":"))


def _why(point: StoredPoint) -> dict[str, str]:
    return {"why": point.why} if point.why else {}


def _require_same_parameters(before: Sweep, after: Sweep, source: str) -> None:
    keys = [{parameter.title: parameter.scenario_key for parameter in sweep.parameters} for sweep in (before, after)]
    if keys[0] != keys[1]:
        named = [", ".join(key) for key in keys]
        rule = f"is the table set of another sweep, over {named[0]}; this one is over {named[1]}. Choose another folder"
        raise SweepError(Mistake("", "", rule), source)
