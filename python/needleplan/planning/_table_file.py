"""Files of policy tables, in the plane and in 3D: HDF5 with a checksum (seal) in front (`_sealed_file.py`).

Both have the same parts. Datasets: the tables `values`, `policy` and `success` with description, unit and SHA-256; one
dataset for each of their axes; and what only one of them needs (`_plane_file.py`, `_space_file.py`). Attributes of the
root: `format`, `made_by`, `title`, text and digest of the scenario, names of the axes, and the digest of the table.
MATLAB shows the axes in reverse.

Before data are read, their type, shape and place in the file must be those that the scenario requires; afterwards, all
digests, units, axes and numbers must agree.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.artifacts import digest, version
from needleplan.errors import ChecksumError, Mistake, TableError
from needleplan.planning._seal import FORMAT
from needleplan.planning._sealed_file import require_none

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    import h5py
    from numpy.typing import NDArray

__all__ = [
    "TABLE_NAMES",
    "Axes",
    "Description",
    "add_axes",
    "add_root",
    "add_tables",
    "array_digests",
    "axes_text",
    "require_axes",
    "require_digests",
    "scenario_text",
    "table_digest",
]  # fmt: skip

TABLE_NAMES = ("values", "policy", "success")

# Description and unit of each table.
Description = dict[str, tuple[str, str]]
# Points and unit of each axis, by the name of its dataset.
Axes = dict[str, tuple[Any, str]]

# Attribute with the text of the scenario; files of earlier versions have that of an anatomy in the second one.
_TEXTS = ("scenario", "anatomy")
_RESEALED = "the file has been altered and sealed again"


def table_digest(scenario_digest: str, digests: Mapping[str, str]) -> str:
    """Return the digest of a table: of the digests of its scenario, and of `values`, `policy` and `success`."""
    return digest("\n".join([scenario_digest, *(digests[name] for name in TABLE_NAMES)]))


def array_digests(tables: Mapping[str, NDArray[Any]]) -> dict[str, str]:
    """Return the SHA-256 of each of the arrays `values`, `policy` and `success`."""
    with ThreadPoolExecutor(len(TABLE_NAMES)) as pool:
        computed = pool.map(lambda name: digest(np.ascontiguousarray(tables[name]).data), TABLE_NAMES)
        return dict(zip(TABLE_NAMES, computed, strict=True))


def add_root(file: h5py.File, scenario: Any, axes: str) -> None:
    """Write the attributes of the root that are known before a solve; `axes` has the names of the tables' axes."""
    file.attrs.update(
        {
            "format": FORMAT,
            "made_by": f"needleplan {version()}",
            "title": scenario.title.replace("\0", " "),
            "scenario": scenario.to_toml(),
            "scenario_digest": scenario.digest,
            "axes": axes,
        }
    )


def add_axes(file: h5py.File, axes: Axes) -> None:
    """Write the points of the axes."""
    for name, (points, unit) in axes.items():
        file.create_dataset(name, data=points)
        file[name].attrs["units"] = unit


def add_tables(file: h5py.File, tables: Description, scenario_digest: str, digests: Mapping[str, str]) -> None:
    """Write description, unit and digest of the tables, which are in the file, and the digest of the whole table."""
    file.attrs["digest"] = table_digest(scenario_digest, digests)
    for name, (description, unit) in tables.items():
        file[name].attrs.update({"description": description, "units": unit, "sha256": digests[name]})


def axes_text(file: h5py.File) -> str:
    """Return the names of the axes of an open table file."""
    return str(file.attrs["axes"])


def scenario_text(file: h5py.File) -> str:
    """Return the text of the scenario of an open table file. Raises TableError if it has none."""
    text = next((file.attrs[name] for name in _TEXTS if name in file.attrs), None)
    if not isinstance(text, str):
        raise TableError(Mistake("scenario", type(text).__name__, "must be a text"))
    return text


def require_axes(file: h5py.File, axes: Axes, tables: Description) -> None:
    """Raise TableError if points or units differ from those of the scenario."""
    units = {name: unit for name, (_, unit) in (tables | axes).items()}
    require_none([
        Mistake(f"{name}.units", str(file[name].attrs.get("units", "")), f'must be "{unit}"')
        for name, unit in units.items()
        if file[name].attrs.get("units") != unit
    ] + [
        Mistake(name, "", f"must hold the axis of the scenario, from {points.flat[0]:g} to {points.flat[-1]:g}")
        for name, (points, _) in axes.items()
        if not np.allclose(file[name][()], points, rtol=1e-9, atol=1e-9)
    ])  # fmt: skip


def require_digests(file: h5py.File, scenario_digest: str, digests: Mapping[str, str]) -> None:
    """Raise ChecksumError if a digest in the file is not that of the scenario, an array or the whole table."""
    wrong = [name for name, computed in digests.items() if file[name].attrs["sha256"] != computed]
    if file.attrs["scenario_digest"] != scenario_digest:
        wrong.append("scenario")
    if not wrong and file.attrs["digest"] != table_digest(scenario_digest, digests):
        wrong.append("table")
    _require_right(wrong)


def _require_right(wrong: Iterable[str]) -> None:
    mistakes = [Mistake(name, "", f"its SHA-256 is not the stored one: {_RESEALED}") for name in wrong]
    if mistakes:
        raise ChecksumError(mistakes)
