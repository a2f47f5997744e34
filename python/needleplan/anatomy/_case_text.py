"""The files of a case: the labelled volume, its colour table, and an anatomy file that shows every decision."""

from __future__ import annotations

import colorsys
import json
from pathlib import Path

from needleplan.anatomy._anatomy import Anatomy
from needleplan.anatomy._case import AnatomyCase
from needleplan.anatomy._file import AnatomyFile, Sphere
from needleplan.anatomy._labels import BETWEEN, OUTSIDE, table_name
from needleplan.anatomy._nifti import nifti_bytes
from needleplan.anatomy._roles import StructureRole
from needleplan.artifacts import write_whole
from needleplan.errors import Mistake, OutputError

__all__ = ["case_files", "write_case"]

# Step of the hue from one colour to the next: the golden section separates any number of them.
_HUE = 0.618


def case_files(file: Path) -> tuple[Path, Path]:
    """Return the names of volume and colour table beside an anatomy file.

    Parameters
    ----------
    file : pathlib.Path
        The anatomy file, .toml.

    Returns
    -------
    tuple of pathlib.Path

    Examples
    --------
    >>> from pathlib import Path
    >>> from needleplan.anatomy import case_files
    >>> [file.name for file in case_files(Path("case.toml"))]
    ['case.nii.gz', 'case.ctbl']
    """
    stem = file.name.removesuffix(".toml")
    return file.with_name(f"{stem}.nii.gz"), file.with_name(f"{stem}.ctbl")


def write_case(
    case: AnatomyCase, file: Path, *, curvature_radius_mm: float, gauge: int | None = None, margin_mm: float = 0.0
) -> None:
    """Write the files of a case.

    Parameters
    ----------
    case : AnatomyCase
        The case.
    file : pathlib.Path
        The anatomy file, .toml. Volume and colour table lie beside it.
    curvature_radius_mm : float
        Radius of the needle's arc in all tissues.
    gauge : int, optional
        Thickness of the needle. Default: none; then a margin is needed where there are obstacles.
    margin_mm : float, default 0.0
        Distance that the needle keeps from obstacles.

    Raises
    ------
    ScenarioError
        If a number is out of range, or target or entry have no voxel that obstacles leave free.
    OutputError
        If a file cannot be written.

    Examples
    --------
    >>> from pathlib import Path
    >>> from needleplan.anatomy import read_case, write_case
    >>> case = read_case("segmentations")  # doctest: +SKIP
    >>> write_case(case, Path("case.toml"), curvature_radius_mm=80.0, gauge=20)  # doctest: +SKIP
    """
    volume, table = case_files(file)
    text = _text(case, volume.name, table.name, curvature_radius_mm, gauge, margin_mm)
    if not file.name.isprintable():
        raise OutputError(Mistake("", "", "must have a name without control characters"), str(file))
    names = {table_name(name): number for name, number in case.volume.names.items()} | {_zero(case): 0}
    Anatomy(AnatomyFile.from_toml(text, str(file)), case.volume, names, str(file))
    write_whole(volume, nifti_bytes(case.volume))
    write_whole(table, _table(case).encode())
    write_whole(file, text.encode())


def _table(case: AnatomyCase) -> str:
    """Return the colour table."""
    lines = [f"# Labels of {_shown(case.volume.source)}", f"0 {_zero(case)} 0 0 0 0"]
    for name, number in case.volume.names.items():
        red, green, blue = (round(255 * share) for share in colorsys.hsv_to_rgb(number * _HUE % 1, 0.6, 0.9))
        lines.append(f"{number} {table_name(name)} {red} {green} {blue} 255")
    return "\n".join(lines) + "\n"


def _zero(case: AnatomyCase) -> str:
    """Return the name of the label 0."""
    return OUTSIDE if case.named(StructureRole.BODY) else BETWEEN


def _shown(text: str) -> str:
    """Return a text for a comment or a title, with ? for control characters and bytes that are no text."""
    return "".join(character if character.isprintable() else "?" for character in text)


def _text(case: AnatomyCase, volume: str, table: str, radius_mm: float, gauge: int | None, margin_mm: float) -> str:
    """Return the anatomy file."""
    width = max(len(structure.name) for structure in case.structures)
    listed = [
        f"{structure.name:<{width}}  {structure.volume_ml:>9.1f} ml  {structure.role:<8}  {structure.reason} "
        f"({structure.file})"
        for structure in sorted(case.structures, key=lambda structure: (structure.role, structure.name))
    ]
    obstacles = [f"    {_quoted(table_name(name))}," for name in case.named(StructureRole.OBSTACLE)]
    outside = [f'outside = ["{OUTSIDE}"]'] if case.named(StructureRole.BODY) else []
    needle = [f"gauge = {gauge}"] if gauge is not None else []
    return "\n".join([
        "# Made by `needleplan case`. Roles are proposals by name: check each line.",
        *(f"# {_shown(text)}" for text in (*listed, *case.notes)), 'schema = "needleplan.anatomy/1"',
        f"title = {_quoted(_shown(Path(case.volume.source).resolve().name))}", "", "[anatomy]",
        f"file = {_quoted(volume)}", f"labels = {_quoted(table)}", f"target = {_region(case.target)}",
        f"entry = {_region(case.entry)}", "obstacles = [", *obstacles, "]", *outside, f"margin_mm = {margin_mm:g}", "",
        "[needle]", f"curvature_radius_mm = {radius_mm:g}", *needle, "",
    ])  # fmt: skip


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _region(region: str | Sphere) -> str:
    if isinstance(region, str):
        return _quoted(table_name(region))
    center = ", ".join(f"{x:.3f}" for x in region.center_mm)
    return f"{{ center_mm = [{center}], radius_mm = {region.radius_mm:g} }}"
