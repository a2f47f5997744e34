"""The files of a case: the labelled volume, its colour table, and an anatomy file that shows every decision."""

from __future__ import annotations

import colorsys
import json
from pathlib import Path

from needleplan.anatomy._case import AnatomyCase
from needleplan.anatomy._file import AnatomyFile, Sphere
from needleplan.anatomy._nifti import nifti_bytes
from needleplan.anatomy._roles import StructureRole
from needleplan.artifacts import write_whole

__all__ = ["case_files", "write_case"]

# Names of the label 0 with a mask of the body, and without one.
_OUTSIDE, _BETWEEN = "outside", "between"
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
        If a number is out of range.
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
    AnatomyFile.from_toml(text, str(file))
    write_whole(volume, nifti_bytes(case.volume))
    write_whole(table, _table(case).encode())
    write_whole(file, text.encode())


def _table(case: AnatomyCase) -> str:
    """Return the colour table."""
    zero = _OUTSIDE if case.named(StructureRole.BODY) else _BETWEEN
    lines = [f"# Labels of {case.volume.source}", f"0 {zero} 0 0 0 0"]
    for name, number in case.volume.names.items():
        red, green, blue = (round(255 * each) for each in colorsys.hsv_to_rgb(number * _HUE % 1, 0.6, 0.9))
        lines.append(f"{number} {_label_name(name)} {red} {green} {blue} 255")
    return "\n".join(lines) + "\n"


def _label_name(name: str) -> str:
    """Return a name as colour tables have it, without blanks."""
    return "_".join(name.split())


def _text(case: AnatomyCase, volume: str, table: str, radius_mm: float, gauge: int | None, margin_mm: float) -> str:
    """Return the anatomy file."""
    width = max(len(each.name) for each in case.structures)
    listed = [
        f"# {each.name:<{width}}  {each.volume_ml:>9.1f} ml  {each.role:<8}  {each.reason} ({each.file})"
        for each in sorted(case.structures, key=lambda each: (each.role, each.name))
    ]
    obstacles = [f"    {_quoted(name)}," for name in case.named(StructureRole.OBSTACLE)]
    outside = [f'outside = ["{_OUTSIDE}"]'] if case.named(StructureRole.BODY) else []
    needle = [f"gauge = {gauge}"] if gauge is not None else []
    return "\n".join([
        "# Made by `needleplan case`. Roles are proposals by name: check each line.",
        *listed, *(f"# {each}" for each in case.notes),
        'schema = "needleplan.anatomy/1"', f"title = {json.dumps(Path(case.volume.source).name)}", "", "[anatomy]",
        f"file = {json.dumps(volume)}", f"labels = {json.dumps(table)}", f"target = {_region(case.target)}",
        f"entry = {_region(case.entry)}", "obstacles = [", *obstacles, "]", *outside, f"margin_mm = {margin_mm:g}", "",
        "[needle]", f"curvature_radius_mm = {radius_mm:g}", *needle, "",
    ])  # fmt: skip


def _quoted(name: str) -> str:
    return json.dumps(_label_name(name), ensure_ascii=False)


def _region(region: str | Sphere) -> str:
    if isinstance(region, str):
        return _quoted(region)
    center = ", ".join(f"{x:.3f}" for x in region.center_mm)
    return f"{{ center_mm = [{center}], radius_mm = {region.radius_mm:g} }}"
