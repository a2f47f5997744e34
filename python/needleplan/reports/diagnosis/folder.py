"""Diagnosis of recordings and output files of `needleplan diagnose`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from needleplan.artifacts import digest, write_whole
from needleplan.diagnosis import Diagnosis, Library, Verdict, diagnose, document_of
from needleplan.diagnosis.next_motion import NextMotion, next_motion
from needleplan.errors import Mistake, OutputError
from needleplan.models import ModelFile, Parent
from needleplan.models.effects import effects_of
from needleplan.reports.diagnosis.effect_file import effect_file_text
from needleplan.reports.diagnosis.motion_file import motion_text, next_motion_document
from needleplan.reports.diagnosis.report import report_of
from needleplan.reports.diagnosis.source import DiagnosisSource
from needleplan.reports.diagnosis.trace_file import trace_bytes
from needleplan.reports.diagnosis.traces import TrialTrace, traces_of
from needleplan.reports.diagnosis.words import advice, answer, title_of
from needleplan.signals import UNITS, Record

__all__ = ["FILES", "STALE", "diagnose_records", "made_folder", "remove_stale", "whole_document", "write_folder"]


FILES = (
    "diagnosis.json", "report.html", "traces.h5", "model.toml", "next_motion.toml", "effect_to_name.py",
    "scenario.toml",
)  # fmt: skip
"""Names of all files that a diagnosis may write into its folder."""

STALE = ("model.toml", "next_motion.toml", "scenario.toml")
"""Files that other commands read, and that a new diagnosis removes if it does not write them."""


def diagnose_records(
    file: ModelFile, records: Sequence[Record], *, seed: int = 0
) -> tuple[Diagnosis, ModelFile, Library]:
    """Return the diagnosis of the model of a file, that file, and the library of effects.

    `seed` is the seed of the simulated data behind the p-values. Raises DataError for data that cannot be used.
    """
    library = Library(effects_of(file.model.channel), file.model)
    return diagnose(file.model, records, library=library, seed=seed), file, library


def write_folder(
    found: Diagnosis, file: ModelFile, library: Library, folder: str, *, merge_anyway: bool = False,
    source: DiagnosisSource | None = None,
) -> tuple[str, ...]:  # fmt: skip
    """Write a diagnosis into a folder, which is created if needed, and return the paths of all written files.

    - `diagnosis.json`, with `source` if it is given, `report.html` and `traces.h5`: always
    - `next_motion.toml`: if a further motion is proposed
    - `model.toml`: if the verdict is NAMED, or if effects were found and `merge_anyway` is set
    - `effect_to_name.py`: if a gap is left unexplained and described

    First removes the files of `STALE` that an earlier diagnosis wrote, so that no model, motion or scenario of the
    earlier diagnosis stands beside the new one. Raises OutputError if the folder cannot be created, or a file cannot be
    removed or written.
    """
    place = made_folder(folder)
    remove_stale(place, STALE)
    written = [place / "diagnosis.json", place / "report.html", place / "traces.h5"]
    next_, traces = next_motion(found), traces_of(found)
    document, content = whole_document(found, traces, next_)
    if source:
        document["source"] = source.document()
    write_whole(written[2], content)
    write_whole(written[0], (json.dumps(document, indent=1) + "\n").encode())
    write_whole(written[1], report_of(found, file, library, next_, traces).encode())
    if next_:
        written.append(place / "next_motion.toml")
        write_whole(written[-1], motion_text(next_.program, next_.why, next_.role, found.base).encode())
    if found.verdict is Verdict.NAMED or (merge_anyway and found.effects):
        model = found.merged(anyway=merge_anyway)
        digests = {each.trial: each.digest for each in (*found.checked.training, *found.checked.held_out)}
        parents = (Parent("base", file.digest), *(Parent(name, digest) for name, digest in digests.items()))
        remark = f"verdict of the diagnosis {found.digest}: {found.verdict}"
        written.append(place / "model.toml")
        ModelFile(model, found.estimates(), parents, (*file.remarks, remark), file.title).write(written[-1])
    if found.described:
        written.append(place / "effect_to_name.py")
        write_whole(written[-1], effect_file_text(found.described).encode())
    return tuple(map(str, written))


def whole_document(
    found: Diagnosis, traces: Sequence[TrialTrace], next_: NextMotion | None
) -> tuple[dict[str, Any], bytes]:
    """Return the content of `diagnosis.json`, and that of `traces.h5`, whose digest the document holds."""
    content = trace_bytes(found.given.channel, found.digest, traces, next_.motion if next_ else None)
    words = {"title": title_of(found), "answer": list(answer(found, UNITS[found.given.channel.columns[0]])),
             "advice": list(advice(found))}  # fmt: skip
    return document_of(found) | {
        "next_motion": next_motion_document(next_) if next_ else None,
        "words": words,
        "traces": {"file": "traces.h5", "digest": digest(content)},
    }, content


def remove_stale(place: Path, names: Sequence[str]) -> None:
    """Remove files of an earlier diagnosis from a folder. Raises OutputError if one cannot be removed."""
    for name in names:
        try:
            (place / name).unlink(missing_ok=True)
        except OSError as error:
            rule = f"belongs to an earlier diagnosis and cannot be removed: {error.strerror}"
            raise OutputError(Mistake("", "", rule), str(place / name)) from error


def made_folder(folder: str) -> Path:
    """Create a folder if needed, and return its path. Raises OutputError if it cannot be created."""
    place = Path(folder)
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(Mistake("", "", f"cannot be made: {error.strerror}"), folder) from error
    return place
