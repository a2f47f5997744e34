"""The files of a diagnosis for the page: `diagnosis.json`, checked, and the curves of `traces.h5`."""

from __future__ import annotations

import io
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from needleplan.artifacts import (
    FORMATS,
    FileKind,
    ShortRepr,
    digest,
    file_format,
    version_advice,
)
from needleplan.errors import DataError, Mistake
from needleplan.scenario import shipped

if TYPE_CHECKING:
    import h5py

__all__ = ["DiagnosisFile", "TrialCurves", "is_diagnosis"]

_SCHEMA = FORMATS[FileKind.DIAGNOSIS]
_NAME, _TRACES = "diagnosis.json", "traces.h5"

# Keys that the page cannot do without, and the types of their values.
_KEYS: dict[str, type] = {
    "digest": str, "channel": str, "unit": str, "model": str, "verdict": str, "because": str, "hypotheses": list,
    "effects": list, "noise": dict, "trials": list, "where": list, "smallest": list, "settings": list,
}  # fmt: skip
_TRIAL_KEYS: dict[str, type] = {"trial": str, "role": str, "samples": int, "digest": str}
_EFFECT_KEYS: dict[str, type] = {
    "name": str, "title": str, "meaning": str, "equation": str, "source": str, "parameters": dict,
}  # fmt: skip
_JSON_NAMES = {str: "a text", int: "a whole number", list: "a list", dict: "an object"}


def is_diagnosis(name: str) -> bool:
    """Return whether the page opens a path as a diagnosis.

    The result is True for every folder and JSON file, even if its diagnosis is missing or damaged: `read` then raises
    an error that names the fault. The result is False for the name of a shipped scenario, such as `phantom`.
    """
    place = Path(name)
    is_folder = place.is_dir() and name not in shipped()
    return is_folder or file_format(name).kind is FileKind.DIAGNOSIS or place.suffix.lower() == ".json"


@dataclass(frozen=True)
class TrialCurves:
    """Curves of one trial: time (s) and depth (mm), shape (n,); outputs, shape (axes, n). `after` may be None."""

    time_s: NDArray[np.float64]
    depth_mm: NDArray[np.float32]
    measured: NDArray[np.float32]
    before: NDArray[np.float32]
    after: NDArray[np.float32] | None


@dataclass(frozen=True)
class DiagnosisFile(ShortRepr):
    """A diagnosis with its curves.

    Attributes
    ----------
    document
        Content of `diagnosis.json`, with the keys that the page needs.
    source
        Name of the folder or of the file that was opened.
    curves
        Curves of the trials, in the order of `document["trials"]`; empty if `problem` says why they are missing.
    next_motion
        Time (s) and depth (mm) of the next motion, shape (2, n); None without one.
    problem
        Why curves are missing; empty if they are there.
    """

    document: dict[str, Any]
    source: str
    curves: tuple[TrialCurves, ...] = ()
    next_motion: NDArray[np.float32] | None = None
    problem: str = ""

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> DiagnosisFile:
        """Read a folder that `needleplan diagnose` has written, or its `diagnosis.json`.

        If the curves are missing, damaged or of another diagnosis, the result has no curves, and `problem` states the
        reason.
        Raises DataError if the folder holds no diagnosis, or the document is damaged.
        """
        place = Path(path)
        file = place / _NAME if place.is_dir() else place
        if place.is_dir() and not file.exists():
            rule = f"holds no {_NAME}: give the folder that `needleplan diagnose ... -o DIR` has written"
            raise DataError(rule, os.fspath(path))
        document = _document(file)
        from needleplan.artifacts.hdf5_guard import require_harmless  # time that other pages do not need

        traces = file.parent / _TRACES
        try:
            content = traces.read_bytes()
            require_harmless(traces)
        except DataError as error:
            return cls(document, os.fspath(path), problem=_no_curves(error.mistakes[0].rule))
        except OSError as error:
            why = "is missing" if isinstance(error, FileNotFoundError) else f"cannot be read: {error.strerror}"
            return cls(document, os.fspath(path), problem=_no_curves(why))
        return cls.of(document, content, os.fspath(path))

    @classmethod
    def of(cls, document: dict[str, Any], content: bytes, source: str = "") -> DiagnosisFile:
        """Return the diagnosis of a checked document.

        Parameters
        ----------
        document : dict
            Contents of the diagnosis file.
        content : bytes
            Contents of `traces.h5`, with the curves. If they are of another diagnosis or cannot be read, the result has
            no curves, and says why in `problem`.
        source : str, optional
            Name of the file in messages.

        Returns
        -------
        DiagnosisFile
        """
        import h5py  # takes time that other pages do not need

        told = document.get("traces")
        if not isinstance(told, dict) or told.get("digest") != digest(content):
            return cls(document, source, problem=_no_curves("belongs to another diagnosis, or has changed since"))
        try:
            with h5py.File(io.BytesIO(content), "r") as file:
                found = tuple(_curves(file[f"trial {number}"]) for number in range(len(document["trials"])))
                after = file.get("next motion")
                motion = np.stack([after["time_s"][:], after["depth_mm"][:]]).astype(np.float32) if after else None
        except Exception as error:  # h5py raises many types of exceptions for a file that another program has made
            return cls(document, source, problem=_no_curves(f"is not as `needleplan diagnose` writes it: {error}"))
        return cls(document, source, found, motion)


def _no_curves(why: str) -> str:
    return f"No curves are shown: {_TRACES} {why}. Run `needleplan diagnose` again."


def _document(file: Path) -> dict[str, Any]:
    """Return the checked content of a file. Raises DataError with all mistakes."""
    source = os.fspath(file)
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise DataError(f"cannot be read: {error.strerror}", source) from None
    except (ValueError, RecursionError) as error:
        raise DataError(f"is damaged: it is not JSON ({error}); run `needleplan diagnose` again", source) from None
    found = document.get("schema") if isinstance(document, dict) else None
    if not isinstance(document, dict) or found != _SCHEMA:
        advice = version_advice(str(found), _SCHEMA) or "`needleplan diagnose` writes such files"
        rule = f'must be "{_SCHEMA}": {advice}'
        raise DataError(Mistake("schema", json.dumps(found), rule), source)
    mistakes = _wrong("", document, _KEYS)
    if not mistakes:
        for name, keys in (("trials", _TRIAL_KEYS), ("effects", _EFFECT_KEYS)):
            for number, each in enumerate(document[name]):
                mistakes += _wrong(f"{name}[{number}].", each, keys)
    if not mistakes and not document["trials"]:
        mistakes.append(Mistake("trials", "[]", "must hold a trial"))
    if mistakes:
        raise DataError(mistakes, source)
    return document


def _wrong(prefix: str, table: Any, keys: dict[str, type]) -> list[Mistake]:
    if not isinstance(table, dict):
        return [Mistake(prefix.rstrip("."), json.dumps(table)[:40], "must be an object")]
    return [
        Mistake(f"{prefix}{name}", json.dumps(table.get(name))[:40], f"must be {_JSON_NAMES[kind]}")
        for name, kind in keys.items()
        if not isinstance(table.get(name), kind) or isinstance(table.get(name), bool)
    ]


def _curves(group: h5py.Group) -> TrialCurves:
    """Return the curves of a trial. Raises ValueError if their shapes differ, or they stand in another file."""
    for name in group:
        if group[name].external or group[name].is_virtual:
            raise ValueError(f"the curves of {group.name} stand in another file")
    time_s, depth_mm = group["time_s"][:], group["depth_mm"][:]
    measured, before = group["measured"][:], group["before"][:]
    after = group["after"][:] if "after" in group else None
    shape = (len(measured), len(time_s))
    outputs = [each for each in (measured, before, after) if each is not None]
    if depth_mm.shape != time_s.shape or any(output.shape != shape for output in outputs):
        raise ValueError(f"the curves of {group.name} have different lengths")
    return TrialCurves(time_s, depth_mm, measured, before, after)
