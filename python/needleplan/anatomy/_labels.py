"""Names of labels: colour tables of 3D Slicer, and the reading of a volume by the ending of its name."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
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
    "LabelRule",
    "LabelsRule",
    "label_number",
    "read_color_table",
    "read_labels",
    "read_volume",
    "require_libraries",
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
