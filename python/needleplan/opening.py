"""`open`: reads any file of needleplan, by what it contains and not by its name."""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from typing import Any

from needleplan.artifacts import FileKind, file_format, path_text
from needleplan.errors import InputError
from needleplan.scenario import Scenario, shipped

__all__ = ["open"]

# Module in needleplan, and the function in it that reads a file of the kind.
_READERS = {
    FileKind.SCENARIO: ("scenario", "Scenario.read"),
    FileKind.ANATOMY: ("anatomy", "Anatomy.read"),
    FileKind.TABLE: ("planning", "Table.read"),
    FileKind.TABLE_SET: ("sweep", "TableSet.open"),
    FileKind.SWEEP: ("sweep", "Sweep.read"),
    FileKind.RECORDING: ("recording", "Recording.read"),
    FileKind.DATA: ("recording", "read_records"),
    FileKind.MODEL: ("models", "ModelFile.read"),
    FileKind.FORCE_LIBRARY: ("identification.force_library", "ForceLibrary.read"),
    FileKind.DIAGNOSIS: ("page", "DiagnosisFile.read"),
    FileKind.REGISTRATION: ("estimation.registration", "Registration.read"),
    FileKind.SIMULATION: ("simulation", "Simulation.read"),
    FileKind.DRIVES: ("devices.cia402.setup", "DrivesSetup.read"),
}
# Kinds that stand for their folder: their readers take it.
_FOLDERS = {FileKind.TABLE_SET: ("tables.jsonl", "atlas.jsonl")}


def open(path: str | os.PathLike[str]) -> Any:
    """Open any file of needleplan.

    The content tells the kind of the file; its name does not matter. Files of other versions are refused with a message
    that says what to do.

    Parameters
    ----------
    path : str or path
        A scenario, an anatomy, a policy table (of the plane or 3D), a sweep, the folder of a table set, a
        recording, a data file, a model, a force library, a diagnosis or its folder, a registration, a simulation,
        or a setup of drives; or the name of a shipped scenario.

    Returns
    -------
    object
        A `Scenario`, `Anatomy`, `PolicyTable`, `SpaceTable`, `Sweep`, `TableSet`, `Recording`, list of `Record`,
        `ModelFile`, `ForceLibrary`, `DiagnosisFile`, `Registration`, `Simulation` or `DrivesSetup`.

    Raises
    ------
    InputError
        If the file is missing, of another kind or version, or damaged; as the subclass that the reader of its kind
        raises.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import needleplan as npl
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     npl.plan("four_obstacles").write(Path(folder) / "table.h5")
    ...     npl.open(Path(folder) / "table.h5")
    <PolicyTable "Four obstacles": 121 x 81 x 60 x 2 = 1,176,120 states, converged>
    """
    place = Path(path_text(path, InputError, "a file or a folder"))
    if not place.exists() or (os.fspath(path) in shipped() and not place.is_file()):
        return Scenario.read(path)  # a shipped one, or the message that there is no such file
    found = file_format(path)
    if found.kind is None:
        raise InputError(_unknown(place, found.schema), os.fspath(path))
    if place.is_file() and place.name in _FOLDERS.get(found.kind, ()):
        place = place.parent
    room, names = _READERS[found.kind]
    reader: Any = import_module(f"needleplan.{room}")
    for name in names.split("."):
        reader = getattr(reader, name)
    return reader(place)


def _unknown(place: Path, schema: str) -> str:
    kinds = ", ".join(FileKind)
    if schema:
        return f'names the format "{schema}", which this needleplan does not know. It opens: {kinds}'
    noun = "folder" if place.is_dir() else "file"
    return f"is no {noun} that needleplan opens. It opens: {kinds}"
