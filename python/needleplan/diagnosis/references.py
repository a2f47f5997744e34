"""The recordings from which a model was identified, as the references of a diagnosis with this model."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from needleplan.artifacts import digest
from needleplan.diagnosis.data import check_data
from needleplan.errors import DataError
from needleplan.models import ModelFile
from needleplan.recording import read_records
from needleplan.signals import Record, Role

__all__ = ["identified_from"]


def identified_from(
    file: ModelFile, recordings: Sequence[Record], read: Callable[[Sequence[str]], list[Record]] = read_records
) -> tuple[list[Record], list[str]]:
    """Return the recordings from which a model file was identified, as references, with remarks.

    Parameters
    ----------
    file
        A model file that was read, and whose parents name their files, as `needleplan identify` writes them.
    recordings
        The recordings to diagnose. If they hold references, there are no further ones; nor is a file of these
        recordings a reference.
    read
        Reads data files, by their paths.

    Returns
    -------
    tuple of list of Record and list of str
        References, of the same sampling rate and frame as the recordings; and remarks on files that are used, missing,
        changed, or of another kind.
    """
    diagnosed = {recording.digest for recording in recordings}
    if file.folder is None or any(recording.role is Role.REFERENCE for recording in recordings):
        return [], []
    found: list[Record] = []
    remarks: list[str] = []
    names = {(parent.file, parent.digest) for parent in file.parents if parent.file and parent.digest not in diagnosed}
    for name, known in sorted(names):
        try:
            own = list(_references(file.folder / name, known, read))
            check_data([*recordings, *own], file.model.channel)
        except DataError as error:
            why = f"{error.mistakes[0].key} {error.mistakes[0].rule}".strip()
            remarks.append(f"{name}, from which the model was identified, is no reference: {why}")
            continue
        found += own
        remarks.append(f"references: {len(own)} trials of {name}, from which the model was identified")
    return found, remarks


def _references(path: Path, known: str, read: Callable[[Sequence[str]], list[Record]]) -> Iterator[Record]:
    """Yield the trials of a file as references. Raises DataError if it cannot be read or has changed.

    A model is identified from all trials of a file.
    """
    if not path.is_file():
        raise DataError("it is not there")
    if digest(path.read_bytes()) != known:
        raise DataError("it has changed since")
    for record in read([str(path)]):
        if record.role is not Role.NOISE:
            yield replace(record, role=Role.REFERENCE, trial=f"{path.name}: {record.trial}")
