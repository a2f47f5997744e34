"""Names of labels: colour tables of 3D Slicer, and the reading of a volume by the ending of its name.

Names of labels in the tables of other programs: 3D Slicer (.ctbl, .csv) and ITK-SNAP (.txt).
"""

from __future__ import annotations

import csv
import importlib.util
import shlex
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from needleplan.anatomy._nifti import read_nifti
from needleplan.anatomy._nrrd import read_nrrd
from needleplan.anatomy._volume import is_label
from needleplan.config import Violation, sequence, suggestion
from needleplan.errors import Mistake, ScenarioError, reading

if TYPE_CHECKING:
    import os

    from needleplan.anatomy._volume import LabelVolume

__all__ = [
    "BETWEEN",
    "OUTSIDE",
    "TABLE_ENDINGS",
    "LabelRule",
    "LabelsRule",
    "label_number",
    "name_mistakes",
    "read_color_table",
    "read_label_names",
    "read_labels",
    "read_volume",
    "require_libraries",
    "table_name",
]


# Form and number of words of a line of a colour table.
_LINE, _WORDS = "must be NUMBER NAME R G B A", 6
_READERS = {".nii": read_nifti, ".nii.gz": read_nifti, ".nrrd": read_nrrd, ".nhdr": read_nrrd}


@dataclass(frozen=True)
class LabelRule:
    """Rule for a label: its name, or its number."""

    def read(self, value: object) -> str | int:
        """Return the name or number. Raises Violation."""
        if isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= 65535:
            return value
        if isinstance(value, str) and value.strip():
            return value
        raise Violation("must be the name of a label, or its number from 0 to 65535", value)


@dataclass(frozen=True)
class LabelsRule:
    """Rule for a list of labels."""

    def read(self, value: object) -> tuple[str | int, ...]:
        """Return the labels as a tuple. Raises Violation."""
        entries = sequence(value)
        if entries is None:
            raise Violation("must be a list of labels", value)
        return tuple(LabelRule().read(entry) for entry in entries)


def read_volume(path: str | os.PathLike[str]) -> LabelVolume:
    """Read a segmentation.

    Parameters
    ----------
    path : str or path
        A NIfTI file (.nii, .nii.gz) or an NRRD file (.nrrd, .nhdr). Needs ``pip install needleplan[volumes]``.

    Returns
    -------
    LabelVolume
        The labels, and the matrix from voxels to RAS mm.

    Raises
    ------
    ScenarioError
        If the file cannot be read, is damaged, states no orientation, is not 3-D, does not fit into the memory, or
        contains values that are not labels.
    """
    volume = read_labels(Path(path))
    return replace(volume, labels=np.ascontiguousarray(volume.labels))


def read_labels(file: Path) -> LabelVolume:
    """Return a segmentation with its voxels in the order of the file, which spares a copy. Raises as `read_volume`."""
    source = str(file)
    require_libraries(source)
    read = next((read for end, read in _READERS.items() if file.name.lower().endswith(end)), None)
    if read is None:
        raise ScenarioError(f"the name of a volume must end in {', '.join(_READERS)}", source)
    try:
        with reading(source, ScenarioError):
            return read(file)
    except MemoryError:
        raise ScenarioError("does not fit into the memory: crop or resample it", source) from None


def require_libraries(source: str) -> None:
    """Raise ScenarioError if the libraries for volumes are not installed."""
    if any(importlib.util.find_spec(library) is None for library in ("nibabel", "nrrd")):
        rule = "volumes need nibabel and pynrrd: install them with `pip install needleplan[volumes]`"
        raise ScenarioError(rule, source)


def read_color_table(path: str | os.PathLike[str]) -> dict[str, int]:
    r"""Read the names of labels from a colour table of 3D Slicer.

    Parameters
    ----------
    path : str or path
        A text file with lines ``NUMBER NAME R G B A``; colours may be missing. Lines that begin with # are comments. A
        name has no blanks: Slicer writes _ for them.

    Returns
    -------
    dict
        Numbers of labels by name.

    Raises
    ------
    ScenarioError
        If the file cannot be read, or with all wrong lines.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from needleplan.anatomy import read_color_table
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = (Path(folder) / "labels.ctbl").write_text("0 air 0 0 0 0\n1 liver 221 130 101 255\n")
    ...     read_color_table(Path(folder) / "labels.ctbl")
    {'air': 0, 'liver': 1}
    """
    source = str(path)
    with reading(source, ScenarioError):
        lines = Path(path).read_text(encoding="utf-8").splitlines()
    names: dict[str, int] = {}
    found: dict[int, str] = {}
    mistakes = []
    for number, line in enumerate(lines, start=1):
        words = line.split()
        if not words or line.lstrip().startswith("#"):
            continue
        if len(words) < 2 or not is_label(words[0]):
            mistakes.append(Mistake(f"line {number}", line.strip(), _LINE))
        elif len(words) > _WORDS or not all(map(_is_number, words[2:])):
            mistakes.append(Mistake(f"line {number}", line.strip(), f"{_LINE}; write _ for blanks in the name"))
        elif found.setdefault(int(words[0]), words[1]) != words[1]:
            rule = f"label {words[0]} has the name {found[int(words[0])]} already"
            mistakes.append(Mistake(f"line {number}", words[1], rule))
        elif names.get(words[1], int(words[0])) != int(words[0]):
            mistakes.append(Mistake(f"line {number}", words[1], f"is also the name of label {names[words[1]]}"))
        else:
            names[words[1]] = int(words[0])
    if mistakes or not names:
        raise ScenarioError(mistakes or "contains no labels", source)
    return names


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def label_number(label: str | int, names: Mapping[str, int], key: str) -> int:
    """Return the number of a label, given by its number or name. Raises ScenarioError if the name is unknown."""
    if isinstance(label, int):
        return label
    for name in (label, label.replace(" ", "_")):
        if name in names:
            return names[name]
    known = ", ".join(list(names)[:10]) or "none: name a colour table in anatomy.labels, or give numbers"
    rule = f"is not the name of a label (known: {known}){suggestion(label, names)}"
    raise ScenarioError(Mistake(key, f'"{label}"', rule))


TABLE_ENDINGS = (".ctbl", ".csv", ".txt")
# Names of the label 0 of a case: with a mask of the body, and without one.
OUTSIDE, BETWEEN = "outside", "between"
# Columns of a table of 3D Slicer.
_NUMBER, _NAME = "LabelValue", "Name"
# Words of a line of ITK-SNAP: number, colours and visibilities, and the name in quotes.
_SNAP_WORDS = 8


def read_label_names(file: Path) -> dict[str, int]:
    """Return the label numbers of a table file, by label name.

    Raises ScenarioError if the file is not a label table of 3D Slicer (.ctbl, .csv) or ITK-SNAP (.txt).
    """
    if file.suffix.lower() == ".ctbl":
        return read_color_table(file)
    source = str(file)
    with reading(source, ScenarioError):
        lines = file.read_text(encoding="utf-8-sig").splitlines()
    rows = _of_slicer(lines, source) if file.suffix.lower() == ".csv" else _of_snap(lines, source)
    names: dict[str, int] = {}
    for number, name in rows:
        if names.setdefault(name, number) != number:
            raise ScenarioError(Mistake(name, f"{number}", f"is also the name of label {names[name]}"), source)
    if not names:
        raise ScenarioError("contains no labels", source)
    return names


def table_name(name: str) -> str:
    """Return a name as colour tables have it, without blanks."""
    return "_".join(name.split())


def name_mistakes(names: Iterable[tuple[str, str]]) -> Iterator[Mistake]:
    """Yield the mistakes of names of structures, each with its file: every one must differ in a colour table."""
    first: dict[str, str] = {}
    for name, source in names:
        written = table_name(name)
        if not written or not written.isprintable():
            yield Mistake("name of a structure", name, f"must have letters and no control characters, in {source}")
        elif written in (OUTSIDE, BETWEEN):
            yield Mistake(name, "", f"is the name of what lies between structures: rename it in {source}")
        elif written in first:
            yield Mistake(name, "", f"is in {first[written]} and in {source}, as {written}")
        first.setdefault(written, source)


def _of_slicer(lines: list[str], source: str) -> list[tuple[int, str]]:
    try:
        rows = list(csv.DictReader(lines))
    except csv.Error as error:
        raise ScenarioError(f"cannot be read: {error}", source) from None
    if not rows or not {_NUMBER, _NAME} <= set(rows[0]):
        raise ScenarioError(f"must have the columns {_NUMBER} and {_NAME}", source)
    return [(_number(row[_NUMBER], number, source), row[_NAME] or "") for number, row in enumerate(rows, start=2)]


def _of_snap(lines: list[str], source: str) -> list[tuple[int, str]]:
    found = []
    for number, line in enumerate(lines, start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            words = shlex.split(line)
        except ValueError:
            words = []
        if len(words) != _SNAP_WORDS:
            rule = 'must be IDX R G B A VIS MSH "LABEL", as ITK-SNAP writes it'
            raise ScenarioError(Mistake(f"line {number}", line.strip()[:60], rule), source)
        found.append((_number(words[0], number, source), words[-1]))
    return found


def _number(text: str | None, line: int, source: str) -> int:
    if text is None or not is_label(text.strip()):
        raise ScenarioError(Mistake(f"line {line}", str(text), "must begin with the number of a label"), source)
    return int(text)
