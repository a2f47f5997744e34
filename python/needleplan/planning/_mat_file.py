"""Policy tables as MATLAB files (.mat, version 7): the arrays, their axes, the scenario, and digests of all.

The axes of the arrays are [x, y, heading, bevel] in MATLAB too, unlike those that MATLAB's `h5read` shows.
"""

from __future__ import annotations

import io
import os
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from needleplan.artifacts import digest, version, write_whole
from needleplan.errors import ChecksumError, InputError, Mistake, TableError
from needleplan.extras import require
from needleplan.planning._lattice import Stats, Status
from needleplan.planning._plane_file import TABLES
from needleplan.planning._table import PolicyTable
from needleplan.scenario import Scenario

__all__ = ["read_mat", "write_mat"]

_FORMAT = "needleplan.table-mat/1"
_TYPES = {"values": np.float32, "policy": np.uint8, "success": np.float32}


def write_mat(table: PolicyTable, path: str | os.PathLike[str]) -> None:
    """Write a policy table to a MATLAB file, which `load` reads. If this fails, an existing file is unchanged.

    Parameters
    ----------
    table : PolicyTable
        The table.
    path : str or path
        The file to write.

    Raises
    ------
    OutputError
        If the file cannot be written.
    MissingLibraryError
        If scipy is not installed.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import needleplan as npl
    >>> from needleplan.planning import read_mat, write_mat
    >>> table = npl.plan("four_obstacles")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_mat(table, Path(folder) / "table.mat")
    ...     read_mat(Path(folder) / "table.mat").digest == table.digest
    True
    """
    require("scipy")
    from scipy.io import savemat

    scenario = table.scenario
    content: dict[str, Any] = {
        "format": _FORMAT,
        "made_by": f"needleplan {version()}",
        **{name: getattr(table, name) for name in TABLES},
        "x_mm": scenario.x_mm,
        "y_mm": scenario.y_mm,
        "heading_rad": scenario.headings_rad,
        "bevel": np.array([-1.0, 1.0]),
        "spacing_mm": np.array(scenario.grid.spacing_mm),
        "scenario": scenario.to_toml(),
        "digest": table.digest,
        "stats": asdict(table.stats) | {"status": str(table.stats.status), "order": np.array(table.stats.order, float)},
    }
    image = io.BytesIO()
    # The stubs of scipy do not know streams.
    savemat(image, content, do_compression=True, oned_as="column")  # type: ignore[arg-type]
    write_whole(path, image.getbuffer())


def read_mat(path: str | os.PathLike[str]) -> PolicyTable:
    """Return the policy table in a MATLAB file that `write_mat`, or MATLAB after it, has written.

    Parameters
    ----------
    path : str or path
        The file.

    Returns
    -------
    PolicyTable
        The table. A file in this format has no signature.

    Raises
    ------
    TableError
        If the file cannot be read, is damaged, or is no policy table.
    ChecksumError
        If an array or the scenario has been changed since the table was planned.
    MissingLibraryError
        If scipy is not installed.

    Examples
    --------
    >>> import needleplan as npl
    >>> from needleplan.planning import read_mat
    >>> try:
    ...     read_mat("nowhere.mat")
    ... except npl.InputError as error:
    ...     print(error)
    nowhere.mat: cannot be read: No such file or directory
    """
    require("scipy")
    from scipy.io import loadmat

    source = os.fspath(path)
    try:
        data = Path(path).read_bytes()
    except (OSError, ValueError) as error:
        raise TableError(f"cannot be read: {getattr(error, 'strerror', None) or error}", source) from error
    try:
        content = loadmat(io.BytesIO(data), simplify_cells=True)  # type: ignore[arg-type]
    except Exception as error:  # scipy raises many types of exceptions for damaged files
        raise TableError(f"is damaged, or not a MATLAB file of version 7: {error}", source) from error
    if content.get("format") != _FORMAT:
        rule = f'must be "{_FORMAT}": the file is no policy table'
        raise TableError(Mistake("format", str(content.get("format", "")), rule), source)
    try:
        return _table(content)
    except ChecksumError as error:
        raise ChecksumError(error.mistakes, source) from None
    except InputError as error:
        raise TableError(error.mistakes, source) from None
    except (KeyError, TypeError, ValueError) as error:
        raise TableError(f"is no policy table of this version: {error!r}", source) from error


def _table(content: dict[str, Any]) -> PolicyTable:
    scenario = Scenario.from_toml(content["scenario"])
    arrays = {name: np.ascontiguousarray(content[name], kind) for name, kind in _TYPES.items()}
    mistakes = [
        Mistake(name, f"{array.shape}", f"must have the shape of the scenario, {scenario.shape}")
        for name, array in arrays.items()
        if array.shape != scenario.shape
    ]
    if mistakes:
        raise TableError(mistakes)
    given = dict(content["stats"])
    order = tuple(int(number) for number in np.atleast_1d(given.pop("order")).tolist())
    kinds = {field.name: field.type for field in fields(Stats)}
    numbers: dict[str, Any] = {
        name: int(value) if kinds[name] == "int" else float(value) for name, value in given.items() if name != "status"
    }
    table = PolicyTable(
        **arrays, stats=Stats(**numbers, status=Status(given["status"]), order=order), scenario=scenario
    )
    if table.digest != content["digest"] or digest(content["scenario"]) != scenario.digest:
        rule = "the arrays or the scenario have changed since the table was planned"
        raise ChecksumError(Mistake("digest", str(content["digest"]), rule))
    return table
