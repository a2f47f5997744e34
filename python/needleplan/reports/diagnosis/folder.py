"""Diagnosis of recordings and output files of `needleplan diagnose`.

How a diagnosis was made: model, recordings and options, as `diagnosis.json` keeps them.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from needleplan.artifacts import CallRepr, write_whole
from needleplan.diagnosis import (
    Diagnosis,
    FindingKind,
    Library,
    NextTrials,
    Verdict,
    default_library,
    diagnose,
    next_trials,
    ranked_hypotheses,
)
from needleplan.errors import Mistake, OutputError
from needleplan.models import ModelFile, Parent
from needleplan.reports.diagnosis.document import whole_document
from needleplan.reports.diagnosis.effect_file import effect_file_text
from needleplan.reports.diagnosis.motion_file import motion_files
from needleplan.reports.diagnosis.report import report_of
from needleplan.reports.diagnosis.traces import traces_of
from needleplan.signals import Record

__all__ = ["FILES", "MOST_TRIALS", "DiagnosisSource", "diagnose_records", "lines_of", "next_trials_of", "write_folder"]


@dataclass(frozen=True)
class DiagnosisSource(CallRepr):
    """Files and options of a diagnosis, as they were given to `needleplan diagnose`.

    Attributes
    ----------
    model
        The model file.
    data, holdout, reference, noise
        Files of recordings: with the roles that they state, of held-out trials, of trials without the effects, of the
        sensor at rest.
    columns, surface_mm
        Columns and units of foreign files, and the reading of the depth at the surface of the tissue.
    rate_hz
        Rate to which all trials were interpolated; None if they were used as recorded.
    accept_units
        Whether implausible sizes were accepted.
    effects
        Python files of further effects.
    frame
        Frame of the files that do not say it; None if none was given.
    without_references, strict
        Whether the recordings from which the model was identified were no references, and whether the diagnosis of the
        references could be the result.
    """

    model: str
    data: tuple[str, ...]
    holdout: tuple[str, ...] = ()
    noise: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    surface_mm: float | None = None
    rate_hz: float | None = None
    accept_units: bool = False
    effects: tuple[str, ...] = ()
    frame: str | None = None
    reference: tuple[str, ...] = ()
    without_references: bool = False
    strict: bool = False

    def document(self) -> dict[str, Any]:
        """Return the entry `source` of `diagnosis.json`, as a dictionary of JSON values."""
        return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}


MOST_TRIALS = 10
"""Largest number of trials that are proposed together: an afternoon's work."""

_MOTIONS = ("next_motion.toml", *(f"next_motion_{number}.toml" for number in range(2, MOST_TRIALS + 1)))

FILES = (
    "diagnosis.json", "report.html", "traces.h5", "model.toml", "effect_to_name.py", "scenario.toml", "anatomy.toml",
    *_MOTIONS,
)  # fmt: skip
"""Names of all files that a diagnosis may write into its folder."""

_STALE = ("model.toml", "scenario.toml", "anatomy.toml", *_MOTIONS)

# Number of hypotheses on the terminal.
_MOST_SHOWN = 5


def diagnose_records(
    file: ModelFile, records: Sequence[Record], progress: Callable[[str], None] | None = None, *, strict: bool = False
) -> tuple[Diagnosis, ModelFile, Library]:
    """Return the diagnosis of the model of a file, that file, and the library of effects.

    `progress` is called with the name of each stage. The references are those of the records; if `strict`, their own
    diagnosis is the result if they show something. Raises DataError for data that cannot be used.
    """
    library = default_library(file.model)
    found = diagnose(file, records, library=library, references=False, strict=strict, progress=progress)
    return found, file, library


def next_trials_of(found: Diagnosis, trials: int = 1) -> NextTrials | None:
    """Return `trials` motions to measure next; None if no question is open."""
    return None if found.verdict is Verdict.NONE else next_trials(found, count=trials)


def write_folder(
    found: Diagnosis, file: ModelFile, library: Library, folder: str, *, next_: NextTrials | None = None,
    merge_anyway: bool = False, source: DiagnosisSource | None = None,
) -> tuple[str, ...]:  # fmt: skip
    """Write a diagnosis into a folder, which is created if needed, and return the paths of all written files.

    - `diagnosis.json`, with `source` if it is given, `report.html` and `traces.h5`: always
    - `next_motion.toml`, `next_motion_2.toml`, ...: for each motion of `next_` that is no repetition, and that such a
      file can hold
    - `model.toml`: if the answer is NAMED, or if effects were found and `merge_anyway` is set
    - `effect_to_name.py`: if the answer has an axis, for the axial force

    First removes the models, motions and scenarios that an earlier diagnosis wrote, so that none of them stands beside
    the new one. Raises OutputError if the folder cannot be created, or a file cannot be removed or written.
    """
    place = _made_folder(folder)
    _remove_stale(place, _STALE)
    written = [place / "diagnosis.json", place / "report.html", place / "traces.h5"]
    document, content = whole_document(found, next_)
    if source:
        document["source"] = source.document()
    write_whole(written[2], content)
    write_whole(written[0], (json.dumps(document, indent=1) + "\n").encode())
    write_whole(written[1], report_of(found, file, library, next_, traces_of(found)).encode())
    for motion in motion_files(next_, found.given).values():
        if motion.text:
            written.append(place / motion.name)
            write_whole(written[-1], motion.text.encode())
    changed = found.verdict is Verdict.CHANGED and not found.keeps_given
    if found.verdict is Verdict.NAMED or changed or (merge_anyway and found.likely):
        model = found.merged(anyway=merge_anyway)
        digests = {
            each.trial: each.digest
            for each in (*found.checked.training, *found.checked.held_out, *found.checked.references)
        }
        parents = (Parent("base", file.digest), *(Parent(name, digest) for name, digest in digests.items()))
        remark = f"answer of the diagnosis {found.digest}: {found.verdict}"
        written.append(place / "model.toml")
        ModelFile(model, found.estimates(), parents, (*file.remarks, remark), file.title).write(written[-1])
    if found.course:
        written.append(place / "effect_to_name.py")
        write_whole(written[-1], effect_file_text(found.course).encode())
    return tuple(map(str, written))


def lines_of(found: Diagnosis, next_: NextTrials | None) -> Iterator[str]:
    """Yield the lines for the terminal: the gap of the given model, then the answer."""
    decision = found.decision
    gap, *taken_up = found.budget.sentences()
    yield f"gap: {gap}"
    if taken_up:
        yield f"  {'; '.join(taken_up)}"
    yield f"{decision.verdict}: {', '.join(decision.names)}{': ' if decision.names else ''}{decision.because}"
    for each in found.likely if found.lacks_data else found.effects:
        yield f"  {each.effect.title}: {each.effect.meaning}"
        for name, value in each.estimates.items():
            yield f"    {name:<14} {value.value:.4g} {value.unit}  ({value.low:.4g} to {value.high:.4g})".rstrip()
        yield f"    adds {each.rms:.3g} RMS to the readings, {each.share:.0%} of what was found"
    for finding in found.findings:
        if finding.kind in (FindingKind.PARAMETER, FindingKind.LAW) and finding.words != decision.because:
            yield f"  another {finding.kind}: {finding.words}"
    for row in ranked_hypotheses(found)[:_MOST_SHOWN]:
        yield f"  {row.probability:6.1%}  {row.words}: {row.because}"
    if decision.axis:
        yield f"  what no effect explains depends on: {decision.axis.label}"
    if found.effects and found.shrink == found.shrink:  # not NaN
        yield f"  held out: {found.shrink:.0%} of the gap above the noise is closed"
    if next_:
        yield f"  next: {next_.why}"
    for name, motion in motion_files(next_, found.given).items():
        if motion.problem:
            yield f"  no file of the next motion, {name}: {motion.problem}"
    for why in found.checked.lacks.values():
        yield f"  lacking: {why}"
    for remark in found.remarks:
        yield f"  remark: {remark}"


def _remove_stale(place: Path, names: Sequence[str]) -> None:
    """Remove files of an earlier diagnosis from a folder. Raises OutputError if one cannot be removed."""
    for name in names:
        try:
            (place / name).unlink(missing_ok=True)
        except OSError as error:
            rule = f"belongs to an earlier diagnosis and cannot be removed: {error.strerror}"
            raise OutputError(Mistake("", "", rule), str(place / name)) from error


def _made_folder(folder: str) -> Path:
    """Create a folder if needed, and return its path. Raises OutputError if it cannot be created."""
    place = Path(folder)
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(Mistake("", "", f"cannot be made: {error.strerror}"), folder) from error
    return place
